"""``python -m stillray_training.ablation --out runs/ablation``: the paper's ablations and peers.

Each option asks for one part, which takes up where it stopped: ``--data`` trains the variants,
``--validation`` scores those that are finished, ``--rounds`` times all, ``--report`` writes the
page of what there is. ``--seeds 3`` trains each three times, and the page tells the spread;
``--only`` chooses variants by name.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import torch
import typer

from stillray.cli import program
from stillray.errors import InputError
from stillray.profiling.plot import require_drawable
from stillray_training.ablation.claims import MOST_SEEDS
from stillray_training.ablation.measure import score_all, time_all
from stillray_training.ablation.page import write_page
from stillray_training.ablation.results import read_results
from stillray_training.ablation.study import train_all
from stillray_training.ablation.variants import STEPS, TIMED, Variant, study


def main(
    out: Annotated[Path, typer.Option(help="Folder of the study: weights, scores, times.")],
    data: Annotated[
        list[Path] | None, typer.Option(help="Train: folder of rendered sequences; repeatable.")
    ] = None,
    validation: Annotated[
        Path | None, typer.Option(help="Score: folder of sequences with references.")
    ] = None,
    rounds: Annotated[int, typer.Option(min=0, help="Time: rounds, in turn; 5 are enough.")] = 0,
    report: Annotated[Path | None, typer.Option(help="Write the page as Markdown.")] = None,
    pictures: Annotated[Path | None, typer.Option(help="Folder for what is scored, PNG.")] = None,
    seeds: Annotated[
        int, typer.Option(min=1, max=MOST_SEEDS, help="Trainings of each, from other numbers.")
    ] = 1,
    only: Annotated[
        list[str] | None, typer.Option(help="Name of a variant; repeatable; default: all.")
    ] = None,
    steps: Annotated[int, typer.Option(min=1, help="Of each training.")] = STEPS,
    threads: Annotated[int, typer.Option(help="Threads of PyTorch in training.")] = 0,
    height: Annotated[int, typer.Option(min=1, help="Of the frame that is timed.")] = 720,
    width: Annotated[int, typer.Option(min=1)] = 1280,
) -> None:
    """Train, score, time and report the variants of the study."""
    if report:
        require_drawable(report)
    if threads:
        torch.set_num_threads(threads)
    variants = _chosen(study(seeds, steps), only)
    if data:
        train_all(variants, data, out)
    if validation:
        score_all(variants, out, validation, pictures)
    if rounds:
        timed = [one for one in variants if one.name in TIMED and one.seed == 1]
        time_all(timed, out, (height, width), rounds)
    if report:
        given = {
            "seeds": seeds, "steps": steps, "rounds": rounds, "height": height, "width": width,
        }  # fmt: skip
        write_page(variants, read_results(variants, out), report, _command(given, only, report))


def _chosen(variants: list[Variant], names: list[str] | None) -> list[Variant]:
    """Those of some names, in the study's order; all without."""
    known = list(dict.fromkeys(variant.name for variant in variants))
    for name in names or ():
        if name not in known:
            raise InputError(f"only must be one of {'; '.join(known)}, got {name}")
    return [variant for variant in variants if not names or variant.name in names]


def _command(given: Mapping[str, int], only: list[str] | None, report: Path) -> str:
    """What a reader calls for the same page; folders by what lies in them."""
    numbers = " ".join(f"--{name} {value}" for name, value in given.items())
    names = "".join(f" --only {shlex.quote(name)}" for name in only or ())
    return (
        "python -m stillray_training.ablation --data DATA --validation VALIDATION "
        f"{numbers}{names} --out RUNS/{report.stem} --report {report.name}"
    )


if __name__ == "__main__":
    program.run(main)

"""``python -m stillray_training.ablation --out runs/ablation``: the paper's ablations and peers.

Each option asks for one part, which takes up where it stopped: ``--data`` trains the variants,
``--validation`` scores those that are finished, ``--rounds`` times all, ``--report`` writes the
page of what there is.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import torch
import typer

from stillray.cli import program
from stillray.profiling.plot import require_drawable
from stillray_training.ablation.measure import score_all, time_all
from stillray_training.ablation.page import write_page
from stillray_training.ablation.results import read_results
from stillray_training.ablation.study import train_all
from stillray_training.ablation.variants import TIMED, study


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
    threads: Annotated[int, typer.Option(help="Threads of PyTorch in training.")] = 0,
    height: Annotated[int, typer.Option(min=1, help="Of the frame that is timed.")] = 720,
    width: Annotated[int, typer.Option(min=1)] = 1280,
) -> None:
    """Train, score, time and report the variants of the study."""
    if report:
        require_drawable(report)
    if threads:
        torch.set_num_threads(threads)
    variants = study()
    if data:
        train_all(variants, data, out)
    if validation:
        score_all(variants, out, validation, pictures)
    if rounds:
        timed = [variant for variant in variants if variant.name in TIMED]
        time_all(timed, out, (height, width), rounds)
    if report:
        write_page(variants, read_results(variants, out), report, _COMMAND)


_COMMAND = (
    "python -m stillray_training.ablation --data DATA --validation VALIDATION --rounds 5 "
    "--out runs/ablation --report docs/ablations.md"
)

if __name__ == "__main__":
    program.run(main)

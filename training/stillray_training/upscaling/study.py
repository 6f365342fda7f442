"""``python -m stillray_training.upscaling.study --out RUNS/branches``: tables 4 and 5 of the paper.

Kazmierczyk et al. 2025, sections 5.5 and 5.6: a network of two branches against one branch of as
many weights, and convolutions of half of the channels against those of all. Trained alike and
shortly from random weights, on the same patches with the same seed, and measured as users run a
model. ``--data`` trains what is not finished, ``--validation`` measures, ``--report`` writes the
page of what there is.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import fmean, median
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import torch
import typer
from torch import nn

from stillray.arrays.strips import available_threads
from stillray.cli import program
from stillray.compare import metrics
from stillray.compare.metrics import METRICS
from stillray.errors import InputError
from stillray.io.atomic import atomic_path
from stillray.io.exr.read import read_exr
from stillray.model_spec import ModelSpec, load
from stillray.model_spec.networks import BranchNetwork
from stillray.models.session import open_session
from stillray.profiling.cost import network_cost
from stillray.profiling.machine import describe
from stillray_training.ablation.results import Value
from stillray_training.blocks import frames_of
from stillray_training.checkpoint import CHECKPOINT, restore
from stillray_training.examples import find_sequences
from stillray_training.networks.fuse import fuse
from stillray_training.networks.multi_branch import multi_branch_net
from stillray_training.networks.single_branch import single_branch_net
from stillray_training.onnx_graph import network_graph
from stillray_training.upscaling.compare import MEASURED, PICTURES, denoised
from stillray_training.upscaling.loop import load_clips, train_recurrent
from stillray_training.upscaling.time_in_turn import times_in_turn

BASE = "munet-x2"
#: Channels of one branch that make as many weights as both branches have, 1 % apart.
SINGLE_WIDTHS = (32, 64, 106)
#: Height and width that network time and operations are of.
PICTURE = (720, 1280)
_SCORES, _TIMES = "scores.json", "times.json"
#: Short, so that a training takes minutes of one core; the rest is the model's recipe.
SHORT: dict[str, Any] = {"batch": 3, "patch": 80, "frames": 4, "warm_frames": 0, "average": 0.99}


@dataclass(frozen=True, kw_only=True)
class Variant:
    """A network of the study.

    Attributes
    ----------
    name
        In tables.
    network
        Makes it, with random weights.
    spec
        What it learns by and how its planes are used.
    seed
        Which of the trainings, 1 for the first.
    """

    name: str
    network: Callable[[ModelSpec], nn.Module]
    spec: ModelSpec
    seed: int

    def folder(self, out: Path) -> Path:
        """Where its checkpoint and scores lie."""
        name = self.name.replace(",", "").replace(" ", "-")
        return out / f"{name}-seed-{self.seed}"

    def trained(self, out: Path) -> nn.Module | None:
        """The network with its weights' mean, if its training is finished."""
        network = self.network(self.spec)
        step = restore(self.folder(out) / CHECKPOINT, self.spec, network, None, network)
        return network if step >= self.spec.training.steps else None


def variants(seeds: int, steps: int) -> list[Variant]:
    """The study, all of a seed before the next."""
    base = load(BASE)
    assert isinstance(base.network, BranchNetwork)
    whole = dataclasses.replace(base, network=dataclasses.replace(base.network, partial=False))
    found: list[Variant] = []
    for seed in range(1, seeds + 1):
        for name, spec, network in (
            ("two branches, half of the channels", base, multi_branch_net),
            ("two branches, all channels", whole, multi_branch_net),
            ("one branch", base, partial(single_branch_net, widths=SINGLE_WIDTHS)),
        ):
            training = dataclasses.replace(spec.training, **SHORT, steps=steps, seed=seed)
            short = dataclasses.replace(spec, training=training)
            found.append(Variant(name=name, network=network, spec=short, seed=seed))
    return found


def train_all(study: Sequence[Variant], data: list[Path], out: Path) -> None:
    """Train what is not finished; a training that was stopped goes on."""
    pending = [variant for variant in study if variant.trained(out) is None]
    clips = load_clips(data, pending[0].spec) if pending else []
    for variant in pending:
        print(f"{variant.name}, seed {variant.seed}", file=sys.stderr, flush=True)
        folder = variant.folder(out)
        train_recurrent(variant.spec, data, folder, network=variant.network, clips=clips)


def score_all(study: Sequence[Variant], validation: Path, out: Path) -> None:
    """Measure what is finished, and time the networks of the first seed in turn."""
    sequences = find_sequences(validation)
    if not sequences:
        raise InputError(f"validation must hold finished sequences, got {validation}")
    with TemporaryDirectory() as folder:
        files: dict[str, Path] = {}
        for index, variant in enumerate(study):
            network = variant.trained(out)
            if network is None:
                continue
            file = Path(folder) / f"{index}.onnx"
            graph = network_graph(fuse(network), variant.spec, {})
            file.write_bytes(graph.SerializeToString())
            found = {sequence.name: _score(file, sequence) for sequence in sequences}
            _write(variant.folder(out) / _SCORES, found)
            if variant.seed == 1:
                files[variant.name] = file
        _write(out / _TIMES, {"machine": describe(), "networks": _networks(files)})


def _score(model: Path, sequence: Path) -> dict[str, float]:
    _, _, images = denoised(str(model), frames_of(sequence))
    references = [read_exr(path).color for path in sorted(sequence.glob("ref_*.exr"))[-PICTURES:]]
    return metrics.evaluate(images, references, names=MEASURED)


def _networks(files: Mapping[str, Path]) -> dict[str, dict[str, float]]:
    """Operations of each network for a picture, and its milliseconds, all in turn."""
    runs: dict[str, Callable[[int], object]] = {}
    for name, file in files.items():
        session = open_session(file, threads=available_threads())
        (source,) = session.get_inputs()
        planes = np.zeros((1, source.shape[1], *PICTURE), np.float32)
        runs[name] = partial(_run, session, {source.name: planes})
    times = times_in_turn(runs, seconds=0, rounds=7)
    return {
        name: {
            "milliseconds": median(times[name]),
            "gflop": network_cost(file, *PICTURE).operations / 1e9,
        }
        for name, file in files.items()
    }


def _run(session: Any, feed: Mapping[str, np.ndarray], turn: int) -> object:
    return session.run(None, feed)


def page(study: Sequence[Variant], out: Path, command: str) -> str:
    """What was found, as Markdown.

    Raises
    ------
    InputError
        Nothing was measured.
    """
    if not (out / _TIMES).is_file():
        raise InputError(f"out must hold scores, got {out}: run with --validation first")
    timed = json.loads((out / _TIMES).read_text())
    shown = [metric for metric in METRICS if metric.name in MEASURED]
    titles = ["weights", "GFLOP", "network ms", *(metric.title for metric in shown)]
    rows = [f"| | {' | '.join(titles)} |", "|---" * (len(titles) + 1) + "|"]
    most = 0
    for name in dict.fromkeys(variant.name for variant in study):
        same = [one for one in study if one.name == name]
        scores = [_means(one.folder(out) / _SCORES) for one in same]
        found = [score for score in scores if score]
        if not found or name not in timed["networks"]:
            continue
        most = max(most, len(found))
        fused = fuse(same[0].network(same[0].spec))
        weights = sum(part.numel() for part in fused.parameters())
        work = timed["networks"][name]
        cells = [f"{weights:,}", f"{work['gflop']:.0f}", f"{work['milliseconds']:.0f}"]
        for metric in shown:
            value = Value.of([score[metric.name] for score in found])
            apart = "" if value.deviation is None else f" ± {value.deviation:{metric.format}}"
            cells.append(f"{value.mean:{metric.format}}{apart}")
        rows.append(f"| {name} | {' | '.join(cells)} |")
    recipe = study[0].spec.training
    height, width = PICTURE
    return (
        "# Branches and partial convolutions\n\n"
        f"Written by `{command}`. Kazmierczyk et al. 2025, tables 4 and 5, on our data: trained "
        f"alike from random weights, {recipe.steps} steps of {recipe.batch} patches of "
        f"{recipe.patch}x{recipe.patch} pixels and {recipe.frames} frames, {most} seeds, with the "
        "same seed on the same patches; mean over the validation scenes at half their size, and "
        "the standard deviation over seeds. These are trainings of minutes: they compare networks "
        "with one another, not with the model that ships. Operations and milliseconds are of the "
        f"network for a picture of {width}x{height} pixels, on {timed['machine']['processor']}, "
        "in turn.\n\n" + "\n".join(rows) + "\n"
    )


def _means(scores: Path) -> dict[str, float]:
    if not scores.is_file():
        return {}
    found = json.loads(scores.read_text())
    names = next(iter(found.values()))
    return {name: fmean(scene[name] for scene in found.values()) for name in names}


def _write(path: Path, found: Mapping[str, Any]) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(found, indent=1))


def main(
    out: Annotated[Path, typer.Option(help="Folder of the study: weights, scores, times.")],
    data: Annotated[
        list[Path] | None, typer.Option(help="Train: folder of rendered sequences; repeatable.")
    ] = None,
    validation: Annotated[
        Path | None, typer.Option(help="Measure: sequences with references of twice their size.")
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Write the page as Markdown.")] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Trainings of each.")] = 2,
    steps: Annotated[int, typer.Option(min=1, help="Of each training.")] = 400,
    threads: Annotated[int, typer.Option(min=0, help="Threads of PyTorch; 0: all.")] = 0,
) -> None:
    """Train, measure and report the networks of the study."""
    if threads:
        torch.set_num_threads(threads)
    study = variants(seeds, steps)
    if data:
        train_all(study, data, out)
    if validation:
        score_all(study, validation, out)
    if report:
        command = (
            "python -m stillray_training.upscaling.study --data DATA --validation VALIDATION2X "
            f"--seeds {seeds} --steps {steps} --out RUNS/branches --report {report.name}"
        )
        with atomic_path(report) as temporary:
            temporary.write_text(page(study, out, command))


if __name__ == "__main__":
    program.run(main)

"""``python -m stillray_training.outlier_study VALIDATION --model nbg-7x3``: what outliers do.

A model with and without removal of outliers before everything else (Meng et al. 2020, table 4), its
weights as they are: single frames of some samples a pixel, and sequences of one sample.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import fmean
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from stillray.cli import program
from stillray.compare import metrics
from stillray.frame import Frame
from stillray.model_spec import ModelSpec
from stillray.models.registry import find_model
from stillray.pipeline.denoiser import Denoiser
from stillray_training.evaluate.cases import find_cases

METRICS = ("psnr", "ssim", "smape", "relmse", "bias")
#: Set of frames to deviations, 0 for none removed, to metric to mean over the scenes.
Scores = dict[str, dict[float, dict[str, float]]]


def removing(spec: ModelSpec, deviations: float) -> ModelSpec:
    """A specification that removes what stands out by so many deviations; 0: nothing."""
    temporal = dataclasses.replace(spec.temporal, outlier_deviations=deviations)
    return dataclasses.replace(spec, temporal=temporal)


def measure(model: str, folder: Path, deviations: Sequence[float], samples: int) -> Scores:
    """Scores with and without.

    Parameters
    ----------
    model
        Any that filters accumulated frames.
    folder
        Sequences with references, and stills, as ``stillray-evaluate`` takes them.
    deviations
        What to try, beside none.
    samples
        A pixel, of the stills.
    """
    info = find_model(model)
    found: dict[tuple[str, float], list[dict[str, float]]] = {}
    with Denoiser(info) as plain:
        for title, temporal, frames, reference in runs(folder, samples):
            for kept in (0.0, *deviations):
                other = dataclasses.replace(info, spec=removing(info.spec, kept))
                with Denoiser(other, engine=plain.engine, temporal=temporal) as stream:
                    for frame in frames:
                        image = stream.denoise(frame)
                values = metrics.evaluate([image], [reference], names=METRICS)
                found.setdefault((title, kept), []).append(values)
    scores = Scores()
    for (title, kept), rows in found.items():
        means = {name: fmean(row[name] for row in rows) for name in rows[0]}
        scores.setdefault(title, {})[kept] = means
    return scores


def runs(folder: Path, samples: int) -> Iterator[tuple[str, bool, list[Frame], np.ndarray]]:
    """Title, whether frames have a past, the frames, and what the last should be."""
    for case in find_cases(folder, kinds=("stills", "sequences"), counts=(samples,)):
        frames, references = case.read()
        yield case.title, case.kind == "sequences", frames, references[-1]


def main(
    folder: Annotated[Path, typer.Argument(help="Scenes with references and stills.")],
    model: Annotated[str, typer.Option(help="Model, or an .onnx.")] = "nbg-7x3",
    deviations: Annotated[
        list[float] | None, typer.Option(help="Standard deviations; repeatable; 2 unless given.")
    ] = None,
    samples: Annotated[int, typer.Option(min=1, help="A pixel, of the stills.")] = 64,
) -> None:
    """Print means over the scenes with outliers and without."""
    scores = measure(model, folder, deviations or [2.0], samples)
    titles = [metric.title for metric in metrics.METRICS if metric.name in METRICS]
    table = Table("set", "removed beyond", *titles, box=None)
    for title, rows in scores.items():
        for kept, values in rows.items():
            cells = [
                format(values[metric.name], metric.format)
                for metric in metrics.METRICS
                if metric.name in values
            ]
            table.add_row(title, f"{kept:g} deviations" if kept else "none", *cells)
    Console(width=140).print(table)


if __name__ == "__main__":
    program.run(main)

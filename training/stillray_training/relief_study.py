"""``python -m stillray_training.relief_study DATA --model kpyr-5-still``: what relief is worth.

A model that puts relief back, and the same without, on single frames of training's sequences: the
last frame's further blocks, each a frame of its own count of samples, against the target. Scenes by
the dozen, that neither the rule nor its numbers were chosen on, tell where it does harm.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from statistics import fmean, median
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from stillray.cli import program
from stillray.compare import metrics
from stillray.errors import InputError
from stillray.io.exr.read import read_exr
from stillray.model_spec.stages import Relief
from stillray.models.registry import find_model
from stillray.pipeline.denoiser import Denoiser
from stillray_training.blocks import frame_paths, read_blocks
from stillray_training.examples import find_sequences
from stillray_training.targets import read_filter, read_target

_METRICS = ("psnr", "ssim")
#: Decibels below which a frame is called worse.
WORSE = -0.005


def gains(model: str, sequences: Sequence[Path]) -> dict[int, list[dict[str, float]]]:
    """By samples a pixel: what each frame gains by relief, metric by metric.

    Raises
    ------
    InputError
        The model puts no relief back.
    """
    info = find_model(model)
    if not info.spec.relief.window:
        raise InputError(f"model must put relief back, got {info.name}, whose relief.window is 0")
    without = dataclasses.replace(info, spec=dataclasses.replace(info.spec, relief=Relief()))
    found: dict[int, list[dict[str, float]]] = {}
    with ExitStack() as stack:
        on = stack.enter_context(Denoiser(info, temporal=False))
        off = stack.enter_context(Denoiser(without, temporal=False, engine=on.engine))
        for sequence in sequences:
            (wanted, _), spread = read_target(sequence), read_filter(sequence)
            last = read_exr(frame_paths(sequence)[-1])
            for block, count in read_blocks(sequence, last, 1.0)[1:]:
                frame = dataclasses.replace(block, samples=count, filter_spread=spread)
                before, after = (
                    metrics.evaluate([each.denoise(frame)], [wanted], names=_METRICS)
                    for each in (off, on)
                )
                change = {name: after[name] - before[name] for name in _METRICS}
                found.setdefault(round(count), []).append(change)
    return found


def main(
    data: Annotated[list[Path], typer.Argument(help="Folders of sequences.")],
    model: Annotated[str, typer.Option(help="Model, or an .onnx.")] = "kpyr-5-still",
    most: Annotated[int, typer.Option(min=1, help="Sequences of each folder at most.")] = 40,
) -> None:
    """Print what relief gains, folder by folder, at each count of samples."""
    titles = ("data", "samples", "frames", "PSNR mean", "median", "least", "worse", "SSIM mean")
    table = Table(*titles, box=None)
    for folder in data:
        sequences = find_sequences(folder)
        for count, rows in sorted(gains(model, sequences[:: -(-len(sequences) // most)]).items()):
            decibels = [row["psnr"] for row in rows]
            cells = [fmean(decibels), median(decibels), min(decibels)]
            worse = sum(value < WORSE for value in decibels)
            similar = fmean(row["ssim"] for row in rows)
            shown = [format(value, "+.3f") for value in cells]
            table.add_row(
                folder.name, str(count), str(len(rows)), *shown, str(worse), format(similar, "+.4f")
            )
    Console(width=120).print(table)


if __name__ == "__main__":
    program.run(main)

"""``python -m stillray_training.tail_study VALIDATION``: what rare bright samples cost.

Stills of validation, as if their renderer clamped no sample: some of each frame's are far brighter
than the picture (`stillray_training.heavy_tail`), in the reference is their mean. Models and peers;
the first column is the frame as it was rendered.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from statistics import fmean
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from stillray.cli import program
from stillray.compare.metrics import evaluate
from stillray.errors import InputError
from stillray.frame import Frame
from stillray.pipeline.denoiser import Denoiser
from stillray_training.evaluate.__main__ import find_all
from stillray_training.evaluate.cases import Case
from stillray_training.heavy_tail import Tail, frame_with, light_of, reference_with
from stillray_training.peers import find_peer

#: Samples brighter than the picture's usual light, of all.
OFTEN = (0.0, 1e-3, 1e-2, 1e-1)
_MOST = 1e4  # times the light that they are measured by
_COUNTS = (4, 16, 64)

Denoise = Callable[[Frame], np.ndarray]


def shown(case: Case, often: float) -> tuple[Frame, np.ndarray]:
    """A still with such samples, the same every time, and its reference with their mean."""
    frames, references = case.read()
    frame, reference = frames[-1], references[-1]
    if not often:
        return frame, reference
    tail = Tail(np.full(frame.shape, often, np.float32), light_of(reference), _MOST)
    samples = float(case.frames[-1].parent.name)
    return frame_with(frame, tail, samples, np.random.default_rng(1)), reference_with(
        reference, tail
    )


def scores(cases: list[Case], denoise: Mapping[str, Denoise]) -> dict[str, list[float]]:
    """PSNR as displayed by method, for each of `OFTEN`, dB, mean of the cases."""
    found: dict[str, list[float]] = {name: [] for name in denoise}
    for often in OFTEN:
        pairs = [shown(case, often) for case in cases]
        for name, each in denoise.items():
            found[name].append(fmean(_psnr(each(frame), wanted) for frame, wanted in pairs))
    return found


def _psnr(image: np.ndarray, reference: np.ndarray) -> float:
    return evaluate([image], [reference], names=("psnr",))["psnr"]


def main(
    folder: Annotated[Path, typer.Argument(help="As for stillray-evaluate.")],
    model: Annotated[list[str] | None, typer.Option(help="Model, or an .onnx; repeatable.")] = None,
    peer: Annotated[list[str] | None, typer.Option(help="oidn-high and so on; repeatable.")] = None,
    counts: Annotated[
        list[int] | None, typer.Option("--count", help="Samples a pixel; repeatable.")
    ] = None,
    pixel_filter: Annotated[str, typer.Option(help="As for stillray-evaluate.")] = "box",
) -> None:
    """Print PSNR by how often samples are so bright, of each count."""
    methods: dict[str, Denoise] = {"noisy": lambda frame: frame.color}
    with ExitStack() as streams:
        for name in model or ["kpyr-5-still", "kpyr-5s-still"]:
            denoiser = streams.enter_context(Denoiser(name, temporal=False))
            if denoiser.scale != 1:
                raise InputError(f"model must keep the frame's size, got {name}, which enlarges")
            methods[name] = denoiser.denoise
        for name in peer or []:
            methods[name] = find_peer(name).make().denoise
        for count in counts or _COUNTS:
            cases = find_all([str(folder)], ("stills",), (count,), pixel_filter)
            table = Table(f"{count} samples", *(f"{often:g}" for often in OFTEN), box=None)
            for name, values in scores(cases, methods).items():
                table.add_row(name, *(f"{value:.2f}" for value in values))
            Console(width=100).print(table)


if __name__ == "__main__":
    program.run(main)

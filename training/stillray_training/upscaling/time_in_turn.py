"""``python -m stillray_training.upscaling.time_in_turn HALF FULL --model munet-x2``.

How long a model that doubles takes beside methods that are given all pixels: in turn in one
process, round after round. Every stage counts, from the renderer's buffers to the picture.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from stillray.arrays.strips import available_threads
from stillray.cli import program
from stillray.errors import InputError
from stillray.pipeline.denoiser import Denoiser
from stillray.profiling.clip import Clip, open_clip
from stillray_training.benchmark import run_peer
from stillray_training.peers import OIDN_QUALITIES

_LEAST_ROUNDS = 3


def times_in_turn(
    methods: Mapping[str, Callable[[int], object]], seconds: float, rounds: int = _LEAST_ROUNDS
) -> dict[str, list[float]]:
    """Milliseconds of every method in every round but the first, which warms up.

    Parameters
    ----------
    methods
        By name what does a frame, given the number of its round.
    seconds
        How long rounds are begun.
    rounds
        And how many there are at least, beside the first.
    """
    times: dict[str, list[float]] = {name: [] for name in methods}
    began, turn = time.perf_counter(), 0
    while turn <= rounds or time.perf_counter() - began < seconds:
        for name, run in methods.items():
            start = time.perf_counter()
            run(turn)
            times[name].append(1e3 * (time.perf_counter() - start))
        turn += 1
    return {name: values[1:] for name, values in times.items()}


def ours(denoiser: Denoiser, clip: Clip) -> Callable[[int], object]:
    """What denoises a clip's frames with their past."""

    def run(turn: int) -> object:
        frame, anew = clip.frame(turn)
        if anew:
            denoiser.reset()
        return denoiser.denoise(frame)

    return run


def main(
    half: Annotated[str, typer.Argument(help="Frames that are doubled: a pattern of files.")],
    full: Annotated[str, typer.Argument(help="Frames of the picture's size: a pattern of files.")],
    model: Annotated[str, typer.Option(help="The model, or the path of its .onnx file.")],
    flagship: Annotated[str, typer.Option(help="Given all pixels, beside it.")] = "high",
    height: Annotated[int, typer.Option(help="Of the picture, pixels; frames are tiled.")] = 720,
    width: Annotated[int, typer.Option(help="Of the picture, pixels.")] = 1280,
    seconds: Annotated[float, typer.Option(help="How long to measure.")] = 60.0,
) -> None:
    """Print median milliseconds a frame, and ratios to Open Image Denoise, round by round."""
    threads = available_threads()
    peers = [f"OIDN {quality}" for quality in OIDN_QUALITIES]
    with Denoiser(model, threads=threads) as doubling, Denoiser(flagship, threads=threads) as plain:
        scale = doubling.scale
        if height % scale or width % scale:
            raise InputError(f"height and width must be multiples of {scale}, got {height}x{width}")
        all_pixels = open_clip(full, (height, width))
        methods: dict[str, Callable[[int], object]] = {
            doubling.model.name: ours(doubling, open_clip(half, (height // scale, width // scale))),
            plain.model.name: ours(plain, all_pixels),
            **{name: partial(run_peer, name, all_pixels) for name in peers},
        }
        times = times_in_turn(methods, seconds)
    rounds = len(times[doubling.model.name])
    table = Table(title=f"{width}x{height}, {threads} threads, {rounds} rounds in turn")
    for title in ("method", "median ms", *(f"/ {name}" for name in peers)):
        table.add_column(title)
    for name, values in times.items():
        ratios = [np.median(np.array(values) / np.array(times[other])) for other in peers]
        table.add_row(name, f"{np.median(values):.0f}", *(f"{ratio:.2f}" for ratio in ratios))
    Console().print(table)


if __name__ == "__main__":
    program.run(main)

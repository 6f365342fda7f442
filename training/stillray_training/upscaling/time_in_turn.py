"""``python -m stillray_training.upscaling.time_in_turn HALF FULL --model munet-x2``.

How long a model that doubles takes beside methods that are given all pixels: in turn in one
process, round after round. Every stage counts, from the renderer's buffers to the picture. Then the
model alone, stage by stage, beside the least that the machine would take.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from stillray.arrays.strips import available_threads
from stillray.cli import program
from stillray.errors import InputError
from stillray.io.atomic import atomic_path
from stillray.pipeline.denoiser import Denoiser
from stillray.profiling.clip import Clip, open_clip
from stillray.profiling.machine import describe
from stillray.profiling.measure import Setting
from stillray.profiling.results import Result, profile_settings
from stillray_training.benchmark import ratio, run_peer, stages_table
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


def table(times: Mapping[str, list[float]], peers: Sequence[str]) -> list[str]:
    """A row a method: median milliseconds, and medians over the rounds of its ratios to peers."""
    lines = [
        "| method | median ms | " + " | ".join(f"/ {name}" for name in peers) + " |",
        "|---" * (2 + len(peers)) + "|",
    ]
    for name, values in times.items():
        ratios = [f"{ratio(values, times[peer]):.2f}" for peer in peers]
        cells = [name, f"{np.median(values):.0f}", *ratios]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def page(
    times: Mapping[str, list[float]], peers: Sequence[str], result: Result, command: str
) -> str:
    """The figures as Markdown: all methods in turn, and the stages of the one that doubles."""
    setting, peaks = result.run.setting, result.peaks
    rounds = len(next(iter(times.values())))
    lines = [
        "# Time of denoising and doubling",
        "",
        f"Written by `{command}`.",
        "",
        ", ".join(f"{name} {value}" for name, value in describe().items())
        + f"; matrix product {peaks.operations / 1e9:.0f} GFLOP/s, copy "
        f"{peaks.bandwidth / 1e9:.1f} GB/s. {result.run.info.name} is given "
        f"{setting.width}x{setting.height} pixels and the others all pixels of the picture, "
        f"{rounds} rounds, in turn in one process, all stages but the files included; ratios are "
        "medians over the rounds.",
        "",
        *table(times, peers),
        "",
        "## Stages",
        "",
        "Median milliseconds of each stage, after these rounds. The roofline is the slower of its "
        "operations at the matrix product's rate and its bytes at the copy's, each plane moved "
        "once.",
        "",
        *stages_table([result]),
    ]
    if result.memory is not None:
        lines += [
            "",
            f"Peak memory of a process with it alone: {result.memory.peak:.0f} MiB, of which "
            f"{result.memory.net:.0f} over the buffers and the libraries.",
        ]
    return "\n".join(lines) + "\n"


def main(
    half: Annotated[str, typer.Argument(help="Frames that are doubled: a pattern of files.")],
    full: Annotated[str, typer.Argument(help="Frames of the picture's size: a pattern of files.")],
    model: Annotated[str, typer.Option(help="The model, or the path of its .onnx file.")],
    flagship: Annotated[str, typer.Option(help="Given all pixels, beside it.")] = "high",
    height: Annotated[int, typer.Option(help="Of the picture, pixels; frames are tiled.")] = 720,
    width: Annotated[int, typer.Option(help="Of the picture, pixels.")] = 1280,
    seconds: Annotated[float, typer.Option(help="How long to measure.")] = 60.0,
    report: Annotated[Path | None, typer.Option(help="Write the figures as Markdown.")] = None,
) -> None:
    """Print median milliseconds a frame, ratios to Open Image Denoise, and rooflines of stages."""
    threads = available_threads()
    peers = [f"OIDN {quality}" for quality in OIDN_QUALITIES]
    with Denoiser(model, threads=threads) as doubling, Denoiser(flagship, threads=threads) as plain:
        scale = doubling.scale
        if height % scale or width % scale:
            raise InputError(f"height and width must be multiples of {scale}, got {height}x{width}")
        smaller = (height // scale, width // scale)
        all_pixels = open_clip(full, (height, width))
        methods: dict[str, Callable[[int], object]] = {
            doubling.model.name: ours(doubling, open_clip(half, smaller)),
            plain.model.name: ours(plain, all_pixels),
            **{name: partial(run_peer, name, all_pixels) for name in peers},
        }
        times = times_in_turn(methods, seconds)
    setting = Setting(model=model, height=smaller[0], width=smaller[1], threads=threads)
    (result,) = profile_settings([setting], source=half, seconds=seconds / 4, memory=True)
    command = f"python -m stillray_training.upscaling.time_in_turn HALF FULL --model {model}"
    text = page(times, peers, result, command)
    print(text)
    if report is not None:
        with atomic_path(report) as temporary:
            temporary.write_text(text)


if __name__ == "__main__":
    program.run(main)

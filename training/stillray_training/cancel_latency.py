"""``python -m stillray_training.cancel_latency``: from the wish to end a frame to its end.

A frame of a stream is cancelled at moments spread evenly over what it takes; the time from the
moment to the return of the call is measured, so that pieces of work count by how long they are.
Sizes are those of pictures: models that double get frames of half as many pixels along each axis.
On a machine that others use too, `--processor` says what it would be without them, at most: the
processor time of all threads from wish to return. `--gaps` measures instead how long the caller is
not asked, on one thread, where no strip runs beside another.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

import stillray
from stillray.families.contract import State
from stillray.profiling.synthetic import swing

Clock = Callable[[], float]
SIZES = {"720p": (720, 1280), "4K": (2160, 3840)}
#: What is found by name alone.
UNLISTED = ("munet-x2", "online")


def stream(denoiser: stillray.Denoiser, shape: tuple[int, int]) -> tuple[stillray.Frame, ...]:
    """Two frames, each the other's past, with all that a model takes, for pictures of a shape."""
    height, width = (size // denoiser.scale for size in shape)
    inputs = denoiser.model.spec.inputs
    takes = {*inputs.required, *inputs.optional}
    made = []
    for index, frame in enumerate(swing(height, width)):
        more: dict[str, np.ndarray] = {}
        if "color_b" in takes:
            more["color_b"] = swing(height, width, seed=1)[index].color
        if "roughness" in takes:
            more["roughness"] = np.full((height, width), 0.5, np.float32)
        if "specular_albedo" in takes:
            more["specular_albedo"] = np.full((height, width, 3), 0.04, np.float32)
        if "jitter" in takes:
            more["jitter"] = np.array([0.25, -0.25]) * (1 - 2 * index)
        made.append(replace(frame, **more))  # type: ignore[arg-type]
    return tuple(made)


def latencies(model: str, shape: tuple[int, int], count: int, clock: Clock) -> list[float]:
    """Milliseconds from wish to return, at so many moments of a second frame."""
    found = []
    with stillray.Denoiser(model) as denoiser:
        frames = stream(denoiser, shape)
        denoiser.denoise(frames[0])
        state = denoiser.state
        took = _seconds(denoiser, frames[1], state, clock)
        for moment in (np.arange(count) + 0.5) / count * took:
            denoiser.state = state
            wish = clock() + moment
            try:
                denoiser.denoise(frames[1], progress=_until(wish, clock))
            except stillray.Cancelled:
                found.append(1e3 * (clock() - wish))
    return found


def gaps(model: str, shape: tuple[int, int], repeats: int) -> tuple[float, float, str]:
    """The longest time between two looks of a second frame, from call to return, on one thread.

    The frame is denoised some times, and of each gap the shortest counts: others on the machine
    lengthen one now and then, and memory that is used for the first time.

    Returns
    -------
    processor, wall
        Milliseconds, each the longest of its own: of this thread's processor time, which work of
        others does not lengthen but by what it takes of the caches, and of the wall clock.
    stage
        The last that had ended before the longest of processor time began.
    """
    clocks = (time.thread_time, time.perf_counter)
    shortest: dict[tuple[tuple[str, ...], int], list[float]] = {}
    with stillray.Denoiser(model, threads=1) as denoiser:
        first, second = stream(denoiser, shape)
        denoiser.denoise(first)
        state = denoiser.state
        for _ in range(repeats):
            denoiser.state = state
            for key, gap in _gaps_of(denoiser, second, clocks).items():
                known = shortest.setdefault(key, gap)
                shortest[key] = [min(pair) for pair in zip(known, gap, strict=True)]
    longest = max(shortest, key=lambda key: shortest[key][0])
    wall = max(gap[1] for gap in shortest.values())
    return 1e3 * shortest[longest][0], 1e3 * wall, (longest[0] or ("none",))[-1]


def _gaps_of(
    denoiser: stillray.Denoiser, frame: stillray.Frame, clocks: tuple[Clock, ...]
) -> dict[tuple[tuple[str, ...], int], list[float]]:
    """Seconds between looks, by the stages that had ended and the number of looks since."""
    found: dict[tuple[tuple[str, ...], int], list[float]] = {}
    last, count = [clock() for clock in clocks], 0
    ended: tuple[str, ...] = ()

    def look(_: float) -> bool:
        nonlocal last, ended, count
        found[ended, count] = [clock() - before for clock, before in zip(clocks, last, strict=True)]
        now = tuple(denoiser.last_timings)
        ended, count = now, count + 1 if now == ended else 0
        last = [clock() for clock in clocks]
        return True

    denoiser.denoise(frame, progress=look)
    look(1.0)
    return found


def _until(wish: float, clock: Clock) -> Callable[[float], bool]:
    return lambda _: clock() < wish


def _seconds(
    denoiser: stillray.Denoiser, frame: stillray.Frame, state: State | None, clock: Clock
) -> float:
    denoiser.state = state
    start = clock()
    denoiser.denoise(frame, progress=lambda _: True)
    return clock() - start


def main() -> None:
    """Print a row for each model and size."""
    parser = argparse.ArgumentParser(description="How soon a frame ends that is cancelled.")
    parser.add_argument("--model", action="append", help="default: all, those on trial too")
    parser.add_argument("--size", action="append", choices=SIZES, help="default: all")
    parser.add_argument("--moments", type=int, default=24)
    parser.add_argument("--processor", action="store_true", help="not wall time")
    parser.add_argument("--gaps", action="store_true", help="between looks, one thread")
    parser.add_argument("--repeats", type=int, default=3, help="frames whose least gaps count")
    given = parser.parse_args()
    models = given.model or [*(info.name for info in stillray.list_models()), *UNLISTED]
    if given.gaps:
        cv2.setNumThreads(1)
        print("| model | size | processor ms | wall ms | after |\n|---|---|---|---|---|")
        for model in models:
            for size in given.size or SIZES:
                processor, wall, stage = gaps(model, SIZES[size], given.repeats)
                row = f"| {model} | {size} | {processor:.0f} | {wall:.0f} | {stage} |"
                print(row, flush=True)
        return
    clock = time.process_time if given.processor else time.perf_counter
    print("| model | size | median ms | worst ms |\n|---|---|---|---|")
    for model in models:
        for size in given.size or SIZES:
            found = latencies(model, SIZES[size], given.moments, clock)
            print(f"| {model} | {size} | {np.median(found):.0f} | {max(found):.0f} |", flush=True)


if __name__ == "__main__":
    main()

"""``python -m stillray_training.cancel_latency``: from the wish to end a frame to its end.

A frame of a stream is cancelled at moments spread evenly over what it takes; the time from the
moment to the return of the call is measured, so that pieces of work count by how long they are.
On a machine that others use too, `--processor` says what it would be without them, at most: the
processor time of all threads from wish to return. `--gaps` measures instead how long the caller is
not asked, on one thread, where no strip runs beside another.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import cv2
import numpy as np

import stillray
from stillray.families.contract import State
from stillray.profiling.synthetic import swing

Clock = Callable[[], float]
SIZES = {"720p": (720, 1280), "4K": (2160, 3840)}


def latencies(model: str, shape: tuple[int, int], count: int, clock: Clock) -> list[float]:
    """Milliseconds from wish to return, at so many moments of a second frame."""
    frames = swing(*shape)
    found = []
    with stillray.Denoiser(model) as denoiser:
        denoiser.denoise(frames[0])
        state = denoiser.state
        took = min(_seconds(denoiser, frames[1], state, clock) for _ in range(2))
        for moment in (np.arange(count) + 0.5) / count * took:
            denoiser.state = state
            wish = clock() + moment
            try:
                denoiser.denoise(frames[1], progress=_until(wish, clock))
            except stillray.Cancelled:
                found.append(1e3 * (clock() - wish))
    return found


def gaps(model: str, shape: tuple[int, int], frames: int = 3) -> tuple[float, float]:
    """The longest time between two looks of some frames, from call to return, on one thread.

    Returns
    -------
    processor, wall
        Milliseconds, each the longest of its own: of this thread's processor time, which work of
        others on the machine does not lengthen but by what it takes of the caches, and of the wall
        clock.
    """
    given, clocks = swing(*shape), (time.thread_time, time.perf_counter)
    worst, last = [0.0, 0.0], [0.0, 0.0]

    def look(_: float) -> bool:
        for index, clock in enumerate(clocks):
            now = clock()
            worst[index] = max(worst[index], now - last[index])
            last[index] = now
        return True

    with stillray.Denoiser(model, threads=1) as denoiser:
        for index in range(frames):
            last[:] = [clock() for clock in clocks]
            denoiser.denoise(given[index % 2], progress=look)
            look(1.0)
    return 1e3 * worst[0], 1e3 * worst[1]


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
    parser.add_argument("--model", action="append", help="default: all packaged")
    parser.add_argument("--size", action="append", choices=SIZES, help="default: all")
    parser.add_argument("--moments", type=int, default=24)
    parser.add_argument("--processor", action="store_true", help="not wall time")
    parser.add_argument("--gaps", action="store_true", help="between looks, one thread")
    given = parser.parse_args()
    models = given.model or [info.name for info in stillray.list_models()]
    if given.gaps:
        cv2.setNumThreads(1)
        print("| model | size | processor ms | wall ms |\n|---|---|---|---|")
        for model in models:
            for size in given.size or SIZES:
                processor, wall = gaps(model, SIZES[size])
                print(f"| {model} | {size} | {processor:.0f} | {wall:.0f} |", flush=True)
        return
    clock = time.process_time if given.processor else time.perf_counter
    print("| model | size | median ms | worst ms |\n|---|---|---|---|")
    for model in models:
        for size in given.size or SIZES:
            found = latencies(model, SIZES[size], given.moments, clock)
            print(f"| {model} | {size} | {np.median(found):.0f} | {max(found):.0f} |", flush=True)


if __name__ == "__main__":
    main()

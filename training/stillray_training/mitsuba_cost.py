"""``python -m stillray_training.mitsuba_cost``: what `stillray.mitsuba.Denoiser` adds to a frame.

A sequence of tensors is denoised with all that can be given, the last picture too. Of each call
the time before and after the stream's own `denoise` counts, of the calling thread, which alone
does it: processor time, which work of others does not lengthen, and that of the wall clock. Beside
it stands what copies alone take, in processor time, at the same moment: of flow into memory that is
there, which its negation cannot be faster than, and of a picture into new memory, which scalar
variants make their tensor by.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import mitsuba as mi
import numpy as np

import stillray
from stillray.mitsuba import Denoiser
from stillray.profiling.synthetic import swing

_CLOCKS = (time.thread_time, time.perf_counter)


class _Timed(stillray.Denoiser):
    """A stream that knows how long its last frame took, by each clock."""

    took: tuple[float, ...] = ()

    def denoise(self, *arguments: Any, **named: Any) -> np.ndarray:
        start = [clock() for clock in _CLOCKS]
        picture = super().denoise(*arguments, **named)
        self.took = tuple(clock() - began for clock, began in zip(_CLOCKS, start, strict=True))
        return picture


def costs(
    model: str, shape: tuple[int, int], count: int, threads: int | None = None
) -> tuple[list[tuple[float, ...]], list[tuple[float, ...]]]:
    """What so many calls cost, after two more, and what copies do.

    Parameters
    ----------
    model, threads
        As `stillray.Denoiser` takes them.
    shape
        Height and width.
    count
        Calls.

    Returns
    -------
    calls
        Milliseconds of processor time and of the wall clock, of each.
    copies
        Milliseconds of processor time, of a copy of flow and one of a picture, after each.
    """
    frames = [_tensors(frame) for frame in swing(*shape)]
    found: list[tuple[float, ...]] = []
    copies: list[tuple[float, ...]] = []
    memory = np.ones((*shape, 2), np.float32)
    before = frames[0][0]
    with Denoiser(shape[::-1], True, True, temporal=True, model=model, threads=1) as denoiser:
        denoiser.stream.close()
        denoiser.stream = stream = _Timed(model, threads=threads)
        for index in range(count + 2):
            noisy, albedo, normals, flow = frames[index % 2]
            start = [clock() for clock in _CLOCKS]
            before = denoiser(noisy, albedo, normals, flow=flow, previous_denoised=before)
            ends = [clock() for clock in _CLOCKS]
            parts = zip(start, ends, stream.took, strict=True)
            found.append(tuple(1e3 * (end - began - took) for began, end, took in parts))
            # of the next frame, which no cache holds
            following = np.asarray(frames[(index + 1) % 2][3])
            copies.append((_processor_ms(partial(np.copyto, memory, following)),
                           _processor_ms(np.asarray(before).copy)))  # fmt: skip
    return found[2:], copies[2:]


def _processor_ms(work: Callable[[], object]) -> float:
    start = time.thread_time()
    made = work()
    took = time.thread_time() - start
    del made  # after the clock: memory is given back later, if ever
    return 1e3 * took


def _tensors(frame: stillray.Frame) -> list[Any]:
    """Color, albedo, normals and flow."""
    names = ("color", "albedo", "normal", "motion")
    *images, motion = (np.asarray(getattr(frame, name)) for name in names)
    return [mi.TensorXf(image) for image in (*images, -motion)]


def main() -> None:
    """Print a row for each of Mitsuba's variants."""
    parser = argparse.ArgumentParser(description="What the adapter to Mitsuba adds to a frame.")
    parser.add_argument("--model", default="fast")
    parser.add_argument("--size", default="1280x720", help="width x height; default 1280x720")
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--variant", action="append", help="default: scalar_rgb, llvm_ad_rgb")
    given = parser.parse_args()
    width, height = (int(extent) for extent in given.size.split("x"))
    print("| variant | processor ms: median | worst | wall ms: median | worst "
          "| copy of flow | copy of a picture |")  # fmt: skip
    print("|---|---|---|---|---|---|---|")
    for variant in given.variant or ("scalar_rgb", "llvm_ad_rgb"):
        mi.set_variant(variant)
        calls, copies = (np.array(t) for t in costs(given.model, (height, width), given.frames))
        cells = [f"{f(calls[:, clock]):.2f}" for clock in (0, 1) for f in (np.median, np.max)]
        cells += [f"{time:.2f}" for time in np.median(copies, axis=0)]
        print(f"| {variant} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()

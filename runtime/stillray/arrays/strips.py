"""Row strips: element-wise stages run in cache-sized pieces, on several threads.

NumPy and OpenCV release the interpreter lock while they compute, so plain threads scale, and a
strip that fits the processor's cache saves most of the memory traffic of whole-frame temporaries.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import TypeVar

import cv2
import numpy as np

from stillray.arrays.watch import INTERVAL, Watch
from stillray.arrays.workspace import Workspace

# 512 KiB a float32 plane. Smaller strips stay in a nearer cache, but each has a price, more than a
# millisecond where it runs through two hundred calls; and a filter reads rows beyond it.
STRIP_PIXELS = 1 << 17
#: Of passes of many short calls that seldom come back to an array: half as many wait for the
#: interpreter's lock (a fifth of reprojection's time on two threads, docs/decisions.md). Filters,
#: which do come back, take a tenth longer so.
LARGE_STRIP_PIXELS = 2 * STRIP_PIXELS
# What strips are cut to must not depend on the threads, so that pictures do not either.
_SHARES = 8  # strips of a small frame, for as many threads; of large ones half as many
# Of less work, threads spend more on waiting for the interpreter's lock: a call of 15 microseconds
# on each of two threads at once takes up to 30.
_LEAST_PIXELS = 1 << 16
_EVEN = 4  # the number of strips is a multiple of it: two or four threads end together

Result = TypeVar("Result")


class Strips:
    """Runs a function over the row strips of frames.

    Parameters
    ----------
    threads
        Worker threads, 1 or more; 1 runs in the caller's thread.
    pixels
        Of a strip, at most, but where a call asks for fewer, which then get fewer in proportion.
        Tests take few, so that small frames have several strips.
    """

    def __init__(self, threads: int, *, pixels: int = STRIP_PIXELS) -> None:
        #: Looked at between strips; within one, by work that takes long.
        self.watch = Watch()
        self._pixels = pixels
        self._pool = ThreadPoolExecutor(threads, "stillray") if threads > 1 else None
        self._local = threading.local()

    @property
    def workspace(self) -> Workspace:
        """Arrays of the calling thread, for temporaries within a strip."""
        if not hasattr(self._local, "workspace"):
            self._local.workspace = Workspace()
        workspace: Workspace = self._local.workspace
        return workspace

    def run(
        self,
        work: Callable[[slice], Result],
        height: int,
        width: int,
        *,
        pixels: int = STRIP_PIXELS,
    ) -> list[Result]:
        """Call ``work(rows)`` for every strip of a frame; strips do not overlap.

        Calls may run at the same time, on several threads.

        Parameters
        ----------
        work
            Gets the rows of its strip.
        height, width
            Of the frame, pixels.
        pixels
            At most so many in a strip, though at least a row.

        Returns
        -------
        list
            What each call returned, from the top.
        """
        strips = self.of(height, width, pixels=pixels)
        if self._pool is None or len(strips) == 1:
            results = []
            for strip in strips:
                self.watch.look()
                results.append(work(strip))
            return results
        if self.watch.active:
            return self._watched(work, strips)
        # list() waits for all and raises what any of them raised
        return list(self._pool.map(work, strips))

    def run_even(
        self,
        work: Callable[[slice], Result],
        height: int,
        width: int,
        *,
        pixels: int = STRIP_PIXELS,
    ) -> list[Result]:
        """`run`, with strips that begin at an even row: blocks of 2x2 pixels lie whole in one."""

        def strip(blocks: slice) -> Result:
            return work(slice(2 * blocks.start, min(2 * blocks.stop, height)))

        return self.run(strip, -(-height // 2), 2 * width, pixels=pixels)  # of two rows each

    def _watched(self, work: Callable[[slice], Result], strips: list[slice]) -> list[Result]:
        assert self._pool is not None
        futures = [self._pool.submit(work, strip) for strip in strips]
        try:
            self.watch.look()
            while wait(futures, timeout=INTERVAL).not_done:
                self.watch.look()
            return [future.result() for future in futures]
        except BaseException:
            self.watch.end()
            for future in futures:
                future.cancel()
            wait(futures)  # strips in work write to arrays that the next frame takes
            raise

    def of(self, height: int, width: int, *, pixels: int = STRIP_PIXELS) -> list[slice]:
        """The rows of each strip of a frame, as `run` would cut it."""
        return strips_of(height, width, max(pixels * self._pixels // STRIP_PIXELS, 1))

    def close(self) -> None:
        """Stop the threads."""
        if self._pool is not None:
            self._pool.shutdown()


def strips_of(height: int, width: int, pixels: int = STRIP_PIXELS) -> list[slice]:
    """The rows of each strip, from the top; the last may be lower than the others."""
    most_rows = max(pixels // width, 1)
    shares = max(_SHARES * STRIP_PIXELS // max(pixels, STRIP_PIXELS), 1)
    count = max(-(-height // most_rows), min(height * width // _LEAST_PIXELS, shares))
    if count > 1:
        count = -(-count // _EVEN) * _EVEN
    rows = -(-height // count)
    return [slice(top, min(top + rows, height)) for top in range(0, height, rows)]


def with_halo(rows: slice, halo: int, height: int) -> tuple[slice, slice]:
    """The rows with up to ``halo`` more on each side, and where the rows lie among those."""
    top = max(rows.start - halo, 0)
    return slice(top, min(rows.stop + halo, height)), slice(rows.start - top, rows.stop - top)


def planes_of(image: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
    """The channels of ``(h, w, c)`` as ``(c, h, w)``.

    Parameters
    ----------
    image : (h, w, c) float32
    out : (c, h, w) float32, optional
        Written and returned.
    """
    height, width, channels = image.shape
    if out is None:
        out = np.empty((channels, height, width), np.float32)
    if channels == 3:
        cv2.split(image, list(out))
    else:  # as matrices, in four fifths of the time of cv2.split
        cv2.transpose(_flat(image), dst=out.reshape(channels, -1))
    return out


def interleave(planes: np.ndarray, out: np.ndarray) -> np.ndarray:
    """`planes_of` undone: ``(c, h, w)`` into ``out`` of ``(h, w, c)``."""
    if len(planes) == 4:
        cv2.transpose(planes.reshape(4, -1), dst=_flat(out))
    else:
        cv2.merge(list(planes), dst=out)
    return out


def without_fourth(image: np.ndarray, strips: Strips) -> np.ndarray:
    """The first three channels of ``(h, w, 4)`` float32, in an array of their own."""
    result = np.empty((*image.shape[:2], 3), np.float32)

    def work(rows: slice) -> None:
        result[rows] = image[rows, :, :3]

    strips.run(work, *image.shape[:2])
    return result


def pixels_of(image: np.ndarray) -> np.ndarray:
    """The pixels of ``(h, w, 2)`` or ``(h, w, 4)`` float32, in C order, as ``h w`` single elements.

    A view: NumPy picks and puts those many times faster than rows of a few floats.
    """
    kind = {2: np.complex64, 4: np.complex128}[image.shape[-1]]
    return image.reshape(-1).view(kind)


def _flat(image: np.ndarray) -> np.ndarray:
    return image.reshape(-1, image.shape[-1])


def available_threads() -> int:
    """Processors that this process may use: its affinity, which containers set, not the machine."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1

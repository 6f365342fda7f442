"""Row strips: element-wise stages run in cache-sized pieces, on several threads.

NumPy and OpenCV release the interpreter lock while they compute, so plain threads scale, and a
strip that fits the processor's cache saves most of the memory traffic of whole-frame temporaries.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

# 512 KiB a float32 plane. Smaller strips stay in a nearer cache, but each has a price: a call on
# a thread, the rows that a filter reads beyond it. 1 << 15 was measured a third slower.
STRIP_PIXELS = 1 << 17
LEAST_ROWS = 32


class Strips:
    """Runs a function over the row strips of frames.

    Parameters
    ----------
    threads
        Worker threads, 1 or more; 1 runs in the caller's thread.
    """

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._pool = ThreadPoolExecutor(threads, "stillray") if threads > 1 else None

    def run(self, work: Callable[[slice], None], height: int, width: int) -> None:
        """Call ``work(rows)`` for every strip of a frame; strips do not overlap.

        Calls may run at the same time, on several threads.
        """
        # a small frame is shared among all threads, though not in slivers
        share = max(-(-height // self._threads), LEAST_ROWS)
        rows = max(1, min(STRIP_PIXELS // width, share))
        strips = [slice(top, min(top + rows, height)) for top in range(0, height, rows)]
        if self._pool is None or len(strips) == 1:
            for strip in strips:
                work(strip)
        else:
            # list() waits for all and raises what any of them raised
            list(self._pool.map(work, strips))

    def close(self) -> None:
        """Stop the threads."""
        if self._pool is not None:
            self._pool.shutdown()


def planes_of(image: np.ndarray) -> list[np.ndarray]:
    """The channels of ``(h, w, c)`` as contiguous copies (cv2.split takes twice as long)."""
    return [np.ascontiguousarray(image[..., channel]) for channel in range(image.shape[2])]


def available_threads() -> int:
    """Processors that this process may use: its affinity, which containers set, not the machine."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1

"""Milliseconds of each stage, also of stages that share one pass over the strips of a frame."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager

_USUAL_STAGES = 12  # of a first frame, without a past
Part = Callable[[str], AbstractContextManager[None]]


@contextmanager
def timed(timings: dict[str, float], name: str) -> Iterator[None]:
    """Add the milliseconds of the block to ``timings[name]``."""
    start = time.perf_counter()
    yield
    timings[name] = timings.get(name, 0.0) + 1e3 * (time.perf_counter() - start)


@contextmanager
def timed_pass(timings: dict[str, float]) -> Iterator[Part]:
    """Time a block in which several threads work on several stages.

    Yields ``part``: work of a stage goes into ``with part(name)``, on any thread. The block's time
    is shared among the stages like the time that the threads spent in them.
    """
    spent: list[tuple[str, float]] = []  # list.append may be called on several threads

    @contextmanager
    def part(name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        spent.append((name, time.perf_counter() - start))

    start = time.perf_counter()
    yield part
    wall = 1e3 * (time.perf_counter() - start)
    total = sum(seconds for _, seconds in spent)
    for name, seconds in spent:
        timings[name] = timings.get(name, 0.0) + wall * seconds / total


def share_done(timings: Mapping[str, float], before: Mapping[str, float]) -> float:
    """The share of a frame that is done, 0 to 1: of what its stages took in the frame before.

    Parameters
    ----------
    timings
        Of the stages that ended.
    before
        Of the frame before; empty without one: then stages are taken to be about as many as the
        packaged models have, and alike.
    """
    total = sum(before.values())
    if total == 0:
        return min(len(timings) / _USUAL_STAGES, 1.0)
    return min(sum(before.get(name, 0.0) for name in timings) / total, 1.0)

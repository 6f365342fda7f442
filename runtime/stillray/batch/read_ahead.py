"""Reading ahead and writing behind, so that work does not wait for files."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Read = TypeVar("Read")
Result = TypeVar("Result")
Written = TypeVar("Written")

#: Items that are read ahead of the work, and results that may wait to be written.
AHEAD = 2


def run_overlapped(
    items: Iterable[Item],
    read: Callable[[Item], Read],
    work: Callable[[Item, Read], Result],
    write: Callable[[Item, Result], Written],
    report: Callable[[Item, Written], None],
    *,
    ahead: int = AHEAD,
) -> None:
    """Read, work on and write items in order; the three run at the same time on different items.

    Whatever raises ends the run with that error, once, after all that was worked on before it has
    been written and reported. If several items fail, the error of the first of them is raised.

    Parameters
    ----------
    items
        What there is to do, in order.
    read
        Called in a thread of its own, up to ``ahead`` items before the work.
    work
        Called in the caller's thread.
    write
        Called in a thread of its own.
    report
        Called in the caller's thread when an item is written.
    ahead
        Items that are read and not yet worked on, and worked on and not yet written, at most:
        what bounds the memory. 1 or more.
    """
    todo = iter(items)
    reads: deque[tuple[Item, Future[Read]]] = deque()
    writes: deque[tuple[Item, Future[Written]]] = deque()

    def finish_one() -> None:
        item, future = writes[0]
        try:
            written = future.result()
        except Exception:
            for _, later in writes:
                later.cancel()
            writes.clear()
            raise
        writes.popleft()
        report(item, written)

    with (
        ThreadPoolExecutor(1, "stillray-read") as reader,
        ThreadPoolExecutor(1, "stillray-write") as writer,
    ):
        try:
            while True:
                while len(reads) < ahead and (item := next(todo, None)) is not None:
                    reads.append((item, reader.submit(read, item)))
                if not reads:
                    break
                item, future = reads.popleft()
                result = work(item, future.result())
                del future  # it holds on to a frame
                while writes and (len(writes) >= ahead or writes[0][1].done()):
                    finish_one()
                writes.append((item, writer.submit(write, item, result)))
                del result
            while writes:
                finish_one()
        except BaseException:  # also an interrupt from the keyboard
            for _, unread in reads:
                unread.cancel()
            while writes:
                finish_one()
            raise

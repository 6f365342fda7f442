"""A look at a frame in work: how far it is, and whether its caller still wants it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from stillray.errors import Cancelled

#: Told the share of a frame that is done, 0 to 1; False ends it, None and True go on.
Progress = Callable[[float], object]
#: Seconds between looks while other threads work.
INTERVAL = 0.01


class Watch:
    """Asks the caller between pieces of work, in the caller's own thread."""

    def __init__(self) -> None:
        self._ask: Progress | None = None
        self._share: Callable[[], float] = lambda: 0.0
        self._caller, self._ended = 0, False

    @property
    def active(self) -> bool:
        """Whether somebody looks."""
        return self._ask is not None

    @contextmanager
    def over(self, ask: Progress | None, share: Callable[[], float]) -> Iterator[None]:
        """Look on within the block.

        Parameters
        ----------
        ask
            Of the caller; None for nobody.
        share
            Gives the share that is done.
        """
        self._ask, self._share = ask, share
        self._caller, self._ended = threading.get_ident(), False
        try:
            yield
        finally:
            self._ask = None

    def end(self) -> None:
        """Work of other threads is not wanted any more: their next look ends it."""
        self._ended = True

    def look(self) -> None:
        """Tell the caller how far it is; on another thread, learn whether it still matters.

        Raises
        ------
        Cancelled
            The caller wants no more of it.
        """
        if self._ask is None:
            return
        if threading.get_ident() != self._caller:
            if self._ended:
                raise Cancelled("the frame was ended on another thread")
            return
        self._tell(self._share())

    def last(self) -> None:
        """Tell the caller that all is done: the last moment at which he can want no more of it.

        Raises
        ------
        Cancelled
            He does not.
        """
        if self._ask is not None:
            self._tell(1.0)

    def _tell(self, share: float) -> None:
        assert self._ask is not None
        answer = self._ask(share)
        if answer is not None and not answer:  # False of Python, NumPy or C
            raise Cancelled("the frame was cancelled: progress returned False")

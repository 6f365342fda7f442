"""Who may use a denoiser now: errors in words where threads would wait for ever, or mix frames."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from stillray.errors import InputError


class Turns:
    """One call at a time, in the process that made it, until it is closed."""

    def __init__(self) -> None:
        self._process = os.getpid()
        self._busy = threading.Lock()
        self._closed = False

    @contextmanager
    def take(self) -> Iterator[None]:
        """The turn of one call.

        Raises
        ------
        InputError
            It was closed, this is a forked child, or another thread's call is not done.
        """
        if self._closed:
            raise InputError("the denoiser must be open, it was closed")
        if os.getpid() != self._process:
            raise InputError(
                "the denoiser must be made in the process that uses it: its threads are not in "
                f"process {os.getpid()}, forked from {self._process}"
            )
        if not self._busy.acquire(blocking=False):
            raise InputError("the denoiser must be used by one thread at a time: make one for each")
        try:
            yield
        finally:
            self._busy.release()

    def close(self) -> None:
        """No more turns."""
        self._closed = True

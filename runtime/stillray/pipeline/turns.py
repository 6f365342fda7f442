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
        self._thread = 0  # whose call it is, while there is one
        self._closed = False

    @contextmanager
    def take(self) -> Iterator[None]:
        """The turn of one call.

        Raises
        ------
        InputError
            It was closed, this is a forked child, or another call is not done: of another thread,
            or the one from within which this one comes.
        """
        if os.getpid() != self._process:
            raise InputError(
                "the denoiser must be made in the process that uses it: its threads are not in "
                f"process {os.getpid()}, forked from {self._process}"
            )
        with self._alone():
            if self._closed:
                raise InputError("the denoiser must be open, it was closed")
            yield

    def close(self) -> None:
        """No more turns; may be called again.

        Raises
        ------
        InputError
            A call is not done.
        """
        if os.getpid() != self._process:  # no call goes on here, whatever the parent's lock says
            self._closed = True
            return
        with self._alone():
            self._closed = True

    @contextmanager
    def _alone(self) -> Iterator[None]:
        if not self._busy.acquire(blocking=False):
            if self._thread == threading.get_ident():
                raise InputError(
                    "the denoiser must not be used from within its own frame, as in progress: let "
                    "that end first"
                )
            raise InputError("the denoiser must be used by one thread at a time: make one for each")
        self._thread = threading.get_ident()
        try:
            yield
        finally:
            self._thread = 0
            self._busy.release()

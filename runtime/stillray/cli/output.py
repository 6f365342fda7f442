"""Where the commands print: fitted to a terminal, unwrapped into pipes and files."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

_UNWRAPPED_COLUMNS = 400  # wider than any table here


def console() -> Console:
    """A console on standard output."""
    from rich.console import Console

    width = None if sys.stdout.isatty() else _UNWRAPPED_COLUMNS
    return Console(width=width, highlight=False, markup=False, soft_wrap=False)


@contextmanager
def status(begin: str) -> Iterator[Callable[[str], None]]:
    """One line on a terminal's standard error that says what is being done; nothing elsewhere."""
    from rich.console import Console

    with Console(stderr=True, markup=False).status(begin) as line:
        yield line.update

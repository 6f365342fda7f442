"""Programs run with ``python -m``: options from a function's signature, errors in one line."""

from __future__ import annotations

import sys
from collections.abc import Callable

import typer

from stillray.errors import InputError


def run(function: Callable[..., None]) -> None:
    """Run a function as a program; bad input ends it with one line and exit code 2."""
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command()(function)
    try:
        app()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)

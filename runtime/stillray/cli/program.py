"""How programs end: errors in one line, exit codes 0 done, 1 failed, 2 bad usage or input."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module

import typer

from stillray.errors import InputError, printable

DONE, FAILED, BAD_INPUT = 0, 1, 2


def run(function: Callable[..., None]) -> None:
    """Run a function as a program of ``python -m``: its signature gives the options.

    Bad input ends it with one line and exit code 2.
    """
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command()(function)
    try:
        app()
    except InputError as error:
        sys.exit(complain(str(error), BAD_INPUT))


def run_extra(module: str, function: str, extra: str) -> None:
    """`run` a function of a module whose libraries an extra of the package installs.

    Where they are missing, one line says which extra to install; exit code 1.
    """
    try:
        loaded = import_module(module)
    except ModuleNotFoundError as error:
        hint = f"pip install 'stillray[{extra}]'"
        sys.exit(complain(f"{error.name} is not installed: {hint}", FAILED))
    run(getattr(loaded, function))


def complain(message: str, code: int) -> int:
    """Print an error as one line on standard error; the exit code is given back."""
    print("error: " + printable(message), file=sys.stderr)
    return code

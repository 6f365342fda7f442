"""The ``stillray`` command: one module a subcommand, errors in one line, exit codes 0, 1, 2."""

from __future__ import annotations

import os
import re
import sys
import traceback
from collections.abc import Sequence
from typing import Any

import typer

from stillray.cli.compare import compare
from stillray.cli.denoise import denoise
from stillray.cli.doctor import doctor
from stillray.cli.info import info
from stillray.cli.models import models
from stillray.cli.oidn_flags import spell_out
from stillray.cli.profile import profile
from stillray.cli.program import BAD_INPUT, DONE, FAILED, complain
from stillray.cli.tradeoff import tradeoff
from stillray.errors import InputError

_COMPLETE = "_STILLRAY_COMPLETE"  # set by a shell that asks how words may end, not for a run
_INTERRUPTED = 130  # what newer versions of typer make of Ctrl-C, where others raise Abort


def build_app() -> typer.Typer:
    """The command-line application with all its subcommands."""
    app = typer.Typer(
        name="stillray",
        help="Denoise Monte Carlo renders of one to a few samples per pixel.",
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )
    app.callback()(_version_option)
    for command in (compare, denoise, doctor, info, models, profile, tradeoff):
        app.command()(command)
    return app


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments
        Without the program's name; None for the process's own.

    Returns
    -------
    int
        Exit code: 0 done, 1 failed, 2 bad usage or input.
    """
    command = typer.main.get_command(build_app())
    given = spell_out(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    try:
        text = _help_alone(command, given)
        if text is None:
            code = command.main(args=given, prog_name="stillray", standalone_mode=False)
        else:
            print(text)
            code = DONE
        sys.stdout.flush()  # a closed pipe shows here, not on the interpreter's way out
    except InputError as error:
        return complain(_with_dashes(str(error)), BAD_INPUT)
    except _usage_error() as error:
        return complain(error.format_message() + _refused_value(error), BAD_INPUT)
    except (typer.Abort, KeyboardInterrupt):
        return complain("interrupted", FAILED)
    except BrokenPipeError:  # the reader, such as `head`, has had enough
        # the interpreter flushes once more when it ends: let that go nowhere
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except Exception as error:
        traceback.print_exc()
        return complain(f"unexpected {type(error).__name__}: {error}", FAILED)
    if code == _INTERRUPTED:
        return complain("interrupted", FAILED)
    return code if isinstance(code, int) else DONE


def _help_alone(command: Any, given: Sequence[str]) -> str | None:
    """What ``--help`` or ``NAME --help`` print; None where something else is asked.

    The parser would give the same text, but converts values first, for which typer loads pydantic:
    half of the time that a help text takes.
    """
    if _COMPLETE in os.environ:
        return None
    *names, last = given
    if last != "--help" or names != [name for name in names[:1] if name in command.commands]:
        return None
    context = command.context_class(command, info_name="stillray")
    for name in names:
        command = command.commands[name]
        context = command.context_class(command, info_name=name, parent=context)
    text: str = command.get_help(context)
    return text


def _usage_error() -> type[typer.BadParameter]:
    # The base of all usage errors has no public name that all versions of typer share.
    bases = [base for base in typer.BadParameter.__mro__ if hasattr(base, "format_message")]
    return bases[-1]


def _with_dashes(message: str) -> str:
    """A message that begins with an argument's name in Python, with that of its option."""
    return re.sub(r"^[a-z]+(_[a-z]+)+(?= must )", lambda name: name[0].replace("_", "-"), message)


def _refused_value(error: BaseException) -> str:
    """The value of an option that is no number, which typer's own message leaves out."""
    told = getattr(error.__cause__, "errors", None)  # pydantic's, whose words those are
    return f", got {told()[0]['input']!r}" if told else ""


def _print_version(wanted: bool) -> None:
    if wanted:
        from stillray.version import __version__

        print(f"stillray {__version__}")
        raise typer.Exit


def _version_option(
    version: bool = typer.Option(
        False, "--version", callback=_print_version, is_eager=True, help="Print the version."
    ),
) -> None:
    pass

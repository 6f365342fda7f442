"""What can be raised: input that cannot be used, how it reaches a terminal; a cancelled frame."""

from __future__ import annotations


class InputError(ValueError):
    """Bad input: the message names the argument, the rule it breaks and the value it had.

    The command line turns it into one line on standard error and exit code 2. The message is one
    line of `printable` text, whatever names from files stand in it.
    """

    def __init__(self, message: str) -> None:
        super().__init__(printable(message))


class Cancelled(Exception):  # noqa: N818
    """No error, the caller asked for it: a frame was ended, the history is as before the call."""


def printable(text: str) -> str:
    """A text in one line that a terminal takes for nothing but text.

    File names, channels and models come from others, and may hold commands for a terminal: control
    characters appear as Python writes them.
    """
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode()
        for c in " ".join(text.split())
    )

"""The one error a user sees for input that cannot be used."""

from __future__ import annotations


class InputError(ValueError):
    """Bad input: the message names the argument, the rule it breaks and the value it had.

    The command line turns it into one line on standard error and exit code 2.
    """

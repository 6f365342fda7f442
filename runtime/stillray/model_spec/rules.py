"""Rules that the numbers and names of a specification obey.

A specification may come from anybody. Its numbers set loops, windows and arrays: beyond the bounds
that its tables have a denoiser would not end, or not fit into memory, and no model that makes sense
comes near.
"""

from __future__ import annotations

import reprlib
from collections.abc import Iterable
from typing import Any

from stillray.errors import InputError


class SpecError(InputError):
    """A specification that cannot be used: the message names the key and the rule."""


#: Characters of a name.
MAX_NAME = 64


def within(key: str, value: float, low: float, high: float) -> None:
    """Raise `SpecError` unless a number lies within bounds."""
    if not low <= value <= high:
        raise SpecError(f"{key} must be in [{low:g}, {high:g}], got {brief(value)}")


def each(key: str, values: Iterable[int], low: int, high: int) -> None:
    """Raise `SpecError` unless all numbers lie within bounds."""
    for value in values:
        within(key, value, low, high)


def one_of(key: str, value: str, known: Iterable[str]) -> None:
    """Raise `SpecError` unless a word is known."""
    if value not in known:
        raise SpecError(f"{key} must be one of {', '.join(known)}, got {value[:MAX_NAME]}")


def odd(key: str, sizes: Iterable[int], most: int) -> None:
    """Raise `SpecError` unless all sizes are odd, and 1 to a number of pixels."""
    for size in sizes:
        if not 1 <= size <= most or size % 2 == 0:
            raise SpecError(f"{key} must be odd and 1 to {most} pixels, got {size}")


def brief(value: Any) -> str:
    """A value in a message: what a file holds may be long, or deep."""
    return reprlib.repr(value)

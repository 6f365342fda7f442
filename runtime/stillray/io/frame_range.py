"""Frame numbers as a user writes them: ``10-80``, ``10-80x2``, ``1,5,10-20``."""

from __future__ import annotations

import re
from collections.abc import Sequence

from stillray.errors import InputError

_PART = re.compile(r"(\d+)(?:-(\d+)(?:x(\d+))?)?")
_MOST_FRAMES = 1_000_000  # more is a slip of the finger, and would fill the memory


def parse_frames(text: str) -> list[int]:
    """Frame numbers in order, each once.

    Parameters
    ----------
    text
        Numbers and ranges (both ends included, ``x2`` for every second) between commas.

    Raises
    ------
    InputError
        The text is no such list.

    Examples
    --------
    >>> parse_frames("1,10-16x3")
    [1, 10, 13, 16]
    """
    numbers: set[int] = set()
    for part in text.split(","):
        hit = _PART.fullmatch(part.strip())
        if hit is None:
            raise InputError(f"frames must be numbers and ranges as 1,10-80,90-99x3, got {text}")
        first = int(hit[1])
        last, step = int(hit[2] or first), int(hit[3] or 1)
        if last < first:
            raise InputError(f"frames must count upwards, got {part.strip()}")
        if step < 1:
            raise InputError(f"frames must advance by 1 or more, got {part.strip()}")
        if (last - first) // step >= _MOST_FRAMES:
            raise InputError(f"frames must be at most {_MOST_FRAMES}, got {part.strip()}")
        numbers.update(range(first, last + 1, step))
    return sorted(numbers)


def format_frames(numbers: Sequence[int]) -> str:
    """Ascending frame numbers as `parse_frames` reads them, runs of successive ones in short.

    Examples
    --------
    >>> format_frames([1, 2, 3, 7])
    '1-3,7'
    """
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1][1:] = [number]
        else:
            runs.append([number])
    return ",".join("-".join(map(str, run)) for run in runs)

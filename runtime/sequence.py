"""Numbered files: ``shot.####.exr`` and ``shot.%04d.exr`` to frames in order, and back."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from stillray.errors import InputError

_PLACEHOLDER = re.compile(r"#+|%(?:0?([1-9]\d*))?d")


class NumberedFile(NamedTuple):
    """One frame of a sequence; ``number`` is None for a file named without a placeholder."""

    number: int | None
    path: Path


def has_placeholder(pattern: str | os.PathLike[str]) -> bool:
    """Whether the file name holds ``####`` or ``%04d`` and is not simply a file's own name."""
    path = Path(pattern)
    return _PLACEHOLDER.search(path.name) is not None and not path.is_file()


def expand(pattern: str | os.PathLike[str]) -> list[NumberedFile]:
    """The files that a pattern names, by frame number; gaps are left out.

    Parameters
    ----------
    pattern
        A file name, or one with ``####`` (a number of at least so many digits, filled with
        zeros) or ``%04d`` in its last component.

    Raises
    ------
    InputError
        Nothing matches, or the name holds two placeholders.

    Examples
    --------
    >>> expand("shot.####.exr")  # doctest: +SKIP
    [NumberedFile(number=1, path=PosixPath('shot.0001.exr'))]
    """
    path = Path(pattern)
    if not has_placeholder(path):
        if path.is_dir():
            raise InputError(
                f"{path}: is a folder; name a file, or a sequence as {path / 'shot.####.exr'}"
            )
        if not path.is_file():
            raise InputError(f"{path}: no such file")
        return [NumberedFile(None, path)]
    before, width, after = _split(path)
    # the number's one spelling at this width: more digits than that only without leading zeros
    digits = rf"(\d{{{width}}}|[1-9]\d{{{width},}})"
    matcher = re.compile(re.escape(before) + digits + re.escape(after))
    try:
        names = os.listdir(path.parent)
    except OSError as error:
        raise InputError(f"{path.parent}: cannot be listed: {error.strerror}") from None
    found = [
        NumberedFile(int(hit[1]), path.parent / name)
        for name in names
        if (hit := matcher.fullmatch(name)) and (path.parent / name).is_file()
    ]
    if not found:
        raise InputError(f"{path}: no file matches this pattern")
    return sorted(found)


def numbered(pattern: str | os.PathLike[str], number: int) -> Path:
    """The file name of one frame."""
    path = Path(pattern)
    before, width, after = _split(path)
    return path.with_name(f"{before}{number:0{width}d}{after}")


def map_companions(
    pattern: str | os.PathLike[str], frames: Sequence[NumberedFile], *, name: str
) -> list[Path]:
    """The file of every frame that another pattern names, such as outputs or feature files.

    Parameters
    ----------
    pattern
        With a placeholder where the frames are numbered, without where they are not.
    frames
        From `expand`.
    name
        What the pattern is for, in error messages: ``"output"``, ``"albedo"``.

    Raises
    ------
    InputError
        A placeholder is missing or has no number to take.
    """
    if frames[0].number is None:
        if has_placeholder(pattern):
            raise InputError(
                f"{name} must name one file, as the input does, got the pattern {pattern}"
            )
        return [Path(pattern)]
    if not has_placeholder(pattern):
        raise InputError(
            f"{name} must hold a frame placeholder such as #### for a sequence, got {pattern}"
        )
    return [numbered(pattern, frame.number) for frame in frames if frame.number is not None]


def refuse_overwriting(outputs: Sequence[Path], inputs: Sequence[Path]) -> None:
    """Raise `InputError` where an output is one of the inputs, by whatever name."""
    taken = {path.resolve() for path in inputs}
    for output in outputs:
        if output.resolve() in taken:
            raise InputError(f"output must not overwrite an input, got {output}")


def _split(path: Path) -> tuple[str, int, str]:
    placeholders = list(_PLACEHOLDER.finditer(path.name))
    if len(placeholders) != 1:
        raise InputError(f"{path}: a file name must hold one frame placeholder")
    hit = placeholders[0]
    width = len(hit[0]) if hit[0].startswith("#") else int(hit[1] or 1)
    return path.name[: hit.start()], width, path.name[hit.end() :]

"""Numbered files: patterns, globs and lists of names to frames in order, and back."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from stillray.errors import InputError
from stillray.io.frame_range import format_frames

# ####, as many @ (two or more: one is part of many names), %04d, or $F4 as Houdini has it
_PLACEHOLDER = re.compile(r"#+|@@+|%(?:0?([1-9]\d*))?d|\$F([1-9])?(?![A-Za-z0-9])")
_OTHER_PLACEHOLDER = re.compile(r"<\w+>|\[#+\]|\$?\{\w+(?::\w+)?\}|\[\d+-\d+\]")
_LAST_NUMBER = re.compile(r"(.*?)(\d+)(\D*)")  # digits right before the suffixes, if any


class NumberedFile(NamedTuple):
    """One frame of a sequence; ``number`` is None for a file named without a placeholder."""

    number: int | None
    path: Path


def has_placeholder(pattern: str | os.PathLike[str]) -> bool:
    """Whether the file name holds ``####``, ``@@@@``, ``%04d`` or ``$F4``.

    Not where it is simply a file's own name.
    """
    path = Path(pattern)
    return _PLACEHOLDER.search(path.name) is not None and not path.is_file()


def is_glob(pattern: str | os.PathLike[str]) -> bool:
    """Whether the name holds ``*``, ``?`` or ``[...]`` and is not simply a file's own name."""
    return glob.has_magic(str(pattern)) and not Path(pattern).is_file()


def expand(pattern: str | os.PathLike[str]) -> list[NumberedFile]:
    """The files that a pattern names, by frame number; gaps are left out.

    Parameters
    ----------
    pattern
        A file name; one with ``####`` (a number of at least so many digits, filled with zeros),
        ``@@@@``, ``%04d`` or ``$F4`` in its last component; or a glob, as `number_files` numbers
        its files.

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
        if is_glob(path):
            return _expand_glob(path)
        if path.is_dir():
            raise InputError(
                f"{path}: is a folder; name a file, or a sequence as {path / 'shot.####.exr'}"
            )
        if not path.is_file():
            raise InputError(f"{path}: no such file{_hint(path)}")
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
        raise InputError(f"{path}: no file matches this pattern{_hint(path)}")
    return sorted(found)


def number_files(paths: Sequence[Path]) -> list[NumberedFile]:
    """Files of one sequence by the last number in their names.

    Raises
    ------
    InputError
        A name has no number, differs in more than that, or has the number of another.
    """
    found: dict[int, Path] = {}
    first: tuple[Path, str, str] | None = None
    for path in paths:
        hit = _LAST_NUMBER.fullmatch(path.name)
        if hit is None:
            raise InputError(f"{path}: a file of a sequence must hold its number in its name")
        around = path.parent, hit[1], hit[3]
        first = first or around
        if around != first:
            raise InputError(
                f"{path}: the files of a sequence must differ by their number only, "
                f"as {first[0] / f'{first[1]}{hit[2]}{first[2]}'} would"
            )
        number = int(hit[2])
        if number in found:
            raise InputError(f"{path}: has the same number as {found[number]}")
        found[number] = path
    return [NumberedFile(number, found[number]) for number in sorted(found)]


def select(
    files: Sequence[NumberedFile], wanted: Sequence[int] | None, *, on_missing: str = "error"
) -> list[NumberedFile]:
    """The frames that are wanted.

    Parameters
    ----------
    files
        From `expand`: what there is.
    wanted
        Frame numbers in order; None for all from the first that there is to the last.
    on_missing
        ``"error"``, or ``"skip"`` to leave out the numbers that have no file.

    Raises
    ------
    InputError
        A frame is missing, or all are; or one plain file cannot be chosen from by number.
    """
    if files[0].number is None:
        if wanted is not None:
            raise InputError(f"frames must be chosen from a sequence, got one file {files[0].path}")
        return list(files)
    there = {file.number: file for file in files}
    numbers = sorted(number for number in there if number is not None)
    wanted = range(numbers[0], numbers[-1] + 1) if wanted is None else wanted
    missing = [number for number in wanted if number not in there]
    if len(missing) == len(wanted):
        raise InputError(
            f"frames must be among {format_frames(numbers)} of {files[0].path.parent}, "
            f"got {format_frames(wanted)}"
        )
    if missing and on_missing == "error":
        raise InputError(
            f"no file for frame {format_frames(missing)} beside {files[0].path}: "
            f"--on-missing skip goes on without"
        )
    return [there[number] for number in wanted if number in there]


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
        With a placeholder where the frames are numbered, without where they are not; a folder, or
        a name that ends with a slash, for files of the frames' own names in it; or a glob of files
        that have the frames' numbers.
    frames
        From `expand`.
    name
        What the pattern is for, in error messages: ``"output"``, ``"albedo"``.

    Raises
    ------
    InputError
        A placeholder is missing or has no number to take, or a glob lacks a frame.
    """
    if is_glob(pattern) and not Path(pattern).is_dir():
        there = {file.number: file.path for file in expand(pattern)}
        if missing := [frame for frame in frames if frame.number not in there]:
            raise InputError(f"{name} must have a file for every frame, none for {missing[0].path}")
        return [there[frame.number] for frame in frames]
    return _named_after(pattern, frames, name)


def map_outputs(pattern: str | os.PathLike[str], frames: Sequence[NumberedFile]) -> list[Path]:
    """The file to write for every frame; brackets are part of a name, as nothing is looked up.

    Parameters
    ----------
    pattern
        As for `map_companions`, but no glob.
    frames
        From `expand`.

    Raises
    ------
    InputError
        The pattern has ``*`` or ``?``, or lacks a placeholder, or has no number to take.
    """
    if set("*?") & set(os.fspath(pattern)):
        raise InputError(
            f"output must name what is to be written, with #### for a frame's number, or a folder, "
            f"got {pattern}"
        )
    return _named_after(pattern, frames, "output")


def _named_after(
    pattern: str | os.PathLike[str], frames: Sequence[NumberedFile], name: str
) -> list[Path]:
    """In a folder by the frames' own names, or by a pattern that takes their numbers."""
    if Path(pattern).is_dir() or names_folder(pattern):
        return [Path(pattern) / frame.path.name for frame in frames]
    if frames[0].number is None:
        if has_placeholder(pattern):
            raise InputError(
                f"{name} must name one file, as the input {frames[0].path} does, got the pattern "
                f"{pattern}; a pattern as the input too takes all files of the sequence"
            )
        return [Path(pattern)]
    if not has_placeholder(pattern):
        raise InputError(
            f"{name} must hold a frame placeholder such as #### for a sequence, "
            f"or be a folder, got {pattern}{_hint(Path(pattern)) or _as_folder(pattern)}"
        )
    return [numbered(pattern, frame.number) for frame in frames if frame.number is not None]


def names_folder(pattern: str | os.PathLike[str]) -> bool:
    """Whether a name ends as only a folder's does, which need not be there yet."""
    return str(pattern).endswith(tuple(filter(None, (os.sep, os.altsep))))


def refuse_overwriting(outputs: Sequence[Path], inputs: Sequence[Path]) -> None:
    """Raise `InputError` where an output is one of the inputs, by whatever name."""
    taken = {path.resolve() for path in inputs}
    for output in outputs:
        if output.resolve() in taken:
            raise InputError(f"output must not overwrite an input, got {output}")


def _hint(path: Path) -> str:
    """What to write instead of a placeholder of another program; may be empty."""
    if re.search("%v", path.name, re.IGNORECASE):
        return "; %V is not known here: denoise the files of each view by themselves"
    hit = _OTHER_PLACEHOLDER.search(path.name)
    if hit is None:
        return ""
    return f"; a frame's number is written as ####, %04d or $F4, not {hit[0]}"


def _as_folder(pattern: str | os.PathLike[str]) -> str:
    """What makes a folder of a name that is none yet; empty where it ends as a file's does."""
    return "" if Path(pattern).suffix else f"; a folder {pattern}{os.sep} is made"


def _expand_glob(path: Path) -> list[NumberedFile]:
    paths = [Path(name) for name in sorted(glob.glob(str(path))) if Path(name).is_file()]
    if not paths:
        raise InputError(f"{path}: no file matches this pattern{_hint(path)}")
    if len(paths) == 1 and not _LAST_NUMBER.fullmatch(paths[0].name):
        return [NumberedFile(None, paths[0])]
    return number_files(paths)


def _split(path: Path) -> tuple[str, int, str]:
    placeholders = list(_PLACEHOLDER.finditer(path.name))
    if len(placeholders) != 1:
        raise InputError(f"{path}: a file name must hold one frame placeholder")
    hit = placeholders[0]
    width = len(hit[0]) if hit[0][0] in "#@" else int(hit[1] or hit[2] or 1)
    return path.name[: hit.start()], width, path.name[hit.end() :]

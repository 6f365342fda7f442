"""What a shot asks for: which frames are run, which are written, where history begins anew."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from stillray.errors import InputError
from stillray.io.file_sequence import (
    NumberedFile,
    expand,
    map_companions,
    map_outputs,
    names_folder,
    number_files,
    refuse_overwriting,
    select,
)
from stillray.io.frame_range import parse_frames


@dataclass(frozen=True, kw_only=True)
class ShotFrame:
    """One frame of a shot.

    Attributes
    ----------
    number
        None for a file that is not of a sequence.
    source
        The file with its color.
    companions
        Feature files by role.
    output
        Where the clean frame goes; None for a frame that is only there for the history of others.
    """

    number: int | None
    source: Path
    companions: Mapping[str, Path]
    output: Path | None

    @property
    def inputs(self) -> dict[str, Path]:
        """All files that are read, by role."""
        return {"color": self.source, **self.companions}


@dataclass(frozen=True, kw_only=True)
class RunStep:
    """One run of the denoiser.

    Attributes
    ----------
    job
        The frame.
    writes
        Whether the result is kept; a warm-up only builds history.
    starts_anew
        Whether the frame before it in time was not run, so that history must be dropped:
        its motion points into that frame.
    """

    job: ShotFrame
    writes: bool
    starts_anew: bool


@dataclass(frozen=True, kw_only=True)
class Selection:
    """Which frames of a sequence a shot is.

    Attributes
    ----------
    frames
        Those that are written, see `stillray.io.frame_range.parse_frames`; None for all.
    on_missing
        What to do about frames that have no file: ``"error"``, or ``"skip"``, which begins a new
        history after them.
    warm_up
        Up to so many frames before those are run too, where there are files.

    Raises
    ------
    InputError
        One has none of these values.
    """

    frames: str | None = None
    on_missing: str = "error"
    warm_up: int = 0

    def __post_init__(self) -> None:
        if self.on_missing not in ("error", "skip"):
            raise InputError(f"on-missing must be error or skip, got {self.on_missing}")
        if self.warm_up < 0:
            raise InputError(f"warm-up must be 0 frames or more, got {self.warm_up}")


def plan_shot(
    sources: Sequence[str],
    output: str,
    companions: Mapping[str, str] | None = None,
    *,
    selection: Selection = Selection(),
    layers: Mapping[str, str] | None = None,
) -> list[ShotFrame]:
    """The frames of a shot in order; everything but the pixels is checked.

    Parameters
    ----------
    sources
        One file, pattern or glob, see `stillray.io.file_sequence.expand`; or the files of one
        sequence.
    output
        A file, a pattern, or a folder, which then holds files of the sources' names; a folder that
        is named with a slash at its end need not exist, see `make_folders`.
    companions
        Feature files or patterns by role.
    selection
        Which frames.
    layers
        Role to the layer to take for it, see `stillray.io.channels.roles.parse_overrides`.

    Raises
    ------
    InputError
        An input is missing or lacks its channels, or the output cannot be written.
    """
    from stillray.io.frame_file import check_buffer
    from stillray.io.image_file import SUFFIXES

    there = expand(sources[0]) if len(sources) == 1 else _listed(sources)
    numbers = None if selection.frames is None else parse_frames(selection.frames)
    wanted = select(there, numbers, on_missing=selection.on_missing)
    outputs = dict(zip(wanted, map_outputs(output, wanted), strict=True))
    files = _with_lead_in(wanted, there, selection.warm_up)
    features = {
        role: map_companions(pattern, files, name=role)
        for role, pattern in (companions or {}).items()
    }
    for file, path in zip(files, features.get("color_b", ()), strict=False):
        if file.path.samefile(path):
            raise InputError(
                f"color-b must be the frame rendered with another seed, got itself: {path}"
            )
    for path in outputs.values():
        if path.suffix.lower() not in SUFFIXES:
            raise InputError(f"output must be a {', '.join(SUFFIXES)} file, got {path}")
    jobs = [
        ShotFrame(
            number=file.number,
            source=file.path,
            companions={role: paths[i] for role, paths in features.items()},
            output=outputs.get(file),
        )
        for i, file in enumerate(files)
    ]
    refuse_overwriting(
        list(outputs.values()), [path for job in jobs for path in job.inputs.values()]
    )
    _require_writable(next(iter(outputs.values())), may_make_folder=names_folder(output))
    for job in jobs:
        for role, path in job.inputs.items():
            check_buffer(path, role, layers)
    return jobs


def make_folders(jobs: Sequence[ShotFrame]) -> None:
    """Make the folders of the outputs that are not there yet.

    Raises
    ------
    InputError
        One cannot be made.
    """
    for folder in {job.output.parent for job in jobs if job.output is not None}:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{folder}: cannot be made: {error.strerror}") from None


def steps_to_run(jobs: Sequence[ShotFrame], done: Sequence[bool], *, memory: int) -> list[RunStep]:
    """The frames that are not done, each with the frames before it that its history needs.

    Parameters
    ----------
    jobs
        From `plan_shot`.
    done
        Which of them need not be written again; of no account where there is no output.
    memory
        Frames that a history goes back.
    """
    needed: set[int] = set()
    for index, job in enumerate(jobs):
        if job.output is not None and not done[index]:
            needed.update(window(jobs, index, memory))
    return [
        RunStep(
            job=jobs[i],
            writes=jobs[i].output is not None and not done[i],
            starts_anew=i - 1 not in needed or not follows(jobs, i),
        )
        for i in sorted(needed)
    ]


def first_run(jobs: Sequence[ShotFrame]) -> list[Path]:
    """Files of the first frames that follow each other; of the first frame if none do."""
    last = next((i for i in range(1, len(jobs)) if follows(jobs, i)), 1)
    start = last - 1
    while last < len(jobs) and follows(jobs, last):
        last += 1
    return [job.source for job in jobs[start:last]]


def window(jobs: Sequence[ShotFrame], index: int, memory: int) -> range:
    """The frames that make a frame: itself, and up to ``memory`` before it without a gap."""
    first = index
    while index - first < memory and follows(jobs, first):
        first -= 1
    return range(first, index + 1)


def follows(jobs: Sequence[ShotFrame], index: int) -> bool:
    """Whether a job's frame is the next in time after the one before it in the list."""
    if index == 0:
        return False
    number, before = jobs[index].number, jobs[index - 1].number
    return number is not None and before is not None and number == before + 1


def _listed(sources: Sequence[str]) -> list[NumberedFile]:
    paths = [Path(source) for source in sources]
    for path in paths:
        if not path.is_file():
            raise InputError(
                f"{path}: no such file; several inputs must be the files of a sequence"
            )
    return number_files(paths)


def _with_lead_in(
    wanted: Sequence[NumberedFile], there: Sequence[NumberedFile], warm_up: int
) -> list[NumberedFile]:
    """The wanted frames and up to ``warm_up`` before each, as far as there is no gap."""
    if warm_up == 0 or wanted[0].number is None:
        return list(wanted)
    by_number = {file.number: file for file in there}
    numbers: set[int] = set()
    for file in wanted:
        assert file.number is not None
        numbers.add(file.number)
        for number in range(file.number - 1, file.number - 1 - warm_up, -1):
            if number not in by_number:
                break
            numbers.add(number)
    return [by_number[number] for number in sorted(numbers)]


def _require_writable(output: Path, *, may_make_folder: bool) -> None:
    if output.is_dir():
        raise InputError(f"output must be a file, got the folder {output}")
    folder = output.parent
    while may_make_folder and not folder.exists() and folder != folder.parent:
        folder = folder.parent  # the one in which others will be made
    try:
        # really tried: permission bits say little on network drives, and nothing to root
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(
            f"{output}: the folder must exist and be writable: {error.strerror}; a name that ends "
            f"with a slash, as new{os.sep}, is made"
        ) from None

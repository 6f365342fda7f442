"""What ``stillray denoise`` has to do: checked before the first frame, and resumed in order."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from stillray.errors import InputError

#: Frames that are run again before the first missing one, so that it has a history.
WARM_UP_FRAMES = 32


@dataclass(frozen=True, kw_only=True)
class Job:
    """One frame: where it comes from and goes to; ``companions`` are feature files by role."""

    number: int | None
    source: Path
    companions: Mapping[str, Path]
    output: Path


@dataclass(frozen=True, kw_only=True)
class Step:
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

    job: Job
    writes: bool
    starts_anew: bool


def plan_jobs(
    source: str,
    output: str,
    companions: Mapping[str, str],
    chosen: Mapping[str, str] | None = None,
) -> list[Job]:
    """The frames to denoise, in order; everything but the pixels is checked.

    Raises
    ------
    InputError
        An input is missing or lacks its channels, or the output cannot be written.
    """
    from stillray.exr import check_layer
    from stillray.sequence import expand, map_companions, refuse_overwriting

    frames = expand(source)
    outputs = map_companions(output, frames, name="output")
    features = {
        role: map_companions(pattern, frames, name=role) for role, pattern in companions.items()
    }
    if Path(output).suffix.lower() != ".exr":
        raise InputError(f"output must be an .exr file, got {output}")
    refuse_overwriting(
        outputs,
        [frame.path for frame in frames] + [p for paths in features.values() for p in paths],
    )
    _require_writable(outputs[0])
    for frame in frames:
        check_layer(frame.path, "color", chosen)
    for role, paths in features.items():
        for path in paths:
            check_layer(path, role, chosen)
    return [
        Job(
            number=frame.number,
            source=frame.path,
            companions={role: paths[i] for role, paths in features.items()},
            output=outputs[i],
        )
        for i, frame in enumerate(frames)
    ]


def finished(job: Job) -> bool:
    """Whether the output is newer than all inputs and reads back completely."""
    from stillray.exr import read_picture

    try:
        written = job.output.stat().st_mtime_ns
        if any(p.stat().st_mtime_ns >= written for p in (job.source, *job.companions.values())):
            return False
        return read_picture(job.output).size > 0
    except (OSError, InputError):
        return False


def steps_to_run(jobs: Sequence[Job], done: Sequence[bool], *, temporal: bool) -> list[Step]:
    """The frames that are not done, each with warm-up frames before it where history matters."""
    warm_up = WARM_UP_FRAMES if temporal else 0
    needed: set[int] = set()
    for index, is_done in enumerate(done):
        if not is_done:
            needed.update(range(max(index - warm_up, 0), index + 1))
    return [
        Step(job=jobs[i], writes=not done[i], starts_anew=not _follows(jobs, i, needed))
        for i in sorted(needed)
    ]


def _follows(jobs: Sequence[Job], index: int, needed: set[int]) -> bool:
    if index == 0 or index - 1 not in needed:
        return False
    number, before = jobs[index].number, jobs[index - 1].number
    return number is not None and before is not None and number == before + 1


def _require_writable(output: Path) -> None:
    if output.is_dir():
        raise InputError(f"output must be a file, got the folder {output}")
    try:
        # really tried: permission bits say little on network drives, and nothing to root
        with tempfile.TemporaryFile(dir=output.parent):
            pass
    except OSError as error:
        raise InputError(
            f"{output}: the folder must exist and be writable: {error.strerror}"
        ) from None

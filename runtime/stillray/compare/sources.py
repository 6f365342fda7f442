"""What is compared with what: files and sequences, paired by frame number, with their labels."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from stillray.errors import InputError
from stillray.io.file_sequence import expand
from stillray.io.frame_range import parse_frames

_PLACEHOLDER = re.compile(r"[._-]*(?:#+|@@+|%\d*d|\$F\d?)[._-]*")
_REFERENCE_LABEL = "reference"


@dataclass(frozen=True, kw_only=True)
class FrameFiles:
    """The files of one frame: one an image, and the reference's where there is one."""

    number: int | None
    images: tuple[Path, ...]
    reference: Path | None


@dataclass(frozen=True, kw_only=True)
class Sources:
    """Images by label, frame by frame; ``left_out`` are wanted frames that not all images have."""

    labels: tuple[str, ...]
    reference_label: str | None
    frames: tuple[FrameFiles, ...]
    left_out: tuple[int, ...]


def pair(
    images: Sequence[str],
    reference: str | None = None,
    *,
    labels: Sequence[str] = (),
    frames: str | None = None,
) -> Sources:
    """The files to compare, paired by frame number.

    Parameters
    ----------
    images
        Files, or patterns as `stillray.io.file_sequence.expand` takes them.
    reference
        One more; it may lack frames, as references are dear.
    labels
        Names of the images in their order; found in their paths where there are none.
    frames
        Only these, see `stillray.io.frame_range.parse_frames`.

    Raises
    ------
    InputError
        Nothing to compare, files and sequences mixed, no frame that all have, a wrong number of
        labels.
    """
    given = [*images, *([reference] if reference is not None else [])]
    if len(given) < 2:
        raise InputError(f"images must be two or more, or one and --reference, got {given[0]}")
    if labels and len(labels) != len(images):
        raise InputError(f"--label must be given once an image ({len(images)}), got {len(labels)}")
    found = [{file.number: file.path for file in expand(pattern)} for pattern in given]
    single = [None in files for files in found]
    if any(single) != all(single):
        raise InputError(
            f"images and reference must all be files or all sequences, got {' '.join(given)}"
        )
    if all(single) and frames is not None:
        raise InputError(f"--frames must choose from a sequence, got one file {given[0]}")
    numbered = found[: len(images)]
    everywhere = set.intersection(*(set(files) for files in numbered))
    anywhere = set.union(*(set(files) for files in numbered))
    wanted = None if frames is None else set(parse_frames(frames))
    chosen = sorted(n or 0 for n in everywhere if wanted is None or n in wanted)
    if not chosen:
        raise InputError(
            f"images must have a frame in common{f' in {frames}' if frames else ''}, "
            f"got none for {' '.join(images)}"
        )
    keys = [None] if all(single) else chosen
    references = found[-1] if reference is not None else {}
    if reference is not None and not any(key in references for key in keys):
        raise InputError(f"reference must have a frame that the images have, got {reference}")
    return Sources(
        labels=tuple(labels) or tuple(_labels(images)),
        reference_label=None if reference is None else _REFERENCE_LABEL,
        frames=tuple(
            FrameFiles(
                number=key,
                images=tuple(files[key] for files in numbered),
                reference=references.get(key),
            )
            for key in keys
        ),
        left_out=tuple(
            sorted(
                n
                for n in anywhere - everywhere
                if n is not None and (wanted is None or n in wanted)
            )
        ),
    )


def _labels(patterns: Sequence[str]) -> list[str]:
    """File names without number and suffix, with as many folders before as tell them apart."""
    paths = [Path(pattern).absolute() for pattern in patterns]
    names = [_PLACEHOLDER.sub(" ", path.stem).strip() or path.stem for path in paths]
    depth = 1
    labels = names
    while len(set(labels)) < len(labels) and depth < max(len(path.parts) for path in paths):
        depth += 1
        labels = [
            "/".join([*path.parts[-depth:-1], name])
            for path, name in zip(paths, names, strict=True)
        ]
    return labels

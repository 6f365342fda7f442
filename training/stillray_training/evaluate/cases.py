"""What there is to measure in a folder of frames with references.

``<scene>/frame_0000.exr, ...`` is a sequence, and ``<scene>/ref_0005.exr`` the reference of its
frame 5. ``spp/<scene>/<n>/frame_0005.exr`` is that frame with ``n`` samples a pixel. What a file
holds is what `stillray.io.exr.read.read_exr` finds in it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

import numpy as np

from stillray.errors import InputError
from stillray.frame import SURFACES, Frame
from stillray.io.exr.read import read_exr
from stillray_training.film import film_variance, frame_through_film, through_film, widened
from stillray_training.simulate.sequence import RECORD
from stillray_training.targets import read_filter, read_samples

#: The sets of a folder, as ``--only`` takes them.
KINDS = ("sequences", "frames", "stills", "fed")
#: Those of them whose frames have no past.
WITHOUT_PAST = ("stills", "fed")
#: Buffers that can be kept from what denoises.
WITHHELD = (*SURFACES, "motion")
_STILLS = "spp"


@dataclass(frozen=True, kw_only=True)
class Case:
    """Frames to denoise, and what the last of them should be.

    Attributes
    ----------
    kind
        One of `KINDS`: ``sequences`` are measured at their last frame, with a past and without;
        ``frames`` at every frame; ``stills`` have no past; ``fed`` are stills whose reference
        takes the place of the noisy picture.
    title
        Name of the set that the case belongs to.
    name
        Of the case in its set.
    frames
        Files in order, up to the last that has a reference.
    references
        Files of the references of the last frames, one each.
    filter_spread
        Standard deviation of the pixel filter of frames whose files do not say, in pixels; None
        where nobody knows.
    tells_filter
        Whether models are told of it at all.
    film
        Standard deviation of a Gaussian film that frames and references go through, in pixels: its
        samples count in all pixels that it reaches, see `stillray_training.film`; 0 for none.
    without
        Buffers out of `WITHHELD` that frames are given without.
    """

    kind: str
    title: str
    name: str
    frames: tuple[Path, ...]
    references: tuple[Path, ...]
    filter_spread: float | None = None
    tells_filter: bool = True
    film: float = 0.0
    without: tuple[str, ...] = ()

    def read(self) -> tuple[list[Frame], list[np.ndarray]]:
        """The frames, and the radiance ``(h, w, 3)`` of the references."""
        frames = [self._frame(path) for path in self.frames]
        references = [read_exr(path).color for path in self.references]
        if self.film:
            references = [through_film(reference, self.film) for reference in references]
        if self.kind == "fed":
            frames = [dataclasses.replace(frames[-1], color=references[-1])]
        return frames, references

    def _frame(self, path: Path) -> Frame:
        frame = read_exr(path)
        known, samples = frame.filter_spread, frame.samples
        if (path.parent / RECORD).is_file():
            known = read_filter(path.parent) if known is None else known
            samples = read_samples(path.parent) if samples is None else samples
        known = self.filter_spread if known is None else known
        if self.film:
            frame = frame_through_film(frame, self.film)
            known = widened(known, film_variance(self.film))
        known = known if self.tells_filter else None
        frame = dataclasses.replace(frame, filter_spread=known, samples=samples)
        return frame.without(self.without)


def find_cases(
    folder: Path,
    *,
    label: str = "",
    kinds: Collection[str] = KINDS,
    counts: Collection[int] | None = None,
) -> list[Case]:
    """The cases of a folder, set after set.

    Parameters
    ----------
    folder
        As the module says.
    label
        Stands before the titles of the sets, where there are several folders.
    kinds
        Those out of `KINDS` that are wanted.
    counts
        Samples a pixel of the stills that are wanted; None for all. Others are not fed either.

    Raises
    ------
    InputError
        There is none, or a frame lacks its reference, or a reference its frame.
    """
    prefix = f"{label}, " if label else ""
    sequences = _sequences(folder)
    found = [
        Case(
            kind="sequences", title=f"{prefix}sequences", name=path.name,
            frames=tuple(frames), references=tuple(references),
        )
        for path in sequences
        for frames, references in [referenced(path)]
        if len(references) < max(3, len(frames))
    ]  # fmt: skip
    for path in sequences:
        frames, references = referenced(path)
        if len(references) >= max(3, len(frames)):
            found.append(
                Case(
                    kind="frames", title=f"{prefix}{path.name}", name=path.name,
                    frames=tuple(frames), references=tuple(references),
                )
            )  # fmt: skip
    found += _stills(folder, prefix, counts)
    wanted = [case for case in found if case.kind in kinds]
    if not wanted:
        raise InputError(
            f"folder must hold sequences with references, or {_STILLS}/<scene>/<samples a pixel>, "
            f"got {folder}"
        )
    return wanted


def find_scenes(folder: Path) -> list[Path]:
    """Folders of sequences that have a reference for their last frame.

    Raises
    ------
    InputError
        There is none.
    """
    if not folder.is_dir():
        raise InputError(f"folder must hold sequences with references, got {folder}: no folder")
    found = _sequences(folder)
    if not found:
        raise InputError(f"folder must hold sequences with references, got {folder}")
    return found


def last_referenced(scene: Path) -> tuple[list[Path], list[np.ndarray]]:
    """Frames up to the last with a reference, and the references of the last run of frames."""
    frames, references = referenced(scene)
    return frames, [read_exr(path).color for path in references]


def referenced(scene: Path) -> tuple[list[Path], list[Path]]:
    """Files of the frames up to the last with a reference, and of the last run of references."""
    with_reference = {path.name.replace("ref", "frame"): path for path in scene.glob("ref_*.exr")}
    last = max(with_reference)
    if not (scene / last).is_file():
        raise InputError(f"{scene}: a reference must have its frame, got none for {last}")
    paths = [path for path in sorted(scene.glob("frame_*.exr")) if path.name <= last]
    run = list(takewhile(lambda path: path.name in with_reference, reversed(paths)))
    return paths, [with_reference[path.name] for path in reversed(run)]


def _sequences(folder: Path) -> list[Path]:
    return sorted(
        path
        for path in folder.iterdir()
        if path.is_dir() and list(path.glob("frame_*.exr")) and list(path.glob("ref_*.exr"))
    )


def _stills(folder: Path, prefix: str, counts: Collection[int] | None) -> list[Case]:
    """Stills of every count, fewest samples first; then the cleanest, fed their references."""
    files = sorted(
        (int(path.parent.name), path)
        for path in (folder / _STILLS).glob("*/*/frame_*.exr")
        if path.parent.name.isdecimal()
    )
    chosen = [(count, path) for count, path in files if counts is None or count in counts]
    found = [
        _still("stills", f"{prefix}stills, {count} samples a pixel", folder, path)
        for count, path in chosen
    ]
    cleanest = {path.parts[-3]: path for _, path in chosen}
    fed = [_still("fed", f"{prefix}fed the references", folder, p) for p in cleanest.values()]
    return found + fed


def _still(kind: str, title: str, folder: Path, path: Path) -> Case:
    scene = path.parts[-3]
    reference = folder / scene / path.name.replace("frame", "ref")
    if not reference.is_file():
        raise InputError(f"{path}: a still must have a reference, got none at {reference}")
    return Case(kind=kind, title=title, name=scene, frames=(path,), references=(reference,))


def titles(cases: Sequence[Case]) -> dict[str, str]:
    """Title of every set to its kind, in order."""
    return {case.title: case.kind for case in cases}

"""``stillray-gather 'noisy/s010.####.exr' 'clean/s010.####.exr' -o data/show``.

Renders of one's own as the sequences that training, export and evaluation read: every frame that
has a reference becomes the last of a sequence, with the frames before it that there are. Files are
read as `stillray denoise` reads them, whatever renderer wrote them, and written anew in one naming.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from stillray.batch.file_layout import Layout, Told
from stillray.cli import program
from stillray.errors import InputError
from stillray.frame import Frame
from stillray.io.channels.roles import parse_overrides
from stillray.io.file_sequence import NumberedFile, expand, map_companions
from stillray.io.frame_file import read_frame
from stillray.pixel_filter import parse_filter
from stillray_training.simulate.sequence import RECORD, atomic_path, write

#: Frames of a sequence, its last one included: as many as networks see accumulated in training.
FRAMES = 8
_NEEDED = ("albedo", "normal", "depth")
_NAME = re.compile(r"[A-Za-z0-9_]+(?:-[A-Za-z0-9_]+)*")
_ALIKE = 1.25  # brightness of a frame over its reference, or the reverse, that noise explains


@dataclass(frozen=True, kw_only=True)
class Source:
    """Renders of one shot.

    Attributes
    ----------
    frames
        Noisy frames: a file or pattern, as `stillray denoise` takes it.
    references
        The same frames without noise; only those that there are, by frame number.
    companions
        Files of features by role, where they stand apart.
    layers
        Role to the layer to take for it.
    told
        What is said of the noisy frames, whatever their files say.
    every
        References nearer than so many frames to the last that was taken are left out.
    """

    frames: str
    references: str
    companions: Mapping[str, str] = field(default_factory=dict)
    layers: Mapping[str, str] = field(default_factory=dict)
    told: Told = field(default_factory=Told)
    every: int = FRAMES


@dataclass(frozen=True, kw_only=True)
class Gathered:
    """A sequence that was written.

    Attributes
    ----------
    folder
        Where it is.
    frames
        How many it has.
    samples
        Samples a pixel of its frames; 1 where nobody said.
    brightness
        Mean radiance of its last frame over that of the reference.
    """

    folder: Path
    frames: int
    samples: float
    brightness: float

    @property
    def alike(self) -> bool:
        """Whether frame and reference may be of the same light, by their brightness."""
        return 1 / _ALIKE < self.brightness < _ALIKE


def gather_renders(source: Source, out: Path, name: str) -> list[Gathered]:
    """Write sequences from renders; those that are there already are written anew.

    Parameters
    ----------
    source
        The renders.
    out
        Folder for the sequences, made if missing; they are called ``NAME-own-FRAME``.
    name
        What the renders are called in a model's provenance.

    Raises
    ------
    InputError
        A file cannot be read, lacks a buffer that networks learn from, or frame and reference do
        not fit together; or the name is that of a scene of stillray's own.
    """
    _check_name(name)
    runs = _runs(source)
    paths = [file.path for file in runs[0][0]]
    layout = Layout.of(paths, layers=source.layers, told=source.told)
    gathered = []
    for run, reference in runs:
        companions = {
            role: map_companions(pattern, run, name=role)
            for role, pattern in source.companions.items()
        }
        for place, layers in enumerate(layout.of_views):
            frames = _read(layout, run, companions, place)
            target = read_frame(reference, {}, layers=layers).color
            view = f"-{layout.views[place]}" if layout.views else ""
            folder = out / f"{name}{view}-own-{run[-1].number or 0:04d}"
            gathered.append(_write(folder, name, frames, target, (run, reference)))
    return gathered


def _check_name(name: str) -> None:
    if _NAME.fullmatch(name) is None:
        raise InputError(f"name must be of letters, digits, _ and -, got {name!r}")
    credits = resources.files("stillray_training") / "credits.toml"
    if name in tomllib.loads(credits.read_text(encoding="utf-8")):
        raise InputError(f"name must not be that of a scene of stillray's own, got {name}")


def _runs(source: Source) -> list[tuple[list[NumberedFile], Path]]:
    """For each reference the frames that end at it, in order, and the reference's file."""
    if source.every < 1:
        raise InputError(f"every must be 1 frame or more, got {source.every}")
    there = {file.number: file for file in expand(source.frames)}
    references = expand(source.references)
    runs: list[tuple[list[NumberedFile], Path]] = []
    last: int | None = None
    for file in references:
        if file.number not in there:
            continue
        if file.number is None:  # one frame, one reference
            return [([there[None]], file.path)]
        if last is not None and file.number - last < source.every:
            continue
        last, first = file.number, file.number
        while first - 1 in there and file.number - first + 1 < FRAMES:
            first -= 1
        runs.append(([there[n] for n in range(first, file.number + 1)], file.path))
    if not runs:
        raise InputError(
            f"references must have the numbers of frames: none of {source.references} is among "
            f"{source.frames}"
        )
    return runs


def _read(
    layout: Layout,
    run: Sequence[NumberedFile],
    companions: Mapping[str, Sequence[Path]],
    place: int,
) -> list[Frame]:
    """The frames of one view; the last alone where motion does not tell what was before."""
    frames: list[Frame] = []
    before: Path | None = None
    for index, file in enumerate(run):
        own = {role: paths[index] for role, paths in companions.items()}
        frame = layout.read(file.path, own, before)[place].frame
        if missing := [role for role in _NEEDED if getattr(frame, role) is None]:
            raise InputError(
                f"{file.path}: training needs albedo, normal and depth beside the color, lacks "
                f"{', '.join(missing)}; --layer {missing[0]}=NAME names a layer, --{missing[0]} "
                "files"
            )
        frames.append(frame)
        before = file.path
    return frames if all(frame.motion is not None for frame in frames[1:]) else frames[-1:]


def _write(
    folder: Path,
    name: str,
    frames: Sequence[Frame],
    reference: np.ndarray,
    files: tuple[Sequence[NumberedFile], Path],
) -> Gathered:
    run, path = files
    last = frames[-1]
    if reference.shape != last.color.shape:
        raise InputError(
            f"{path}: must have the size {last.shape} of {run[-1].path}, got {reference.shape[:2]}"
        )
    if bad := int((~np.isfinite(reference)).any(axis=-1).sum()):
        raise InputError(f"{path}: a reference must be finite, {bad} pixels are not")
    samples = 1.0 if last.samples is None else float(np.nanmean(last.samples))
    folder.mkdir(parents=True, exist_ok=True)
    for old in [folder / RECORD, *folder.glob("*_*.exr")]:
        old.unlink(missing_ok=True)
    for index, frame in enumerate(frames):
        write(folder / f"frame_{index:04d}.exr", layers_of(frame))
    write(folder / f"ref_{len(frames) - 1:04d}.exr", {"color": reference})
    record = {
        "scene": name,
        "options": {
            "frames": len(frames),
            "height": last.shape[0],
            "width": last.shape[1],
            "spp": samples,
            "references": 1,
        },
        "filter_spread": last.filter_spread,
        "files": [file.path.name for file in run[-len(frames) :]],
        "reference": path.name,
    }
    with atomic_path(folder / RECORD) as temporary:
        temporary.write_text(json.dumps(record, indent=1))
    finite = np.isfinite(last.color)
    bright = float(np.mean(last.color, where=finite)) / max(float(reference.mean()), 1e-9)
    return Gathered(folder=folder, frames=len(frames), samples=samples, brightness=bright)


def layers_of(frame: Frame) -> dict[str, np.ndarray]:
    """What is written of a frame for training; what is not finite as NaN, to be repaired as such.

    Parameters
    ----------
    frame
        With albedo, normal and depth.
    """
    color = np.where(np.isfinite(frame.color), frame.color, np.float32(np.nan))
    layers = {"color": color}
    for role in (*_NEEDED, "motion"):
        value = getattr(frame, role)
        layers[role] = np.zeros((*frame.shape, 2), np.float32) if value is None else value
    return layers


def main(
    frames: Annotated[str, typer.Argument(help="Noisy frames, as 'noisy/shot.####.exr'.")],
    references: Annotated[
        str, typer.Argument(help="The same frames without noise: all, or only some of them.")
    ],
    out: Annotated[Path, typer.Option("--output", "-o", help="Folder for the sequences.")],
    name: Annotated[
        str, typer.Option(help="What the renders are called in the model's provenance.")
    ] = "own",
    pixel_filter: Annotated[
        str | None, typer.Option(help="Of the noisy frames, as stillray denoise takes it.")
    ] = None,
    samples: Annotated[
        float | None, typer.Option(help="Samples a pixel of the frames, if the files do not say.")
    ] = None,
    every: Annotated[
        int, typer.Option(help="Leave references out that are nearer than so many frames.")
    ] = FRAMES,
    layer: Annotated[
        list[str] | None, typer.Option("--layer", help="ROLE=NAME: take this layer for a role.")
    ] = None,
    albedo: Annotated[str | None, typer.Option(help="Files that hold the albedo.")] = None,
    normal: Annotated[str | None, typer.Option(help="Files that hold the normals.")] = None,
    depth: Annotated[str | None, typer.Option(help="Files that hold the depth.")] = None,
    motion: Annotated[str | None, typer.Option(help="Files that hold the motion.")] = None,
) -> None:
    """Make sequences to train on from renders of your own."""
    companions = {"albedo": albedo, "normal": normal, "depth": depth, "motion": motion}
    source = Source(
        frames=frames,
        references=references,
        companions={role: files for role, files in companions.items() if files is not None},
        layers=parse_overrides(layer or []),
        told=Told(
            samples=samples,
            filter_spread=None if pixel_filter is None else parse_filter(pixel_filter),
        ),
        every=every,
    )
    for one in gather_renders(source, out, name):
        note = "" if one.alike else "; is it the same light and exposure?"
        print(
            f"{one.folder}: {one.frames} frames of {one.samples:g} samples a pixel, "
            f"{one.brightness:.2f} times as bright as the reference{note}"
        )


if __name__ == "__main__":
    program.run(main)

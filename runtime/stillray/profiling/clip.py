"""The frames to measure on: a user's own, or made up; at their own size or tiled to another."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from stillray.frame import Frame
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.read import read_exr
from stillray.io.file_sequence import expand
from stillray.model_spec import ModelSpec
from stillray.profiling.synthetic import swing, tiled

MADE_UP = "synthetic"
DEFAULT_SIZE = 720, 1280  # pixels, of made-up frames
_MOST_FRAMES = 4  # of a user's sequence: they are kept in memory
_SUFFIXES = {
    "color": ("R", "G", "B"),
    "albedo": ("albedo.R", "albedo.G", "albedo.B"),
    "normal": ("normal.X", "normal.Y", "normal.Z"),
    "depth": ("depth.Z",),
    "motion": ("motion.X", "motion.Y"),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Clip:
    """Frames that are denoised over and over.

    Attributes
    ----------
    frames
        In order, of one size.
    endless
        Whether the last leads to the first as each leads to the next; otherwise a round of the
        frames ends with a cut.
    path
        A file that holds the first frame as it is; None where there is none.
    """

    frames: tuple[Frame, ...]
    endless: bool
    path: Path | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.frames[0].shape

    def for_model(self, spec: ModelSpec) -> Clip:
        """The same with a second half of each frame's samples only if a model learns from both."""
        if "color_b" in spec.inputs.required or "color_b" not in self.frames[0].given:
            return self
        return replace(self, frames=tuple(replace(frame, color_b=None) for frame in self.frames))

    def frame(self, turn: int) -> tuple[Frame, bool]:
        """The frame of a turn, and whether it has no past: turn 0, and every later cut."""
        index = turn % len(self.frames)
        return self.frames[index], turn == 0 or (index == 0 and not self.endless)


def open_clip(source: str | None = None, size: tuple[int, int] | None = None) -> Clip:
    """The frames to measure on.

    Parameters
    ----------
    source
        An EXR file, or a pattern of numbered ones, of which the first few are taken; None for
        frames that are made up.
    size
        Height and width in pixels that frames are tiled or cut to; None for the files' own, or
        `DEFAULT_SIZE`.

    Raises
    ------
    InputError
        A file is missing or cannot be used.
    """
    if source is None:
        shape = size or DEFAULT_SIZE
        halves = zip(swing(*shape), swing(*shape, seed=1), strict=True)
        frames = tuple(replace(first, color_b=second.color) for first, second in halves)
        return Clip(frames=frames, endless=True)
    paths = [file.path for file in expand(source)[:_MOST_FRAMES]]
    read = [read_exr(path) for path in paths]
    shape = size or read[0].shape
    whole = all(frame.shape == shape for frame in read)
    return Clip(
        frames=tuple(tiled(frame, *shape) for frame in read),
        endless=len(read) == 1,  # one frame over and over is a still
        path=paths[0] if whole else None,
    )


def write_frame(path: Path, frame: Frame) -> None:
    """Write a frame's buffers as one half-precision EXR file, as renderers do."""
    channels: dict[str, np.ndarray] = {}
    for field in fields(frame):
        array = getattr(frame, field.name)
        if array is not None and field.name in _SUFFIXES:
            planes = array.reshape(*frame.shape, -1).transpose(2, 0, 1)
            channels.update(zip(_SUFFIXES[field.name], planes, strict=True))
    write_channels(path, channels)

"""A rendered sequence as it is learned from: some have lamps painted in."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillray.errors import InputError
from stillray.frame import Frame
from stillray.model_spec.training import Training
from stillray_training.blocks import frames_of, read_blocks
from stillray_training.small_lamps import draw_lamps, lit_frame, lit_reference
from stillray_training.targets import read_filter, read_target


@dataclass(frozen=True, kw_only=True, eq=False)
class Rendered:
    """What was rendered of a sequence.

    Attributes
    ----------
    frames
        All, in order.
    blocks
        The last and, where they were asked for, its further blocks, each with its samples a pixel.
    reference : (h, w, 3) float32
        What the last is to become.
    spp
        Samples a pixel of a frame.
    spread
        Standard deviation of the pixel filter, in pixels; None where it is not known.
    """

    frames: list[Frame]
    blocks: list[tuple[Frame, float]]
    reference: np.ndarray
    spp: float
    spread: float | None


def read_rendered(sequence: Path, recipe: Training, *, with_blocks: bool = True) -> Rendered:
    """Read a sequence, and paint lamps into as large a share of sequences as a recipe says.

    The same sequence and seed give the same lamps every time, with further blocks and without.

    Raises
    ------
    InputError
        It lacks its frames or its reference.
    """
    frames = frames_of(sequence)
    if not frames:
        raise InputError(f"{sequence}: must hold frames, frame_0000.exr and on")
    reference, spp = read_target(sequence)
    blocks = read_blocks(sequence, frames[-1], spp) if with_blocks else [(frames[-1], spp)]
    spread = read_filter(sequence)
    rng = np.random.default_rng([recipe.seed, zlib.crc32(sequence.name.encode()), 1])
    if rng.random() < recipe.lamp_share:
        depth = frames[-1].depth
        assert depth is not None
        lamps = draw_lamps(reference, depth, spread, rng)
        reference = lit_reference(reference, lamps)
        frames = [lit_frame(frame, lamps, spp, rng) for frame in frames]
        more = [(lit_frame(frame, lamps, count, rng), count) for frame, count in blocks[1:]]
        blocks = [(frames[-1], spp), *more]
    return Rendered(frames=frames, blocks=blocks, reference=reference, spp=spp, spread=spread)

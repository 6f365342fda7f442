"""A sequence's frames; its last in blocks of samples, of which frames of other counts are made."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from stillray.frame import Frame
from stillray.io.exr.read import read_exr
from stillray_training.simulate.sequence import RECORD

_FEW = 8.0  # samples below which a frame's guides are those of one block, as noisy as its light


def frame_paths(sequence: Path) -> list[Path]:
    """The files of a folder's frames, in order."""
    return sorted(sequence.glob("frame_*.exr"))


def frames_of(sequence: Path) -> list[Frame]:
    """The frames of a folder, in order, all at once."""
    return [read_exr(path) for path in frame_paths(sequence)]


def read_blocks(sequence: Path, last: Frame, spp: float) -> list[tuple[Frame, float]]:
    """The last frame of a sequence and its further blocks, each with its samples a pixel.

    Parameters
    ----------
    sequence
        A rendered sequence, with ``blocks`` among its options or without.
    last
        Its last frame.
    spp
        Samples a pixel of that.
    """
    counts = json.loads((sequence / RECORD).read_text())["options"].get("blocks", [])
    paths = sorted(sequence.glob("block_*.exr"))
    more = [(read_exr(path), float(n)) for path, n in zip(paths, counts, strict=True)]
    return [(last, spp), *more]


def alike_frames(
    blocks: Sequence[tuple[Frame, float]],
    reference: np.ndarray,
    samples: float,
    number: int,
    rng: np.random.Generator,
) -> list[Frame]:
    """Frames of a still camera, of as many samples a pixel each, with noise of their own.

    Each has the noise of a block of as many samples or fewer, made smaller; made larger it would
    fall below 0.

    Parameters
    ----------
    blocks
        See `read_blocks`; two or more.
    reference : (h, w, 3) float32
        Light without noise.
    samples
        A pixel, of each frame; at least as many as the second smallest block has.
    number
        Of frames at most: there are no more than blocks that fit.
    rng
        Draws their order.
    """
    counts = np.array([count for _, count in blocks])
    fitting = np.flatnonzero(counts <= samples)
    largest = fitting[np.argsort(-counts[fitting], kind="stable")][:number]
    still = np.zeros((*reference.shape[:2], 2), np.float32)
    whole = mean_frame(blocks)
    frames = []
    for frame, count in (blocks[index] for index in rng.permutation(largest)):
        noise = np.nan_to_num(frame.color) - reference
        color = reference + np.float32(np.sqrt(count / samples)) * noise
        guides = frame if samples < _FEW else whole
        frames.append(replace(guides, color=color, motion=still, samples=samples))
    return frames


def mean_frame(blocks: Sequence[tuple[Frame, float]]) -> Frame:
    """The frame that all samples of some blocks make, features included.

    Normals are means, shorter than 1 where surfaces meet, as renderers write them; depth is a mean
    over the blocks that hit something there; motion is the first block's.
    """
    total = sum(count for _, count in blocks)

    def mean(name: str) -> np.ndarray:
        parts = [getattr(frame, name) * np.float32(count / total) for frame, count in blocks]
        return np.asarray(np.sum(parts, axis=0, dtype=np.float32))

    first = blocks[0][0]
    hits = np.zeros(first.shape, np.float32)
    for frame, count in blocks:
        assert frame.depth is not None
        hits += (frame.depth > 0) * np.float32(count / total)
    depth = mean("depth") / np.maximum(hits, np.float32(1e-6))
    return replace(
        first,
        color=mean("color"),
        albedo=None if first.albedo is None else mean("albedo"),
        normal=mean("normal"),
        depth=depth,
        samples=total,
    )

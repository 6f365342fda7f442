"""Blockwise multi-order feature regression (Koskela et al. 2019), on the CPU, for comparison.

Irradiance is accumulated over time, then fitted, block by block, as a linear combination of
normals, positions and squared positions; the fits are accumulated again and antialiased.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.stats import qmc

from stillray.frame import Frame
from stillray_training.peers.sequence import (
    Buffers,
    SequenceOptions,
    blend,
    bring,
    prepare,
    with_frames,
)
from stillray_training.peers.taa import antialias, to_picture, to_radiance

_UNSCALED = 4  # features that keep their values: 1 and the normal
_LEAST_RANGE = 1e-12  # share of a feature's size: a block where it varies less is flat


@dataclass(frozen=True, kw_only=True)
class BmfrOptions:
    """Parameters of the published program."""

    block: int = 32  # pixels, 4 or more: more pixels than features
    offsets: int = 16  # frames after which the displacements of the blocks repeat, 1 or more
    noise: float = 0.01  # features are shaken by up to this before the fit, > 0
    color_share: float = 0.2  # of the current frame in accumulated irradiance at least, (0, 1]
    filtered_share: float = 0.1  # of the current fit in accumulated fits at least, (0, 1]
    antialias_share: float = 0.2  # of the new picture, (0, 1]
    sequence: SequenceOptions = field(default_factory=SequenceOptions)


@dataclass(frozen=True, kw_only=True, eq=False)
class BmfrHistory:
    """What is remembered of the past."""

    buffers: Buffers
    color: np.ndarray  # (h, w, 4): accumulated irradiance and frames
    filtered: np.ndarray  # (h, w, 4): accumulated fits and frames
    picture: np.ndarray  # (h, w, 3): the last result, tone-mapped
    index: int  # frames since the start


class Bmfr:
    """A stream of frames through BMFR; holds the history between them.

    Parameters
    ----------
    options
        Defaults are the published ones.
    """

    def __init__(self, options: BmfrOptions | None = None) -> None:
        self.options = options or BmfrOptions()
        self.history: BmfrHistory | None = None

    def denoise(self, frame: Frame) -> np.ndarray:
        """Denoise the next frame; one of another size than the last starts anew.

        Returns
        -------
        (h, w, 3) float32
            Radiance, finite and >= 0.
        """
        options, history = self.options, self.history
        if history is not None and history.buffers.shape != frame.shape:
            history = None
        index = 0 if history is None else history.index + 1
        now = prepare(frame, history.buffers if history else None, options.sequence)
        if history is None:
            past_color = past_filtered = np.zeros((*now.shape, 4), np.float32)
        else:
            past_color, past_filtered = (
                bring(part, history.buffers, now, options.sequence)
                for part in (history.color, history.filtered)
            )
        mean, frames = blend(now.irradiance, past_color, options.color_share)
        fitted = fit(mean, features(now), index, options)
        filtered, _ = blend(fitted, past_filtered, options.filtered_share)
        new_picture = to_picture(filtered * now.demodulation_albedo, now.exposure)
        picture = antialias(
            new_picture, history.picture if history else None, now.motion, options.antialias_share
        )
        self.history = BmfrHistory(
            buffers=now,
            color=with_frames(mean, frames),
            filtered=with_frames(filtered, frames),
            picture=picture,
            index=index,
        )
        return to_radiance(picture, now.exposure)


def features(buffers: Buffers) -> np.ndarray:
    """What irradiance is fitted with: 1, normal, position and the squares of the position.

    differs: positions are world-space in the paper. Our buffers have none: x and y are pixels from
    the image's centre times depth, which is camera space for any field of view, up to factors
    that `fit` takes out when it scales the features of a block.

    Returns
    -------
    (h, w, 10) float64
    """
    height, width = buffers.shape
    result = np.ones((height, width, _UNSCALED + 6))
    result[..., 1:4] = 0 if buffers.normal is None else buffers.normal
    depth = 1.0 if buffers.depth is None else buffers.depth.astype(np.float64)
    result[..., 4] = (np.arange(width) - (width - 1) / 2) * depth
    result[..., 5] = (np.arange(height) - (height - 1) / 2)[:, None] * depth
    result[..., 6] = depth
    result[..., 7:] = result[..., 4:7] ** 2
    return result


def fit(
    irradiance: np.ndarray, features: np.ndarray, index: int, options: BmfrOptions
) -> np.ndarray:
    """Least squares fit of irradiance by features in every block.

    Blocks are displaced from frame to frame, and the image is mirrored at its edges to fill them.
    Uniform noise on the features keeps the fit regular where they depend on each other
    (stochastic regularisation); the fit is evaluated on the features without it.

    differs: the displacements are a Halton sequence, the noise comes from NumPy's generator seeded
    by the frame's number, and positions are scaled to [0, 1] in every block, not only where they
    span more than 1, since our depth comes in any unit.

    Parameters
    ----------
    irradiance : (h, w, 3) float32
    features : (h, w, n) float64
        The first is 1; the first `_UNSCALED` are in [-1, 1].
    index
        Number of the frame: which displacement and which noise.

    Returns
    -------
    (h, w, 3) float32
        >= 0.
    """
    height, width = irradiance.shape[:2]
    top, left = block_offset(index, options)
    size = options.block
    margins = ((top, -(top + height) % size), (left, -(left + width) % size), (0, 0))
    blocks = _scaled(_to_blocks(np.pad(features, margins, mode="symmetric"), size))
    colors = _to_blocks(np.pad(irradiance.astype(np.float64), margins, mode="symmetric"), size)
    weights = regress(blocks, colors, np.random.default_rng(index), options)
    fitted = np.maximum(blocks @ weights, 0)
    padded = height + sum(margins[0]), width + sum(margins[1])
    image = _from_blocks(fitted, padded, size)
    return image[top : top + height, left : left + width].astype(np.float32)


def regress(
    blocks: np.ndarray, colors: np.ndarray, rng: np.random.Generator, options: BmfrOptions
) -> np.ndarray:
    """Weights of the features in every block.

    differs: the paper factorises by QR, in half precision. In double precision the normal
    equations give the same weights: the noise bounds their condition near 1e6.

    Parameters
    ----------
    blocks : (b, p, n) float64
        Features of p pixels; the first is 1 and gets no noise.
    colors : (b, p, c) float64
    rng
        Where the noise comes from.

    Returns
    -------
    (b, n, c) float64
    """
    count = blocks.shape[2]
    shaken = np.concatenate([blocks, colors], axis=2)
    noise = rng.uniform(-options.noise, options.noise, blocks[..., 1:].shape)
    shaken[..., 1:count] += noise
    products = shaken.transpose(0, 2, 1) @ shaken
    weights: np.ndarray = np.linalg.solve(products[:, :count, :count], products[:, :count, count:])
    return weights


def block_offset(index: int, options: BmfrOptions) -> tuple[int, int]:
    """Rows and columns, in [0, block), by which the blocks of a frame begin before the image."""
    sequence = qmc.Halton(d=2, scramble=False).random(options.offsets)
    row, column = np.floor(sequence[index % options.offsets] * options.block)
    return int(row), int(column)


def _scaled(blocks: np.ndarray) -> np.ndarray:
    """Positions from 0 to 1 in every block ``(blocks, pixels, features)``."""
    scaled = blocks.copy()
    least = blocks[..., _UNSCALED:].min(axis=1, keepdims=True)
    most = blocks[..., _UNSCALED:].max(axis=1, keepdims=True)
    flat = most - least <= _LEAST_RANGE * np.maximum(np.abs(most), np.abs(least))
    scaled[..., _UNSCALED:] = (blocks[..., _UNSCALED:] - least) / np.where(flat, 1, most - least)
    scaled[..., _UNSCALED:] *= ~flat
    return scaled


def _to_blocks(image: np.ndarray, size: int) -> np.ndarray:
    """``(h, w, c)`` to ``(blocks, pixels, c)``; h and w are multiples of the block's size."""
    height, width, channels = image.shape
    grid = image.reshape(height // size, size, width // size, size, channels)
    return grid.transpose(0, 2, 1, 3, 4).reshape(-1, size * size, channels)


def _from_blocks(blocks: np.ndarray, shape: tuple[int, int], size: int) -> np.ndarray:
    """The inverse of `_to_blocks`."""
    height, width = shape
    grid = blocks.reshape(height // size, width // size, size, size, blocks.shape[2])
    return grid.transpose(0, 2, 1, 3, 4).reshape(height, width, blocks.shape[2])

"""Textures that change where surfaces stay, and albedos that are black where there is light."""

from __future__ import annotations

import cv2
import numpy as np

_PALEST = 0.1  # of the albedo that is left where the paint is darkest, the least
_LARGEST = 16  # pixels of a check's side
_STILL = 0.2  # share of textures that stay as they are
_FASTEST = 3.0  # pixels a frame that a texture moves against its surface


def _checks(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Checks, stripes or blots: which pixels are painted, ``(h, w)`` bool."""
    height, width = shape
    kind, side = rng.integers(3), int(rng.integers(1, _LARGEST + 1))
    row, column = np.mgrid[0:height, 0:width] // side
    if kind == 0:
        return (row + column) % 2 == 1
    if kind == 1:
        return np.asarray(row % 2 == 1 if rng.integers(2) else column % 2 == 1)
    coarse = rng.normal(size=(-(-height // side), -(-width // side))).astype(np.float32)
    return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR) > 0


def repainted(shape: tuple[int, int], frames: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Factors of albedo and light of some frames in a row.

    Parameters
    ----------
    shape
        Height and width.
    frames
        How many.
    rng
        Draws checks, stripes or blots of 1 to 16 pixels, how dark they are, and what becomes of
        them: they change places with what is not painted, move, or stay.

    Returns
    -------
    list of (h, w, 1) float32 arrays
        1 and 0.1 to 1.
    """
    painted, dark = _checks(shape, rng), _PALEST ** rng.random()
    fate, at = rng.random(), int(rng.integers(1, max(frames, 2)))
    way = rng.uniform(-_FASTEST, _FASTEST, 2)
    factors = []
    for frame in range(frames):
        now = painted
        if fate < _STILL:
            pass
        elif fate < (1 + _STILL) / 2:
            now = painted != (frame >= at)
        else:
            down, across = np.rint(way * frame).astype(int)
            now = np.roll(painted, (down, across), (0, 1))
        factors.append(np.where(now, dark, 1.0)[..., None].astype(np.float32))
    return factors


def blackened(shape: tuple[int, int], frames: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Factors of albedos alone, of some frames in a row: what is black there gives light all the
    same, as lamps and screens do.

    Parameters
    ----------
    shape, frames, rng
        As for `repainted`; a surface stays as it is.

    Returns
    -------
    list of (h, w, 1) float32 arrays
        0 and 1.
    """
    black = np.where(_checks(shape, rng), 0.0, 1.0)[..., None].astype(np.float32)
    return [black] * frames

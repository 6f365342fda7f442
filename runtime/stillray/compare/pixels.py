"""Pixels as a page carries them: half floats, predicted from their neighbours and compressed.

What the page's ``decode.js`` undoes: per channel the difference to the pixel on the left, green
subtracted from red and blue, signs folded into the lowest bit, high bytes before low bytes, zlib.
All in 16-bit integers that wrap, so every half float comes back bit by bit.
"""

from __future__ import annotations

import zlib

import numpy as np

_ZLIB_LEVEL = 6  # 9 takes five times as long for two per cent
_LARGEST = float(np.finfo(np.float16).max)


def pack_radiance(image: np.ndarray) -> bytes:
    """Radiance as compressed half floats.

    Parameters
    ----------
    image : (h, w, 3) float32
        Finite values beyond 65504 become that, NaN and infinities stay what they are.

    Returns
    -------
    bytes
        2 to 4 bytes a pixel for rendered images.
    """
    # clipping would turn infinities into ordinary light
    limited = np.where(np.isfinite(image), np.clip(image, -_LARGEST, _LARGEST), image)
    codes = np.ascontiguousarray(limited.astype(np.float16)).view(np.uint16)
    green = codes[..., 1].copy()
    planes = np.stack([codes[..., 0] - green, green, codes[..., 2] - green])
    planes[:, :, 1:] -= planes[:, :, :-1].copy()
    signed = planes.view(np.int16)
    folded = ((signed << 1) ^ (signed >> 15)).view(np.uint16)
    high, low = (folded >> 8).astype(np.uint8), folded.astype(np.uint8)
    return zlib.compress(high.tobytes() + low.tobytes(), _ZLIB_LEVEL)


def pack_map(errors: np.ndarray) -> bytes:
    """An error map in steps of 1/255, compressed.

    Parameters
    ----------
    errors : (h, w) float32
        In [0, 1].
    """
    steps = np.rint(np.clip(errors, 0, 1) * 255).astype(np.uint8)
    steps[:, 1:] -= steps[:, :-1].copy()
    return zlib.compress(steps.tobytes(), _ZLIB_LEVEL)


def box_average(image: np.ndarray, factor: int) -> np.ndarray:
    """Mean of cells of ``factor`` x ``factor`` pixels; the last row and column may be smaller."""
    height, width = image.shape[:2]
    rows, columns = np.arange(0, height, factor), np.arange(0, width, factor)
    sums = np.add.reduceat(np.add.reduceat(image, rows, axis=0), columns, axis=1)
    counts = np.outer(
        np.minimum(factor, height - rows), np.minimum(factor, width - columns)
    ).astype(np.float32)
    return sums / counts.reshape(counts.shape + (1,) * (image.ndim - 2))

"""Repair of what a renderer may write and a filter must not see: NaN, infinities, negatives."""

from __future__ import annotations

import cv2
import numpy as np

# Radiance above this is clamped: sums of a 13x13 window stay finite in float32.
MAX_RADIANCE = 1e30
_PIECE = 1 << 18  # values that stay in the cache between two passes


def repair_radiance(color: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Replace NaN, infinite and negative radiance from finite neighbours.

    Parameters
    ----------
    color : (h, w, 3) float32
        Radiance. Not changed.

    Returns
    -------
    color : (h, w, 3) float32
        Finite, in [0, MAX_RADIANCE]; the input itself where nothing was wrong.
    broken : (h, w) bool or None
        Pixels that held a NaN or an infinity and carry no sample of their own; None if none did.
        A negative channel counts as 0: renderers write it through filter lobes and it still is
        a sample.
    """
    low, high = _range(color)
    if low >= 0 and high <= MAX_RADIANCE:
        return color, None
    valid = np.isfinite(color).all(axis=-1)
    cleaned = np.clip(np.where(valid[..., None], color, 0), 0, MAX_RADIANCE).astype(np.float32)
    if valid.all():
        return cleaned, None
    return _fill(cleaned, valid), ~valid


def repair_feature(feature: np.ndarray, low: float, high: float) -> np.ndarray:
    """Clip a feature to its range; a value that is not finite becomes 0, "nothing was hit".

    Parameters
    ----------
    feature : float32 array of any shape
        Not changed.
    low, high
        The feature's range.
    """
    least, most = _range(feature)
    if least >= low and most <= high:
        return feature
    safe: np.ndarray = np.where(np.isfinite(feature), feature, np.float32(0))
    return np.clip(safe, low, high)


def _range(array: np.ndarray) -> tuple[float, float]:
    # a NaN makes both NaN, and every comparison with them false; pieces are read once for both
    flat = array.reshape(-1)
    pieces = [flat[start : start + _PIECE] for start in range(0, flat.size, _PIECE)]
    ranges = np.array([(piece.min(), piece.max()) for piece in pieces])
    return float(ranges[:, 0].min()), float(ranges[:, 1].max())


def _fill(color: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Mean of the valid pixels in the smallest window of 3, 5, 9, ... pixels that has any."""
    result = color.copy()
    missing = ~valid
    weight = valid.astype(np.float32)
    reach = 1
    while missing.any() and reach < 2 * max(valid.shape) and valid.any():
        # a mean of values up to MAX_RADIANCE: normalised kernels keep the sum in range
        kernel = np.full(2 * reach + 1, 1 / (2 * reach + 1), np.float32)
        near = cv2.sepFilter2D(weight, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_CONSTANT)
        total = cv2.sepFilter2D(color, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_CONSTANT)
        now = missing & (near > 0)
        result[now] = total[now] / near[now, None]
        missing &= ~now
        reach *= 2
    return result

"""Repair of what a renderer may write and a filter must not see: NaN, infinities, negatives."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from stillray.frame import Frame

# Radiance above this is clamped: sums of a 13x13 window stay finite in float32.
MAX_RADIANCE = 1e30
MAX_DEPTH = 1e30  # any unit; keeps products of depth in float32
MAX_MOTION = 1e6  # pixels; outside of every frame
_RANGES = {
    "color": (0.0, MAX_RADIANCE),
    "albedo": (0.0, 1.0),
    "normal": (-1.0, 1.0),
    "depth": (0.0, MAX_DEPTH),
    "motion": (-MAX_MOTION, MAX_MOTION),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Buffers:
    """A frame's buffers, as given or repaired.

    Attributes
    ----------
    color, albedo, normal, depth, motion, samples
        As in `Frame`.
    broken : (h, w) bool or None
        Pixels whose color was not finite, or that have no samples, and which are filled in.
    """

    color: np.ndarray
    albedo: np.ndarray | None
    normal: np.ndarray | None
    depth: np.ndarray | None
    motion: np.ndarray | None
    samples: float | np.ndarray | None = None
    broken: np.ndarray | None = None

    @classmethod
    def of(cls, frame: Frame) -> Buffers:
        """The buffers as given."""
        return cls(**{name: getattr(frame, name) for name in _RANGES}, samples=frame.samples)

    def in_range(self, rows: slice) -> bool:
        """Whether nothing in these rows needs repair."""
        arrays = {name: getattr(self, name) for name in _RANGES}
        if isinstance(self.samples, np.ndarray) and not self.samples[rows].all():
            return False
        return all(
            within(array[rows], *_RANGES[name])
            for name, array in arrays.items()
            if array is not None
        )

    def repaired(self) -> Buffers:
        """All in range; what was, is passed on without a copy."""
        empty = self.samples == 0 if isinstance(self.samples, np.ndarray) else None
        color, broken = repair_radiance(self.color, empty)
        features = {
            name: None if array is None else repair_feature(array, *_RANGES[name])
            for name in ("albedo", "normal", "depth")
            for array in [getattr(self, name)]
        }
        motion = None if self.motion is None else repair_motion(self.motion)
        return replace(self, color=color, motion=motion, broken=broken, **features)


def repair_radiance(
    color: np.ndarray, empty: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray | None]:
    """Replace NaN, infinite and negative radiance from finite neighbours.

    Parameters
    ----------
    color : (h, w, 3) float32
        Radiance. Not changed.
    empty : (h, w) bool, optional
        Pixels whose radiance means nothing, whatever it says.

    Returns
    -------
    color : (h, w, 3) float32
        Finite, in [0, MAX_RADIANCE]; the input itself where nothing was wrong.
    broken : (h, w) bool or None
        Pixels that held a NaN or an infinity, or were empty, and carry no sample of their own;
        None if none did.
        A negative channel counts as 0: renderers write it through filter lobes and it still is
        a sample.
    """
    empty = empty if empty is not None and empty.any() else None
    if empty is None and within(color, 0, MAX_RADIANCE):
        return color, None
    valid = np.isfinite(color).all(axis=-1)
    if empty is not None:
        valid &= ~empty
    cleaned = np.clip(np.where(valid[..., None], color, 0), 0, MAX_RADIANCE).astype(np.float32)
    if valid.all():
        return cleaned, None
    return fill(cleaned, valid), ~valid


def repair_feature(feature: np.ndarray, low: float, high: float) -> np.ndarray:
    """Clip a feature to its range; a value that is not finite becomes 0, "nothing was hit".

    Parameters
    ----------
    feature : float32 array of any shape
        Not changed.
    low, high
        The feature's range.
    """
    if within(feature, low, high):
        return feature
    safe: np.ndarray = np.where(np.isfinite(feature), feature, np.float32(0))
    return np.clip(safe, low, high)


def repair_motion(motion: np.ndarray) -> np.ndarray:
    """Motion that is not finite, or beyond MAX_MOTION, becomes MAX_MOTION.

    A point that came from nowhere is one that came from far outside.
    """
    if within(motion, *_RANGES["motion"]):
        return motion
    return np.where(np.abs(motion) <= MAX_MOTION, motion, np.float32(MAX_MOTION))


def within(array: np.ndarray, low: float, high: float) -> bool:
    """Whether all values lie in a range; NaN lies in none."""
    return bool(array.min() >= low and array.max() <= high)


def fill(color: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Mean of the valid pixels in the smallest window of 3, 5, 9, ... pixels that has any.

    Parameters
    ----------
    color : (h, w, 3) float32
        0 where it is not valid. Not changed.
    valid : (h, w) bool

    Returns
    -------
    (h, w, 3) float32
    """
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

"""Repair of what a renderer may write and a filter must not see: NaN, infinities, negatives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from stillray.arrays.strips import STRIP_PIXELS, Strips, with_halo
from stillray.frame import Frame

# Radiance above this is clamped: sums of a 13x13 window stay finite in float32.
MAX_RADIANCE = 1e30
MAX_DEPTH = 1e30  # any unit; keeps products of depth in float32
MAX_MOTION = 1e6  # pixels; outside of every frame
_FEW_TAPS = 32  # of a window's side: with more, strips are of fewer pixels
_ONE = np.ones(1, np.float32)
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
    color, albedo, normal, depth, motion, samples, filter_spread
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
    filter_spread: float | None = None
    broken: np.ndarray | None = None

    @classmethod
    def of(cls, frame: Frame) -> Buffers:
        """The buffers as given."""
        return cls(
            **{name: getattr(frame, name) for name in _RANGES},
            samples=frame.samples,
            filter_spread=frame.filter_spread,
        )

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

    def repaired(self, strips: Strips | None = None) -> Buffers:
        """All in range; what was, is passed on without a copy.

        Parameters
        ----------
        strips
            Where the work runs; None for the caller's thread.
        """
        empty = self.samples == 0 if isinstance(self.samples, np.ndarray) else None
        color, broken = repair_radiance(self.color, empty, strips)
        features: dict[str, Any] = {
            name: None if array is None else repair_feature(array, *_RANGES[name], strips)
            for name in ("albedo", "normal", "depth")
            for array in [getattr(self, name)]
        }
        motion = None if self.motion is None else repair_motion(self.motion, strips)
        return replace(self, color=color, motion=motion, broken=broken, **features)


def repair_radiance(
    color: np.ndarray, empty: np.ndarray | None = None, strips: Strips | None = None
) -> tuple[np.ndarray, np.ndarray | None]:
    """Replace NaN, infinite and negative radiance from finite neighbours.

    Parameters
    ----------
    color : (h, w, 3) float32
        Radiance. Not changed.
    empty : (h, w) bool, optional
        Pixels whose radiance means nothing, whatever it says.
    strips
        Where the work runs; None for the caller's thread.

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
    strips = strips or Strips(1)
    if empty is None and all_within(color, 0, MAX_RADIANCE, strips):
        return color, None
    shape = color.shape[:2]
    valid, cleaned = np.empty(shape, bool), np.empty(color.shape, np.float32)

    def work(rows: slice) -> None:
        valid[rows] = np.isfinite(color[rows]).all(axis=-1)
        if empty is not None:
            valid[rows] &= ~empty[rows]
        safe = np.where(valid[rows, :, None], color[rows], 0)
        cleaned[rows] = np.clip(safe, 0, MAX_RADIANCE)

    strips.run(work, *shape)
    if valid.all():
        return cleaned, None
    return fill(cleaned, valid, strips), ~valid


def repair_feature(
    feature: np.ndarray, low: float, high: float, strips: Strips | None = None
) -> np.ndarray:
    """Clip a feature to its range; a value that is not finite becomes 0, "nothing was hit".

    Parameters
    ----------
    feature : (h, w) or (h, w, c) float32 array
        Not changed.
    low, high
        The feature's range.
    strips
        Where the work runs; None for the caller's thread.
    """
    strips = strips or Strips(1)
    if all_within(feature, low, high, strips):
        return feature
    result = np.empty_like(feature)

    def work(rows: slice) -> None:
        part = feature[rows]
        np.clip(np.where(np.isfinite(part), part, np.float32(0)), low, high, out=result[rows])

    strips.run(work, *feature.shape[:2])
    return result


def repair_alpha(alpha: np.ndarray, strips: Strips) -> np.ndarray:
    """Alpha that is not finite comes from finite neighbours, as color does: they go together.

    Parameters
    ----------
    alpha : (h, w) float32
        Not changed.
    strips
        Where the work runs.

    Returns
    -------
    (h, w) float32
        Finite, if not in [0, 1]; the input itself where nothing was wrong.
    """
    most = float(np.finfo(np.float32).max)
    if all_within(alpha, -most, most, strips):
        return alpha
    valid, grey = np.empty(alpha.shape, bool), np.empty((*alpha.shape, 3), np.float32)

    def work(rows: slice) -> None:
        valid[rows] = np.isfinite(alpha[rows])
        grey[rows] = np.where(valid[rows], np.clip(alpha[rows], 0, 1), np.float32(0))[..., None]

    strips.run(work, *alpha.shape)
    return np.where(valid, alpha, fill(grey, valid, strips)[..., 0])


def repair_motion(motion: np.ndarray, strips: Strips | None = None) -> np.ndarray:
    """Motion that is not finite, or beyond MAX_MOTION, becomes MAX_MOTION.

    A point that came from nowhere is one that came from far outside. It is ``(h, w, 2)`` float32;
    ``strips`` as for `repair_feature`.
    """
    strips = strips or Strips(1)
    if all_within(motion, *_RANGES["motion"], strips):
        return motion
    result = np.empty_like(motion)

    def work(rows: slice) -> None:
        part = motion[rows]
        result[rows] = np.where(np.abs(part) <= MAX_MOTION, part, np.float32(MAX_MOTION))

    strips.run(work, *motion.shape[:2])
    return result


def all_within(array: np.ndarray, low: float, high: float, strips: Strips) -> bool:
    """`within` of a whole frame, ``(h, w)`` or ``(h, w, c)``."""
    return all(strips.run(lambda rows: within(array[rows], low, high), *array.shape[:2]))


def within(array: np.ndarray, low: float, high: float) -> bool:
    """Whether all values lie in a range; NaN lies in none."""
    return bool(array.min() >= low and array.max() <= high)


def fill(color: np.ndarray, valid: np.ndarray, strips: Strips | None = None) -> np.ndarray:
    """Mean of the valid pixels in the smallest window of 3, 5, 9, ... pixels that has any.

    Parameters
    ----------
    color : (h, w, 3) float32
        0 where it is not valid. Not changed.
    valid : (h, w) bool
    strips
        Where the work runs; None for the caller's thread.

    Returns
    -------
    (h, w, 3) float32
    """
    strips = strips or Strips(1)
    result, weight = np.empty_like(color), np.empty(valid.shape, np.float32)
    missing = ~valid

    def begin(rows: slice) -> None:
        result[rows], weight[rows] = color[rows], valid[rows]

    strips.run(begin, *valid.shape)
    reach, anywhere = 1, valid.any()
    while missing.any() and reach < 2 * max(valid.shape) and anywhere:
        _fill_from(reach, (weight, color), missing, result, strips)
        reach *= 2
    return result


def _fill_from(
    reach: int,
    given: tuple[np.ndarray, np.ndarray],
    missing: np.ndarray,
    result: np.ndarray,
    strips: Strips,
) -> None:
    """Fill what is missing from windows of one size, where those have a valid pixel.

    Parameters
    ----------
    reach
        Of the windows, pixels to each side.
    given
        What pixels weigh, and their color.
    missing, result
        Changed.
    """
    # a mean of values up to MAX_RADIANCE: normalised kernels keep the sum in range
    kernel = np.full(2 * reach + 1, 1 / (2 * reach + 1), np.float32)
    height, width = missing.shape
    lines = np.flatnonzero(missing.any(axis=1))
    top, bottom = int(lines[0]), int(lines[-1]) + 1
    near, _ = with_halo(slice(top, bottom), reach, height)
    pixels = max(STRIP_PIXELS * _FEW_TAPS // max(len(kernel), _FEW_TAPS), 1)
    along = [np.empty_like(image[near]) for image in given]

    def by_row(rows: slice) -> None:
        for image, target in zip(given, along, strict=True):
            target[rows] = _filtered(image[near][rows], kernel, _ONE)

    def by_column(rows: slice) -> None:
        own = slice(top + rows.start, top + rows.stop)
        around, inside = with_halo(own, reach, height)
        around = slice(around.start - near.start, around.stop - near.start)
        share, total = (_filtered(image[around], _ONE, kernel)[inside] for image in along)
        now = missing[own] & (share > 0)
        result[own][now] = total[now] / share[now, None]
        missing[own] &= ~now

    strips.run(by_row, near.stop - near.start, width, pixels=pixels)
    strips.run(by_column, bottom - top, width, pixels=pixels)


def _filtered(image: np.ndarray, across: np.ndarray, down: np.ndarray) -> np.ndarray:
    return cv2.sepFilter2D(image, cv2.CV_32F, across, down, borderType=cv2.BORDER_CONSTANT)

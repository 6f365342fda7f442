"""Warping error: how much a picture changes on surfaces that stay in view (Lai et al. 2018).

Flicker as an eye that follows the picture sees it. A mean over differences at the same pixel, as
`stillray.compare.metrics.flicker` is, counts wherever the camera moves what is wrong but stays as
it is. Blur lowers it, so that it says something beside metrics of single frames only.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stillray.compare.display import display_exposure, tone_map
from stillray.frame import Frame
from stillray.stages.reproject import bilinear, positions_of

_DEPTH_RATIO = 0.1  # by which depths of one surface may differ
_NORMAL_COSINE = 0.9  # and of its normals


@dataclass(frozen=True, eq=False)
class Followed:
    """Where a frame's pixels were in the frame before.

    Attributes
    ----------
    positions : (h, w, 2) float32
        x and y, pixels.
    seen : (h, w) bool
        Whether the same surface was in view there.
    """

    positions: np.ndarray
    seen: np.ndarray

    @staticmethod
    def between(before: Frame, frame: Frame) -> Followed | None:
        """By motion; depth and normals, where both frames have them, tell what was uncovered.

        None where the frame has no motion.
        """
        if frame.motion is None:
            return None
        motion = np.asarray(frame.motion, np.float32)
        height, width = motion.shape[:2]
        finite = np.asarray(np.isfinite(motion).all(axis=-1))
        positions = positions_of(np.where(finite[..., None], motion, 0), slice(0, height))
        x, y = positions[..., 0], positions[..., 1]
        seen = finite & (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        if frame.depth is not None and before.depth is not None:
            depth = np.nan_to_num(frame.depth).astype(np.float32)
            was = warped(np.nan_to_num(before.depth).astype(np.float32), positions)
            seen &= np.abs(was - depth) <= _DEPTH_RATIO * np.minimum(np.abs(was), np.abs(depth))
        if frame.normal is not None and before.normal is not None:
            was = warped(np.nan_to_num(before.normal).astype(np.float32), positions)
            cosine = np.sum(was * np.nan_to_num(frame.normal), axis=-1)
            nothing = ~np.any(frame.normal, axis=-1) & ~np.any(was, axis=-1)
            seen &= (cosine >= _NORMAL_COSINE) | nothing
        return Followed(positions, seen)


def warped(image: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """A plane or three, ``(h, w)`` or ``(h, w, 3)`` float32, at positions; zeros lie outside."""
    planes = image.reshape(*image.shape[:2], -1)
    four = np.zeros((*image.shape[:2], 4), np.float32)
    four[..., : planes.shape[2]] = planes
    out = np.empty((*positions.shape[:2], 4), np.float32)
    bilinear(four, positions, out)
    return out[..., : planes.shape[2]].reshape(*positions.shape[:2], *image.shape[2:])


def warping_error(
    before: np.ndarray, image: np.ndarray, reference: np.ndarray, followed: Followed
) -> float:
    """Mean absolute difference of two consecutive pictures along the motion, tone-mapped.

    differs: Lai et al. 2018 square it, and find motion and what was occluded by optical flow.

    Parameters
    ----------
    before, image : (h, w, 3) float32
        Scene-linear radiance.
    reference : (h, w, 3) float32
        Both are exposed for.
    followed
        Where the pixels of ``image`` were, some of which were seen.

    Returns
    -------
    float
        In [0, 1], over the pixels that were seen before.
    """
    exposure = display_exposure(reference)
    shown, was = (tone_map(picture, exposure).astype(np.float32) for picture in (image, before))
    change = cv2.absdiff(shown, warped(was, followed.positions)).mean(axis=-1)
    return float(np.mean(change[followed.seen], dtype=np.float64))

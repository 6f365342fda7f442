"""Reprojection: where a pixel's surface was in the previous frame, and what was known of it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stillray.models_spec.loader import Temporal

_IRRELEVANT = np.float32(1e-20)  # depth unit: keeps 0/0 out of the ratio at background pixels


@dataclass(frozen=True, kw_only=True, eq=False)
class Guides:
    """Geometry that decides whether two pixels show the same surface.

    Parameters
    ----------
    normal : (h, w, 3) float32 or None
    depth : (h, w) float32 or None
        0 where nothing was hit.
    """

    normal: np.ndarray | None
    depth: np.ndarray | None

    def rows(self, rows: slice) -> Guides:
        """A view of some rows."""
        return Guides(
            normal=None if self.normal is None else self.normal[rows],
            depth=None if self.depth is None else self.depth[rows],
        )


def reproject(
    history: np.ndarray,
    before: Guides,
    now: Guides,
    motion: np.ndarray | None,
    rows: slice,
    options: Temporal,
) -> np.ndarray:
    """Bring the history to the current pixels, bilinear taps accepted one by one.

    A tap counts when it lies in the frame, holds samples, and shows the same surface: its normal
    within ``normal_cosine`` and its depth within ``depth_ratio`` of the current pixel's. The
    weights of the accepted taps are normalised, so that one good tap is enough; the sample count
    is scaled by the accepted share, so that a pixel at a disocclusion does not claim more than
    it has (Fan et al. 2021, section 4.1; differs: per tap, as in Schied et al. 2017, section 4.1,
    and no world positions are needed).

    Parameters
    ----------
    history : (H, w, 4) float32
        Irradiance and, last, the samples that it holds; the whole previous frame.
    before
        Guides of the whole previous frame.
    now
        Guides of the rows to fill.
    motion : (h, w, 2) float32 or None
        Pixels, of the rows to fill; None where nothing moves.
    rows
        The rows of the frame to fill.

    Returns
    -------
    (h, w, 4) float32
        Irradiance and samples at the current pixels; zeros where no tap was accepted.
    """
    if motion is None:
        taken = history[rows].copy()
        accepted = _same_surface(before.rows(rows), now, options)
        return taken if accepted is None else taken * accepted[..., None]
    height, width = motion.shape[:2]
    column, row = np.meshgrid(
        np.arange(width, dtype=np.float32),
        np.arange(rows.start, rows.stop, dtype=np.float32),
    )
    x, y = column + motion[..., 0], row + motion[..., 1]
    # NaN and far positions land outside the frame, where every tap is empty
    inside = (x > -1) & (x < width) & (y > -1) & (y < history.shape[0])
    x, y = np.where(inside, x, np.float32(-4)), np.where(inside, y, np.float32(-4))
    left, top = np.floor(x), np.floor(y)
    right_share, low_share = x - left, y - top
    total = np.zeros((height, width, 4), np.float32)
    weight_sum = np.zeros((height, width), np.float32)
    for tap_y, share_y in ((0, 1 - low_share), (1, low_share)):
        for tap_x, share_x in ((0, 1 - right_share), (1, right_share)):
            weight = share_x * share_y
            at_x, at_y = left + tap_x, top + tap_y
            tap = _fetch(history, at_x, at_y)
            found = Guides(
                normal=None if before.normal is None else _fetch(before.normal, at_x, at_y),
                depth=None if before.depth is None else _fetch(before.depth, at_x, at_y),
            )
            accepted = _same_surface(found, now, options)
            if accepted is not None:
                weight *= accepted
            weight *= tap[..., 3] > 0
            total += weight[..., None] * tap
            weight_sum += weight
    # samples stay scaled by the accepted share; irradiance is normalised
    total[..., :3] /= np.maximum(weight_sum, np.float32(1e-12))[..., None]
    return total


def _fetch(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    # at whole pixels every interpolation is a copy; nearest is the one that computes nothing
    return cv2.remap(image, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)


def _same_surface(before: Guides, now: Guides, options: Temporal) -> np.ndarray | None:
    """1 where both show one surface, else 0; None where no guide can tell."""
    accepted: np.ndarray | None = None
    if before.normal is not None and now.normal is not None:
        cosine = cv2.transform(before.normal * now.normal, np.ones((1, 3), np.float32))
        # background has no normal: it goes with background only
        empty_now = ~now.normal.any(axis=-1)
        empty_before = ~before.normal.any(axis=-1)
        accepted = np.where(
            empty_now | empty_before, empty_now & empty_before, cosine >= options.normal_cosine
        )
    if before.depth is not None and now.depth is not None:
        difference = np.abs(before.depth - now.depth)
        near = difference <= options.depth_ratio * np.maximum(now.depth, _IRRELEVANT)
        accepted = near if accepted is None else accepted & near
    return None if accepted is None else accepted.astype(np.float32)

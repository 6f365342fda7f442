"""Where features tell that a pixel lies at an outline: of a thing, a fold or a stain."""

from __future__ import annotations

import cv2
import numpy as np

from stillray.arrays.strips import Strips, with_halo

_AROUND = np.ones((3, 3), np.uint8)
_FARTHER = 1.1  # times as far
_TURNED = 0.4  # of a component of a normal
_PAINTED = 0.2  # of a channel of an albedo
_SPARSE = 15  # pixels around each way, of which less than
_MOST = 0.8  # lie at an outline: others are patterns, leaves, noise of the features
_NOWHERE = np.float32(1e9)  # as far as what was not hit counts as


def outlines(
    depth: np.ndarray | None,
    normal: np.ndarray | None,
    albedo: np.ndarray | None,
    strips: Strips,
) -> np.ndarray | None:
    """Pixels around which features differ within 3x3 pixels, where most others' do not.

    Parameters
    ----------
    depth : (h, w) float32 or None
        0 where nothing was hit.
    normal, albedo : (h, w, 3) float32 or None
    strips
        Where the work runs.

    Returns
    -------
    (h, w) bool or None
        None without any feature.
    """
    given = [image for image in (depth, normal, albedo) if image is not None]
    if not given:
        return None
    height, width = given[0].shape[:2]
    found = np.zeros((height, width), bool)

    def work(rows: slice) -> None:
        near, inside = with_halo(rows, 1, height)
        if depth is not None:
            far = np.where(depth[near] > 0, depth[near], _NOWHERE)
            most, least = cv2.dilate(far, _AROUND), cv2.erode(far, _AROUND)
            found[rows] |= (most > np.float32(_FARTHER) * least)[inside]
        for image, limit in ((normal, _TURNED), (albedo, _PAINTED)):
            if image is not None:
                most, least = cv2.dilate(image[near], _AROUND), cv2.erode(image[near], _AROUND)
                differs = np.greater(np.subtract(most, least, out=most), np.float32(limit))
                found[rows] |= differs.any(axis=2)[inside]

    strips.run(work, height, width)
    # whole, since OpenCV carries sums on from row to row, and strips would show
    share = cv2.blur(found.astype(np.float32), (_SPARSE, _SPARSE), borderType=cv2.BORDER_REFLECT)
    return np.logical_and(found, share < np.float32(_MOST), out=found)

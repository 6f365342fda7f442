"""Silhouettes: pixels whose picture is a mean of a nearer surface and of what is behind it."""

from __future__ import annotations

import cv2
import numpy as np

from stillray.arrays.strips import pixels_of, with_halo
from stillray.arrays.workspace import Workspace

_NEARER = np.float32(0.98)  # share of a pixel's depth below which a neighbour hides it
_FAR = np.float32(1e30)  # depth of background
_AROUND = np.ones((3, 3), np.uint8)
# Any 3x3 pixels differ in their row modulo 3 or their column modulo 3. Those stand in the last four
# bits of a depth, a millionth of it, so that the least of nine depths tells whose it is.
_PLACE, _COLUMN = 15, 3
_STEP = np.array([1, -1, 0, 1, -1], np.intp)  # to a neighbour, by the difference of both + 2


def dilate_motion(
    positions: np.ndarray, motion: np.ndarray, depth: np.ndarray, rows: slice, workspace: Workspace
) -> None:
    """At silhouettes, let a picture come from where the nearer surface was.

    There a picture is a mean of what is in front and what is behind, and moves with what is in
    front; a frame's sample is of one of both, by chance, and so is its motion (Karis 2014, *High
    Quality Temporal Supersampling*, does so).

    Parameters
    ----------
    positions : (rows, w, 2) float32
        Where the pixels of some rows were, see `stillray.stages.reproject.positions_of`. Changed
        where the nearest of the 3x3 pixels around is clearly nearer: by that one's motion.
    motion : (h, w, 2) float32
        Of the whole frame, pixels, finite.
    depth : (h, w) float32
        Of the whole frame; 0 where nothing was hit.
    rows
        Which rows of the frame they are.
    workspace
        Where temporaries lie.
    """
    height, width = depth.shape
    near, inner = with_halo(rows, 1, height)
    around = workspace.array("around", depth[near].shape)
    nearest = workspace.array("nearest", around.shape)
    np.copyto(around, depth[near])
    if around.min() <= 0:
        around[around <= 0] = _FAR
    bits = around.view(np.int32)
    bits &= ~_PLACE
    bits |= np.arange(width, dtype=np.int32) % 3
    # rows of the frame, not of the strip: among equal depths the place decides
    bits |= (np.arange(near.start, near.stop, dtype=np.int32) % 3 << 2)[:, None]
    cv2.erode(around, _AROUND, dst=nearest)
    hidden = nearest[inner] < around[inner] * _NEARER
    at = np.flatnonzero(hidden)
    own, other = (
        np.take(depths[inner].reshape(-1), at).view(np.int32) & _PLACE
        for depths in (around, nearest)
    )
    down = _STEP[(other >> 2) - (own >> 2) + 2]
    right = _STEP[(other & _COLUMN) - (own & _COLUMN) + 2]
    row, column = np.divmod(at + rows.start * width, width)
    place = np.take(pixels_of(motion), (row + down) * width + column + right)
    place.real += column
    place.imag += row
    pixels_of(positions)[at] = place

"""Silhouettes: pixels whose picture is a mean of a nearer surface and of what is behind it."""

from __future__ import annotations

import cv2
import numpy as np

from stillray.strips import Strips, with_halo

_NEARER = np.float32(0.98)  # share of a pixel's depth below which a neighbour hides it
_FAR = np.float32(1e30)  # depth of background
_AROUND = np.ones((3, 3), np.uint8)


def motion_of_edges(motion: np.ndarray, depth: np.ndarray | None, strips: Strips) -> np.ndarray:
    """Motion by which a past picture is followed: at silhouettes, that of the nearer surface.

    There a picture is a mean of what is in front and what is behind, and moves with what is in
    front; a frame's sample is of one of both, by chance, and so is its motion (Karis 2014, *High
    Quality Temporal Supersampling*, does so).

    Parameters
    ----------
    motion : (h, w, 2) float32
        Pixels.
    depth : (h, w) float32 or None
        0 where nothing was hit; None: the motion as it is.
    strips
        Where the work runs.

    Returns
    -------
    (h, w, 2) float32
        Each pixel's own, or that of the nearest of the 3x3 pixels around if that is clearly
        nearer; the argument itself where none is.
    """
    if depth is None:
        return motion
    height, width = depth.shape

    def silhouettes(rows: slice) -> tuple[np.ndarray, np.ndarray]:
        around, inner = with_halo(rows, 1, height)
        scratch = strips.scratch
        shape = (around.stop - around.start, width)
        own, nearest = scratch.array("own", shape), scratch.array("nearest", shape)
        np.copyto(own, depth[around])
        own[own <= 0] = _FAR
        cv2.erode(own, _AROUND, dst=nearest)
        limit = np.multiply(own, _NEARER, out=scratch.array("limit", shape))
        at = np.flatnonzero((nearest < limit)[inner])
        row, column = at // width + inner.start, at % width
        wanted, found = nearest[row, column], np.zeros((len(at), 2), np.float32)
        for down, right in np.ndindex(3, 3):
            y = np.clip(row + down - 1, 0, shape[0] - 1)
            x = np.clip(column + right - 1, 0, width - 1)
            hit = own[y, x] == wanted
            found[hit] = motion[y[hit] + around.start, x[hit]]
        return at + rows.start * width, found

    parts = strips.run(silhouettes, height, width)
    if not any(len(at) for at, _ in parts):
        return motion
    followed = motion.copy()
    for at, found in parts:
        followed.reshape(-1, 2)[at] = found
    return followed

"""Silhouettes: pixels whose picture is a mean of a nearer surface and of what is behind it."""

from __future__ import annotations

import cv2
import numpy as np

from stillray.strips import Strips, with_halo

_NEARER = np.float32(0.98)  # share of a pixel's depth below which a neighbour hides it
_FAR = np.float32(1e30)  # depth of background
_AROUND = np.ones((3, 3), np.uint8)


def motion_of_edges(
    motion: np.ndarray,
    depth: np.ndarray | None,
    strips: Strips,
    out: np.ndarray | None = None,
) -> np.ndarray:
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
    out : (h, w, 2) float32, optional
        Written and returned where some pixel goes with another.

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
        """Which pixels of some rows go with a neighbour, and with which, as flat indices."""
        scratch = strips.scratch
        # with a border of pixels that hide nothing
        shape = (rows.stop - rows.start + 2, width + 2)
        around, nearest = scratch.array("around", shape), scratch.array("nearest", shape)
        around.fill(_FAR)
        near, inner = with_halo(rows, 1, height)
        first = 1 - inner.start
        seen = around[first : first + near.stop - near.start, 1:-1]
        np.copyto(seen, depth[near])
        if seen.min() <= 0:
            seen[seen <= 0] = _FAR
        cv2.erode(around, _AROUND, dst=nearest)
        own = around[1:-1, 1:-1]
        hidden = nearest[1:-1, 1:-1] < own * _NEARER
        row, column = np.divmod(np.flatnonzero(hidden), width)
        steps = np.add.outer(np.arange(3) * shape[1], np.arange(3)).ravel()
        candidates = np.add.outer(row * shape[1] + column, steps)
        step = np.take(around.reshape(-1), candidates).argmin(axis=1)
        at = (row + rows.start) * width + column
        return at, at + (step // 3 - 1) * width + step % 3 - 1

    parts = strips.run(silhouettes, height, width)
    if not any(len(at) for at, _ in parts):
        return motion
    followed = np.empty((height, width, 2), np.float32) if out is None else out
    np.copyto(followed, motion)
    # two floats as one element: NumPy then picks and puts pixels faster
    pixels = np.ascontiguousarray(motion).reshape(-1).view(np.complex64)
    for at, neighbour in parts:
        followed.reshape(-1).view(np.complex64)[at] = pixels[neighbour]
    return followed

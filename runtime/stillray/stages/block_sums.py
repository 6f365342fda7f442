"""Sums over blocks of pixels and windows of those: what lines are fitted to, place by place."""

from __future__ import annotations

import cv2
import numpy as np

from stillray.arrays.strips import Strips
from stillray.arrays.workspace import Workspace

BLOCK = 8  # pixels along an edge
LEAST_WEIGHT = 1e-6  # of a window, in pixels of one: where nothing was hit there is nothing to fit
#: Pairs of neighbours, of a pixel of a block: its last row has none below.
NEIGHBOURS = 2 - 1 / BLOCK


def mean_of_blocks(plane: np.ndarray, out: np.ndarray) -> None:
    """Means of the blocks of ``(h, w)`` into ``(rows, columns)``; beyond it is nothing, 0."""
    shape = (BLOCK * out.shape[0], BLOCK * out.shape[1])
    if plane.shape != shape:
        bottom, right = (size - own for size, own in zip(shape, plane.shape, strict=True))
        plane = cv2.copyMakeBorder(plane, 0, bottom, 0, right, cv2.BORDER_CONSTANT, value=0)
    cv2.resize(plane, out.shape[::-1], dst=out, interpolation=cv2.INTER_AREA)


def with_neighbours(weighed: np.ndarray, out: np.ndarray, workspace: Workspace) -> np.ndarray:
    """Products of planes ``(n, h, w)`` with those to the right, and below in their block.

    What is alike from pixel to pixel has large ones; noise of single pixels has none.
    """
    below = workspace.array("below", out.shape)
    out.fill(0)
    below.fill(0)
    for plane in weighed:
        cv2.accumulateProduct(plane[:, :-1], plane[:, 1:], out[:, :-1])
        cv2.accumulateProduct(plane[:-1], plane[1:], below[:-1])
    below[BLOCK - 1 :: BLOCK] = 0  # of rows that another strip may have
    out += below
    return out


def widened(sums: np.ndarray, window: float, strips: Strips, out: np.ndarray) -> None:
    """Means of blocks ``(n, rows, columns)`` over Gaussian windows, into float64 of that shape.

    Parameters
    ----------
    sums
        Beyond them is nothing.
    window
        Standard deviation, pixels, > 0.
    strips
        Where the work runs.
    out
        Written.
    """
    sigma = window / BLOCK
    kernel = cv2.getGaussianKernel(2 * int(np.ceil(3 * sigma)) + 1, sigma)

    def widen(planes: slice) -> None:
        for plane, target in zip(sums[planes], out[planes], strict=True):
            border = cv2.BORDER_CONSTANT
            cv2.sepFilter2D(plane, cv2.CV_64F, kernel, kernel, dst=target, borderType=border)

    count, rows, columns = sums.shape
    strips.run(widen, count, rows * columns)


def enlarged(found: np.ndarray, strips: Strips, out: np.ndarray) -> None:
    """What was found for blocks ``(n, rows, columns)``, and between them, for all their pixels."""
    count, *size = out.shape

    def enlarge(planes: slice) -> None:
        for small, large in zip(found[planes], out[planes], strict=True):
            cv2.resize(small, size[::-1], dst=large, interpolation=cv2.INTER_LINEAR)

    strips.run(enlarge, count, size[0] * size[1])

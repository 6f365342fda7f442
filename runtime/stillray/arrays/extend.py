"""Frames carried on to a size that a network's levels divide."""

from __future__ import annotations

import cv2
import numpy as np

from stillray.arrays.strips import Strips


def extended(image: np.ndarray, out: np.ndarray, strips: Strips) -> np.ndarray:
    """An image with its last row and column repeated.

    Parameters
    ----------
    image : (h, w) or (h, w, c) float32
    out : (H, W) or (H, W, c) float32
        Written and returned; at least as large.
    strips
        Where the work runs.
    """
    height, width = image.shape[:2]
    right = out.shape[1] - width

    def work(rows: slice) -> None:
        inside = image[min(rows.start, height - 1) : min(rows.stop, height)]
        below = rows.stop - rows.start - len(inside)
        cv2.copyMakeBorder(inside, 0, below, 0, right, cv2.BORDER_REPLICATE, dst=out[rows])

    strips.run(work, *out.shape[:2])
    return out

"""Frames carried on beyond their borders: to whole blocks, and to where windows look."""

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


def surround(planes: np.ndarray, out: np.ndarray, reach: int, rows: slice) -> None:
    """Some rows of planes that are carried on by their outermost pixels, on every side.

    Parameters
    ----------
    planes : (..., h, w) float32
    out : (..., H, W) float32
        Written in those rows.
    reach
        Where the planes begin in ``out``: rows from its top, columns from its left.
    rows
        Of ``out``.
    """
    height, width = planes.shape[-2:]
    source = np.clip(np.arange(rows.start, rows.stop) - reach, 0, height - 1)
    target, end = out[..., rows, :], reach + width
    target[..., reach:end] = planes[..., source, :]
    target[..., :reach] = target[..., reach : reach + 1]
    target[..., end:] = target[..., end - 1 : end]


def cut(image: np.ndarray, shape: tuple[int, int], strips: Strips) -> np.ndarray:
    """`extended` undone: the top left of an image ``(H, W, c)``, itself if it is that already."""
    if image.shape[:2] == shape:
        return image
    result = np.empty((*shape, *image.shape[2:]), np.float32)

    def work(rows: slice) -> None:
        result[rows] = image[rows, : shape[1]]

    strips.run(work, *shape)
    return result

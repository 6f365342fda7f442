"""Frames carried on beyond their borders: to whole blocks, and to where windows look."""

from __future__ import annotations

import cv2
import numpy as np

from stillray.arrays.strips import Strips


def mirrored(size: int, full: int) -> np.ndarray:
    """Places 0 to ``full - 1`` of a row of ``size`` pixels and of its mirror images beyond it.

    A border's noise goes on as noise there; its outermost pixel repeated would look like something
    that is as long and has none.

    Returns
    -------
    (full,) int
        Where each lies, in [0, size): 0, 1, ..., size - 1, size - 1, ..., 1, 0, 0, 1, ...
    """
    return np.pad(np.arange(size), (0, full - size), mode="symmetric")


def extended(image: np.ndarray, out: np.ndarray, strips: Strips) -> np.ndarray:
    """An image carried on below and to the right by its mirror image, see `mirrored`.

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
    down = mirrored(height, len(out))

    def work(rows: slice) -> None:
        inside = slice(rows.start, min(rows.stop, height))
        below = slice(max(rows.start, height), rows.stop)
        # rows that are picked out are copied: those below alone
        for source, at in ((image[inside], inside), (image[down[below]], below)):
            if len(source):
                cv2.copyMakeBorder(source, 0, 0, 0, right, cv2.BORDER_REFLECT, dst=out[at])

    strips.run(work, *out.shape[:2])
    return out


def surround(planes: np.ndarray, target: np.ndarray, reach: int, rows: slice) -> None:
    """Some rows of planes that are carried on by their outermost pixels, on every side.

    Parameters
    ----------
    planes : (..., h, w) float32
    target : (..., rows, W) float32
        Written.
    reach
        Where the planes begin: rows from the top of what they are carried on to, columns from its
        left.
    rows
        Which of its rows ``target`` is.
    """
    height, width = planes.shape[-2:]
    source = np.clip(np.arange(rows.start, rows.stop) - reach, 0, height - 1)
    end = reach + width
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

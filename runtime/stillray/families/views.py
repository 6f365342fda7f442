"""Views of a frame: as it is, and mirrored. The mean of their pictures is a better one.

A network that learned from patches in all eight symmetries makes other errors of a mirrored frame,
and a mean has less of them than each (Lim et al. 2017, section 3.4, self-ensemble).
differs: they take all eight symmetries of the square; here the four that leave rows rows, which
planes and kernels of any size allow in place, and first the half turn, which is worth most.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np


@dataclass(frozen=True)
class View:
    """How a frame is mirrored.

    Attributes
    ----------
    rows, columns
        Whether their order is turned round.
    """

    rows: bool = False
    columns: bool = False

    def seen(self, array: np.ndarray, axes: tuple[int, int] = (-2, -1)) -> np.ndarray:
        """An array seen so, its pixels along two axes: in place, with strides below 0."""
        turned = (self.rows, self.columns)
        return np.flip(
            array, tuple(axis for axis, is_so in zip(axes, turned, strict=True) if is_so)
        )

    def of(self, array: np.ndarray, axes: tuple[int, int] = (-2, -1)) -> np.ndarray:
        """The same, contiguous; of what was seen so it gives back what it was."""
        return np.ascontiguousarray(self.seen(array, axes))


#: In the order in which they are taken.
VIEWS = (View(), View(rows=True, columns=True), View(columns=True), View(rows=True))


def mean_picture(pictures: Iterable[np.ndarray]) -> np.ndarray:
    """The mean of pictures ``(h, w, 3)`` float32, in the first of them."""
    images = iter(pictures)
    mean, count = next(images), 1
    for image in images:
        cv2.add(mean, image, dst=mean)
        count += 1
    if count > 1:
        mean *= np.float32(1 / count)
    return mean

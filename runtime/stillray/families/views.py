"""Views of a frame: as it is, and mirrored. The mean of their pictures is a better one.

A network that learned from patches in all eight symmetries makes other errors of a mirrored frame,
and a mean has less of them than each (Lim et al. 2017, section 3.4, self-ensemble).
differs: they take all eight symmetries of the square; here the four that leave rows rows, which
planes and kernels of any size allow in place, and first the half turn, which is worth most.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
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

    @property
    def changes(self) -> bool:
        """Whether it is another than the frame as it is."""
        return self.rows or self.columns

    @property
    def corners(self) -> list[int]:
        """Where a pixel of a 2x2 block is: the top left, top right, bottom left, bottom right."""
        return [place ^ (2 * self.rows) ^ (1 * self.columns) for place in range(4)]

    def of_pixels(self, image: np.ndarray) -> np.ndarray:
        """An image ``(h, w, ...)`` seen so; seen so twice it is itself again."""
        if not self.changes:
            return image
        code = -1 if self.rows and self.columns else 0 if self.rows else 1  # OpenCV's
        return np.asarray(cv2.flip(image, code)).reshape(image.shape)

    def of_planes(self, planes: np.ndarray, places: Sequence[int] | None = None) -> np.ndarray:
        """Planes ``(n, h, w)`` seen so: all, or those at some places, in their order."""
        chosen = range(len(planes)) if places is None else places
        return np.stack([self.of_pixels(planes[place]) for place in chosen])


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

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

from stillray.arrays.strips import Strips


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
        return np.asarray(cv2.flip(image, self._code)).reshape(image.shape)

    def of_planes(
        self, planes: np.ndarray, places: Sequence[int], strips: Strips, out: np.ndarray
    ) -> np.ndarray:
        """Planes seen so.

        Parameters
        ----------
        planes : (n, h, w)
        places
            Of those that are wanted, in their order.
        strips
            Where the work runs.
        out : (m, h, w)
            Written and returned.
        """
        height, width = planes.shape[1:]

        def work(rows: slice) -> None:
            source = slice(height - rows.stop, height - rows.start) if self.rows else rows
            for place, target in zip(places, out, strict=True):
                if self.changes:
                    cv2.flip(planes[place, source], self._code, dst=target[rows])
                else:
                    target[rows] = planes[place, source]

        strips.run(work, height, width)
        return out

    @property
    def _code(self) -> int:
        """OpenCV's, of another than the frame as it is."""
        if self.rows and self.columns:
            return -1
        return 0 if self.rows else 1


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

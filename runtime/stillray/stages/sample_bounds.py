"""How far samples let a mean be off: what a filter makes of it stays within that.

Of a few samples nothing is known but the range that values around have: a pixel's own mean lies
somewhere between. Of many it is nearly known, and a filter that moves it further is wrong, as where
it takes a weave or a joint of tiles for noise.
"""

from __future__ import annotations

import cv2
import numpy as np

from stillray.arrays.strips import Strips, with_halo

_RANGE = 3  # pixels to each side whose values say what samples of a pixel may be
#: Standard errors that a mean may be off, the least and the most; between them their square is the
#: count of samples. Of one a filter takes fine texture for noise, of several what one error leaves
#: is seen, dots around what a lens does not show sharp.
_ERRORS = (1.0, 2.0)
_LEAST = 1e-6  # of a range, which is divided by


def bound_by_samples(
    filtered: np.ndarray, given: np.ndarray, samples: float | np.ndarray, strips: Strips
) -> None:
    """Bound what a filter has made of a mean by Wilson's score interval of that mean.

    A sample is taken for one of the two ends of the range of 7x7 pixels around, as of an edge
    between two surfaces: Wilson 1927 has the interval that the share of one end lies in, also of
    one sample. One standard error of 4 samples and fewer, two of 16 and more, and between them as
    many as keep the interval as wide as that of 4. Where all is noise of many samples, its range is
    narrower than theirs and some of it is kept.

    Parameters
    ----------
    filtered : (h, w, 3) float32
        Changed in place.
    given : (h, w, 3) float32
        What was filtered; NaN bounds nothing.
    samples
        A number, or ``(h, w)``, that ``given`` is the mean of; below 1, or NaN, counts as 1.
    strips
        Where the work runs.
    """
    height, width = given.shape[:2]
    window = np.ones((2 * _RANGE + 1,) * 2, np.uint8)
    counts = np.maximum(np.nan_to_num(np.asarray(samples, np.float32), nan=1.0), 1)
    squares = np.clip(counts, *np.square(_ERRORS)).astype(np.float32)
    if np.isnan(given.max()):
        given = np.where(np.isnan(given), filtered, given)

    def work(rows: slice) -> None:
        near, inner = with_halo(rows, _RANGE, height)
        least = cv2.erode(given[near], window)[inner]
        span = cv2.dilate(given[near], window)[inner]
        span -= least
        count, square = (
            plane[rows, :, None] if plane.ndim else plane for plane in (counts, squares)
        )
        share = (given[rows] - least) / np.maximum(span, np.float32(_LEAST))
        middle = (share + square / (2 * count)) * span
        off = np.sqrt(share * (1 - share) / count + square / (4 * count * count))
        off *= np.sqrt(square) * span
        scale = 1 / (1 + square / count)
        bounds = (least + scale * (middle - off), least + scale * (middle + off))
        np.clip(filtered[rows], *bounds, out=filtered[rows])

    strips.run(work, height, width)

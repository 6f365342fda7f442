"""From one level of a kernel pyramid to the next finer one."""

from __future__ import annotations

import cv2
import numpy as np

from stillray.kernels import bounded_exp
from stillray.models_spec.loader import PyramidKernels
from stillray.scratch import Scratch


class Doubled:
    """A level at twice its resolution: every pixel is a mean of three coarser ones.

    Its own, the one beside and the one above or below, on the pixel's side: twice the first and
    one each of the others, if their logits are 0, which is what a plane through their centres has
    there. Where a surface ends, the network leaves out what lies on the other side.

    Parameters
    ----------
    light : (3, h + 2, w + 2) float32
        With its border repeated.
    logits : (8, h, w) float32
        Of the pixels beside, then of those above or below, for the top left pixel of each block,
        the top right, the bottom left, the bottom right.
    options
        The bound of the logits.
    """

    def __init__(self, light: np.ndarray, logits: np.ndarray, options: PyramidKernels) -> None:
        self._light, self._logits, self._bound = light, logits, options.logit_bound

    def rows(self, rows: slice, out: np.ndarray, scratch: Scratch) -> None:
        """Write rows of it to ``(3, rows, 2 w)``."""
        top, bottom = rows.start // 2, -(-rows.stop // 2)
        width = self._logits.shape[2]
        beside, above, own, mixed = scratch.array("doubled", (4, bottom - top, width))
        for line, column in np.ndindex(2, 2):
            corner = 2 * line + column
            bounded_exp(self._logits[corner, top:bottom], self._bound, beside)
            bounded_exp(self._logits[4 + corner, top:bottom], self._bound, above)
            with np.errstate(invalid="ignore"):  # a NaN logit: the caller finds it in the image
                np.add(beside, above, out=own)
                own += 2
                np.reciprocal(own, out=own)
                beside *= own
                above *= own
                own *= 2
            # rows of this line: the first or the last may lie outside of what is asked for
            first, end = 2 * top + line - rows.start, 2 * bottom - 2 + line - rows.start
            inside = slice(first < 0, bottom - top - (end >= rows.stop - rows.start))
            for plane, target in zip(self._light, out, strict=True):
                middle = plane[1 + top : 1 + bottom]
                np.multiply(middle[:, 1:-1], own, out=mixed)
                side = middle[:, 2 * column : 2 * column + width]
                cv2.accumulateProduct(side, beside, mixed)
                over = plane[top + 2 * line : bottom + 2 * line, 1:-1]
                cv2.accumulateProduct(over, above, mixed)
                target[first % 2 :: 2, column::2] = mixed[inside]

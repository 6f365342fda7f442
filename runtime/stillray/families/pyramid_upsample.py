"""From one level of a kernel pyramid to the next finer one."""

from __future__ import annotations

import cv2
import numpy as np

from stillray.arrays.workspace import Workspace
from stillray.families.logit_maps import LogitMaps


class Doubled:
    """A level at twice its resolution: every pixel is a mean of three coarser ones.

    Its own, the one beside and the one above or below, on the pixel's side: twice the first and
    one each of the others, if their logits are 0, which is what a plane through their centres has
    there. Where a surface ends, the network leaves out what lies on the other side.

    Parameters
    ----------
    light : (3, h + 2, w + 2) float32
        With its border repeated.
    logits
        Of the level.
    places
        Of eight among them: of the pixels beside, then of those above or below, for the top left
        pixel of each block, the top right, the bottom left, the bottom right.
    """

    def __init__(self, light: np.ndarray, logits: LogitMaps, places: slice) -> None:
        self._light, self._logits, self._places = light, logits, places

    def rows(self, rows: slice, workspace: Workspace) -> np.ndarray:
        """Rows of it, ``(3, rows, 2 w)``, which lie in the workspace."""
        top, bottom = rows.start // 2, -(-rows.stop // 2)
        high, width = bottom - top, self._logits.shape[2]
        eight = workspace.array("beside and above", (8, high, width))
        weights = self._logits.weights(self._places, slice(top, bottom), eight)
        weights = weights.reshape(2, 4, high, width)
        own = workspace.array("own", (4, high, width))
        np.add(weights[0], weights[1], out=own)
        mixed = workspace.array("mixed", (3, 2, high, width))
        doubled = workspace.array("doubled", (3, 2 * high, 2 * width))
        middle = self._light[:, 1 + top : 1 + bottom]
        with np.errstate(invalid="ignore"):  # a NaN logit: the caller finds it in the image
            own += 2
            np.reciprocal(own, out=own)
            weights *= own
            own *= 2
            for line in range(2):
                corners = slice(2 * line, 2 * line + 2)
                beside, above = weights[:, corners]
                np.multiply(middle[:, None, :, 1:-1], own[corners], out=mixed)
                over = self._light[:, top + 2 * line : bottom + 2 * line, 1:-1]
                for channel, column in np.ndindex(3, 2):
                    side = middle[channel, :, 2 * column : 2 * column + width]
                    cv2.accumulateProduct(side, beside[column], mixed[channel, column])
                    cv2.accumulateProduct(over[channel], above[column], mixed[channel, column])
                for column in range(2):
                    doubled[:, line::2, column::2] = mixed[:, column]
        return doubled[:, rows.start - 2 * top : rows.stop - 2 * top]

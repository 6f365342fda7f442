"""What looking between pixels washes out of the previous output, put back."""

from __future__ import annotations

import cv2
import numpy as np

from stillray.arrays.bounds import at_least, at_most
from stillray.arrays.strips import Strips, pixels_of
from stillray.arrays.workspace import Workspace
from stillray.stages import features as encode

#: Share of the four taps that lie in the frame above which only rounding is missing.
WHOLE = np.float32(1 - 1e-3)
_FOUR = np.ones((2, 2), np.uint8)
_COLUMNS = 1024  # OpenCV looks up fewer than 32768 places in a row
# No division by 0; and the most that cubic convolution, limited to the four pixels around, can be
# above their mean: one of them may have all the light and, 1/64 pixel off, 1/4096 of the weight.
_DARK, _MOST = np.float32(1e-30), np.float32(4096)


class Sharpening:
    """An output's luminance, and the range of each 2x2 pixels from the top left one.

    Lies in the calling thread's workspace arrays until the next one is made.

    Parameters
    ----------
    output : (h, w, 4) float32
        Radiance, and something else.
    strips
        Where the work runs.
    """

    def __init__(self, output: np.ndarray, strips: Strips) -> None:
        height, width = output.shape[:2]
        self._strips, workspace = strips, strips.workspace
        self._values, self._least, self._most = (
            workspace.array(f"luminance, {name}", (height, width))
            for name in ("values", "least", "most")
        )

        def work(rows: slice) -> None:
            below = slice(rows.start, min(rows.stop + 1, height))
            shape = output[below].shape[:2]
            values = encode.luminance(output[below], out=strips.workspace.array("values", shape))
            count = rows.stop - rows.start
            self._values[rows] = values[:count]
            for limit, extremes in ((cv2.erode, self._least), (cv2.dilate, self._most)):
                extremes[rows] = limit(values, _FOUR, anchor=(0, 0))[:count]

        strips.run(work, height, width)

    def factor(
        self,
        positions: np.ndarray,
        taken: np.ndarray,
        valid: np.ndarray | None,
        workspace: Workspace,
    ) -> np.ndarray:
        """What makes linear interpolation as sharp as cubic convolution: a factor, ``(h, w)``.

        Parameters
        ----------
        positions : (h, w, 2) float32
        taken : (h, w, 4) float32
            Bilinear there.
        valid : (h, w) float32 or None
            How much of the four taps lay in the frame; 1 is given where not all of them did. None
            for all everywhere.
        workspace
            Where the result lies.
        """
        linear = encode.luminance(taken, out=workspace.array("linear", taken.shape[:2]))
        sharp = self._relative(positions, linear, workspace)
        if valid is not None and valid.min() < WHOLE:
            sharp[valid < WHOLE] = 1
        return sharp

    def _relative(
        self, positions: np.ndarray, linear: np.ndarray, workspace: Workspace
    ) -> np.ndarray:
        """Luminance by cubic convolution over that by linear interpolation, which is written to."""
        border, shape = cv2.BORDER_REPLICATE, linear.shape
        sharp, limit = (workspace.array(name, shape) for name in ("sharp", "limit"))
        cv2.remap(self._values, positions, None, cv2.INTER_CUBIC, sharp, border)
        corner = np.floor(positions, out=workspace.array("corner", positions.shape))
        for limited, extremes in ((cv2.max, self._least), (cv2.min, self._most)):
            cv2.remap(extremes, corner, None, cv2.INTER_NEAREST, limit, border)
            limited(sharp, limit, dst=sharp)
        at_least(linear, _DARK, out=linear)
        at_least(sharp, _DARK, out=sharp)
        with np.errstate(over="ignore"):
            np.divide(sharp, linear, out=sharp)
        return at_most(sharp, _MOST, out=sharp)

    def contrasts(self, ratio: float) -> np.ndarray:
        """Where the brightest of the four pixels from a pixel on is so many times the darkest.

        Parameters
        ----------
        ratio
            1 or more.

        Returns
        -------
        (h, w) uint8
            Not 0 there; in this thread's workspace.
        """
        found = self._strips.workspace.array("contrasts", self._values.shape, np.uint8)

        def work(rows: slice) -> None:
            least = self._strips.workspace.array("scaled", self._least[rows].shape)
            with np.errstate(over="ignore"):  # nothing is brighter than infinity
                np.multiply(self._least[rows], np.float32(ratio), out=least)
            np.greater(self._most[rows], least, out=found[rows].view(bool))

        self._strips.run(work, *found.shape)
        return found

    def sharpen(
        self,
        taken: np.ndarray,
        positions: np.ndarray,
        contrasts: np.ndarray,
        workspace: Workspace,
    ) -> None:
        """Make a look at something else, whose light is noisy, as sharp as one at the output.

        The last output knows where a window ends and a bar begins; light of one sample does not,
        and what is taken from its own differences brightens noise.

        Parameters
        ----------
        taken : (h, w, 4) float32
            Looked up bilinearly; the first three channels are changed.
        positions : (h, w, 2) float32
            Where. Those beside the frame are not looked at.
        contrasts : (h, w) uint8
            From `contrasts`: where it is done.
        workspace
            For what lies between.
        """
        corner = np.floor(positions, out=workspace.array("corner", positions.shape))
        border = cv2.BORDER_CONSTANT
        at = np.flatnonzero(cv2.remap(contrasts, corner, None, cv2.INTER_NEAREST, None, border, 0))
        if not at.size:
            return
        # a list of places as a rectangle of them, the first ones once more at its end
        listed = np.resize(at, (-(-at.size // _COLUMNS), min(at.size, _COLUMNS)))
        there = np.take(pixels_of(positions), listed).view(np.float32).reshape(*listed.shape, 2)
        linear = cv2.remap(self._values, there, None, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
        factor = self._relative(there, linear, workspace)
        pixels = taken.reshape(-1, 4)
        pixels[at, :3] *= factor.reshape(-1)[: at.size, None]


def scale(taken: np.ndarray, factor: np.ndarray, workspace: Workspace) -> None:
    """Multiply the first three channels of ``(h, w, 4)`` by a factor ``(h, w)``."""
    # alpha of float images is 1: the fourth channel stays as it is
    factors = cv2.cvtColor(factor, cv2.COLOR_GRAY2RGBA, dst=workspace.array("four", taken.shape))
    cv2.multiply(taken, factors, dst=taken)

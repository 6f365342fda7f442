"""The previous output, brought to the current pixels."""

from __future__ import annotations

import cv2
import numpy as np

from stillray.prepare import History, Prepared
from stillray.reproject import positions_of
from stillray.scratch import Scratch
from stillray.strips import Strips
from stillray.timing import timed

# Shares of the four taps that lie in the frame: below the first, light fades instead of being
# normalised; above the second, only rounding is missing.
_AROUND = np.ones((3, 3), np.uint8)
_LEAST_VALID, _WHOLE = np.float32(1e-3), np.float32(1 - 1e-3)


def recalled(
    history: History | None,
    prepared: Prepared,
    strips: Strips,
    timings: dict[str, float],
    kept: Scratch | None = None,
) -> np.ndarray | None:
    """The previous output at a prepared frame's pixels, or None where there is no past.

    It lies in ``kept`` if that is given, or in the history where nothing moves.
    """
    if history is None or history.output is None or prepared.motion is None:
        return None
    if history.output.shape[:2] != prepared.motion.shape[:2]:
        return None
    with timed(timings, "recall"):
        out = None if kept is None else kept.array("recalled", history.output.shape)
        past = recall(history.output, prepared.motion, strips, out)
        return forget_uncovered(past, history.output, prepared)


def forget_uncovered(past: np.ndarray, output: np.ndarray, prepared: Prepared) -> np.ndarray:
    """The recalled output without what the frame has just uncovered: zeros there.

    Where no tap of the history was accepted, nor around, the surface was not seen before, and what
    the last output shows there is another one. Thin lines of such pixels are edges of surfaces,
    which the samples of a frame meet on either side: they keep their past.

    Parameters
    ----------
    past : (h, w, 4) float32
        What `recall` gave; written and returned, but where it is ``output`` itself a copy is.
    output : (h, w, 4) float32
        The last output, which belongs to the history; not changed.
    prepared
        The frame, with its ``sample``; without that nothing is forgotten.
    """
    if prepared.sample is None:
        return past
    # what holds this frame's sample alone had no past
    lost = prepared.history.mean[..., 3] <= prepared.sample[..., 3]
    uncovered = cv2.morphologyEx(lost.view(np.uint8), cv2.MORPH_OPEN, _AROUND).view(bool)
    if not uncovered.any():
        return past
    if past is output:
        past = past.copy()
    past[uncovered] = 0
    return past


def remember(image: np.ndarray, spare: History | None = None) -> np.ndarray:
    """An output as the next frame wants it: ``(h, w, 4)``, a copy, with 1 for "valid" last.

    It lies in the arrays of a history that nobody needs any more, if one is given.
    """
    out = None if spare is None else spare.output
    if out is not None and out.shape[:2] != image.shape[:2]:
        out = None
    return cv2.cvtColor(image, cv2.COLOR_RGB2RGBA, dst=out)  # alpha of float images is 1


def recall(
    output: np.ndarray, motion: np.ndarray, strips: Strips, out: np.ndarray | None = None
) -> np.ndarray:
    """Follow the motion back into the previous output.

    No geometry is compared here: the edges of an output are smooth, as those of a photograph are,
    and the network decides by what it sees how much of the past a pixel keeps.

    Parameters
    ----------
    output : (h, w, 4) float32
        See `remember`.
    motion : (h, w, 2) float32
        Pixels, finite.
    strips
        Where the work runs.
    out : (h, w, 4) float32, optional
        Written and returned where something moves.

    Returns
    -------
    (h, w, 4) float32
        Radiance, bilinear, and how much of it lay in the frame, [0, 1]; zeros outside.
    """
    if not motion.any():
        return output
    height, width = motion.shape[:2]
    past = np.empty((height, width, 4), np.float32) if out is None else out

    def work(rows: slice) -> None:
        scratch, taken = strips.scratch, past[rows]
        positions = scratch.array("positions", motion[rows].shape)
        # exact at four channels; for some other counts OpenCV rounds positions to 1/32 pixel
        cv2.remap(
            output,
            positions_of(motion[rows], rows, positions),
            None,
            cv2.INTER_LINEAR,
            dst=taken,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=0,
        )
        # at the border of the frame: the mean of the taps that there are
        valid = cv2.extractChannel(taken, 3, dst=scratch.array("valid", taken.shape[:2]))
        if valid.min() < _WHOLE:
            down, right = np.nonzero((valid > 0) & (valid < _WHOLE))
            share = np.maximum(valid[down, right], _LEAST_VALID)
            taken[down, right, :3] /= share[:, None]

    strips.run(work, height, width)
    return past

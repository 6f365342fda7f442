"""Albedo that is accumulated over frames: textures and silhouettes as supersampling shows them.

At one sample a pixel, a frame's albedo is of one point in each pixel: filtered light that is
multiplied by it has stairs where surfaces meet, and textures crawl. Every frame samples another
point, so the mean of a few is the pixel's. No noise of light is in it, and no geometry need agree:
where surfaces meet, the mean of theirs is what is wanted. What no longer belongs there is limited
to the range of the 3x3 pixels around, as temporal antialiasing does it (Karis 2014, *High Quality
Temporal Supersampling*).

Where an albedo says nothing (sky, lights, mirrors), light was divided by 1, which is no albedo to
be averaged with one. Beside such pixels a picture is multiplied by no more than it was divided by:
dark leaves before a sky would have bright rims.
"""

from __future__ import annotations

import cv2
import numpy as np

from stillray.arrays.strips import Strips, with_halo
from stillray.stages.reproject import bilinear

_AROUND = np.ones((3, 3), np.uint8)
_SUM = np.ones((1, 3), np.float32)
_STRIP_PIXELS = 1 << 16  # four channels in several arrays: they should stay in the cache
_WHOLE = np.float32(1 - 1e-3)  # share of the taps that lay in the frame: all, up to rounding


def begin(divisor: np.ndarray, remembered: np.ndarray) -> None:
    """What a first frame leaves to the next.

    Parameters
    ----------
    divisor : (h, w, 3) float32
        Of this frame, or a mean.
    remembered : (h, w, 4) float32
        Written: the divisor and, last, 1.
    """
    cv2.cvtColor(divisor, cv2.COLOR_RGB2RGBA, dst=remembered)  # alpha of float images is 1


def accumulate(
    divisor: np.ndarray,
    past: np.ndarray,
    samples: float,
    positions: np.ndarray | None,
    remembered: np.ndarray,
    modulator: np.ndarray,
    strips: Strips,
) -> None:
    """Take a frame's divisor into the mean.

    Parameters
    ----------
    divisor : (h, w, 3) float32
        Of this frame, see `stillray.stages.demodulate.divisor`.
    past : (h, w, 4) float32
        What the last frame has left.
    samples
        What the past is worth, where this frame is worth 1.
    positions : (h, w, 2) float32 or None
        See `stillray.stages.prepare.Prepared`. What was outside of the last frame is this
        frame's alone.
    remembered : (h, w, 4) float32
        Written: the mean and, last, 1.
    modulator : (h, w, 3) float32
        Written: the mean, in the range of the divisor's 3x3 pixels around; where some of those have
        no albedo and some have, the divisor at most.
    strips
        Where the work runs.
    """
    height, width = divisor.shape[:2]
    share = samples / (samples + 1)

    def work(rows: slice) -> None:
        scratch, mean = strips.scratch, modulator[rows]
        around, inner = with_halo(rows, 1, height)
        shape = (around.stop - around.start, width, 3)
        least, most = (scratch.array(name, shape) for name in ("least", "most"))
        cv2.erode(divisor[around], _AROUND, dst=least)
        cv2.dilate(divisor[around], _AROUND, dst=most)
        now = divisor[rows]
        taken = past[rows]
        if positions is not None:
            taken = scratch.array("taken", (*mean.shape[:2], 4))
            bilinear(past, positions[rows], taken)
        cv2.cvtColor(taken, cv2.COLOR_RGBA2RGB, dst=mean)
        if positions is not None:
            inside = cv2.extractChannel(taken, 3, dst=scratch.array("inside", mean.shape[:2]))
            if inside.min() < _WHOLE:
                outside = np.flatnonzero(inside < _WHOLE)
                mean.reshape(-1, 3)[outside] = np.take(now.reshape(-1, 3), outside, axis=0)
        cv2.max(mean, least[inner], dst=mean)
        cv2.min(mean, most[inner], dst=mean)
        cv2.addWeighted(mean, share, now, 1 - share, 0, dst=mean)
        begin(mean, remembered[rows])
        total = cv2.transform(divisor[around], _SUM, dst=scratch.array("total", shape[:2]))
        if total.max() < 3:
            return
        none = (total >= 3).view(np.uint8)
        beside = (cv2.dilate(none, _AROUND) != cv2.erode(none, _AROUND))[inner]
        at = np.flatnonzero(beside)
        own, mixed = now.reshape(-1, 3), mean.reshape(-1, 3)
        mixed[at] = np.minimum(np.take(mixed, at, axis=0), np.take(own, at, axis=0))

    strips.run(work, height, width, pixels=_STRIP_PIXELS)

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

from stillray.models_spec.loader import Temporal
from stillray.reproject import positions_of
from stillray.strips import Strips, with_halo

_AROUND = np.ones((3, 3), np.uint8)
_ONES, _ABOVE = (1.0, 1.0, 1.0), (2.0, 2.0, 2.0)


def begin(divisor: np.ndarray, remembered: np.ndarray) -> None:
    """What a first frame leaves to the next.

    Parameters
    ----------
    divisor : (h, w, 3) float32
        Of this frame.
    remembered : (h, w, 4) float32
        Written: the divisor and, last, the samples that it holds: 1.
    """
    cv2.cvtColor(divisor, cv2.COLOR_RGB2RGBA, dst=remembered)  # alpha of float images is 1


def accumulate(
    divisor: np.ndarray,
    past: np.ndarray,
    motion: np.ndarray,
    options: Temporal,
    remembered: np.ndarray,
    modulator: np.ndarray,
    strips: Strips,
) -> None:
    """Take a frame's divisor into the mean.

    Parameters
    ----------
    divisor : (h, w, 3) float32
        Of this frame, see `stillray.demodulate.divisor`.
    past : (h, w, 4) float32
        What the last frame has left.
    motion : (h, w, 2) float32
        Pixels, see `stillray.silhouettes.motion_of_edges`.
    options
        How many samples the past is worth at most.
    remembered : (h, w, 4) float32
        Written: the mean and, last, the samples that it holds.
    modulator : (h, w, 3) float32
        Written: the mean, in the range of the divisor's 3x3 pixels around; where some of those have
        no albedo and some have, the divisor at most.
    strips
        Where the work runs.
    """
    height, width = divisor.shape[:2]
    moves = bool(motion.any())

    def work(rows: slice) -> None:
        scratch, mean = strips.scratch, remembered[rows]
        around, inner = with_halo(rows, 1, height)
        shape = (around.stop - around.start, width, 4)
        now, least, most = (scratch.array(name, shape) for name in ("now", "least", "most"))
        cv2.cvtColor(divisor[around], cv2.COLOR_RGB2RGBA, dst=now)
        cv2.erode(now, _AROUND, dst=least)
        cv2.dilate(now, _AROUND, dst=most)
        now = now[inner]
        if moves:
            positions = scratch.array("positions", motion[rows].shape)
            positions_of(motion[rows], rows, positions)
            cv2.remap(past, positions, None, cv2.INTER_LINEAR, mean, cv2.BORDER_REPLICATE)
        else:
            np.copyto(mean, past[rows])
        held = cv2.extractChannel(mean, 3, dst=scratch.array("held", mean.shape[:2]))
        np.clip(held, 0, options.albedo_samples, out=held)
        if moves:
            seen = cv2.inRange(positions, (0, 0), (width - 1, height - 1))
            if cv2.countNonZero(seen) < seen.size:
                held[seen == 0] = 0
        cv2.max(mean, least[inner], dst=mean)
        cv2.min(mean, most[inner], dst=mean)
        share = held / (held + 1)
        mean -= now
        mean *= cv2.cvtColor(share, cv2.COLOR_GRAY2RGBA, dst=scratch.array("share", mean.shape))
        mean += now
        held += 1
        cv2.insertChannel(held, mean, 3)
        cv2.cvtColor(mean, cv2.COLOR_RGBA2RGB, dst=modulator[rows])
        none = cv2.inRange(divisor[around], _ONES, _ABOVE)
        if 0 < cv2.countNonZero(none) < none.size:
            beside = (cv2.dilate(none, _AROUND) != cv2.erode(none, _AROUND))[inner]
            own = divisor[rows][beside]
            modulator[rows][beside] = np.minimum(modulator[rows][beside], own)

    strips.run(work, height, width)

"""Albedo that is accumulated over frames: textures and silhouettes as supersampling shows them.

At one sample a pixel, a frame's albedo is of one point in each pixel: filtered light that is
multiplied by it has stairs where surfaces meet, and textures crawl. Every frame samples another
point, so the mean of a few is the pixel's. No noise of light is in it, and no geometry need agree:
where surfaces meet, the mean of theirs is what is wanted. What no longer belongs there is limited
to the range of the 3x3 pixels around, of their tints and of their channels, as temporal
antialiasing does it (Karis 2014, *High Quality Temporal Supersampling*): by channels alone, what a
red thing has uncovered would be as red as dark and light grey allow.

Where an albedo says nothing (sky, lights, mirrors), light was divided by 1, which is no albedo to
be averaged with one. Beside such pixels a picture is multiplied by no more than it was divided by:
dark leaves before a sky would have bright rims.
"""

from __future__ import annotations

import cv2
import numpy as np

from stillray.arrays.strips import Strips, with_halo
from stillray.arrays.workspace import Workspace
from stillray.stages.reproject import bilinear

_AROUND = np.ones((3, 3), np.uint8)
_SUM = np.ones((1, 3), np.float32)
#: Orange and green of red, green and blue (YCoCg), and what each adds to those. The third is none:
#: OpenCV is ten times as quick from three channels to three as to two.
TINTS = np.array([[0.5, 0, -0.5], [-0.25, 0.5, -0.25], [0, 0, 0]], np.float32)
FROM_TINTS = np.array([[1, -1, 0], [0, 1, 0], [-1, -1, 0]], np.float32)
_STRIP_PIXELS = 1 << 16  # four channels in several arrays: they should stay in the cache
_WHOLE = np.float32(1 - 1e-3)  # share of the taps that lay in the frame: all, up to rounding


def begin(albedo: np.ndarray, next_albedo: np.ndarray) -> None:
    """What a first frame leaves to the next.

    Parameters
    ----------
    albedo : (h, w, 3) float32
        Of this frame, or a mean.
    next_albedo : (h, w, 4) float32
        Written: the albedo and, last, 1.
    """
    cv2.cvtColor(albedo, cv2.COLOR_RGB2RGBA, dst=next_albedo)  # alpha of float images is 1


def accumulate(
    albedo: np.ndarray,
    past: np.ndarray,
    samples: float,
    positions: np.ndarray | None,
    out: tuple[np.ndarray, np.ndarray],
    strips: Strips,
) -> None:
    """Take a frame's albedo into the mean.

    Parameters
    ----------
    albedo : (h, w, 3) float32
        Of this frame, see `stillray.stages.demodulate.demodulation_albedo`.
    past : (h, w, 4) float32
        What the last frame has left.
    samples
        Frames that the past counts as, beside this one.
    positions : (h, w, 2) float32 or None
        See `stillray.stages.prepare.Prepared`. What was outside of the last frame is this
        frame's alone.
    out : (h, w, 4) float32 and (h, w, 3) float32
        Written: for the next frame the mean and, last, 1; and what the result is multiplied by: the
        mean, in the range of the albedo's 3x3 pixels around, and of their tints; where some of
        those have no albedo and some have, the albedo at most.
    strips
        Where the work runs.
    """
    (height, width), (next_albedo, remodulation_albedo) = albedo.shape[:2], out
    share = samples / (samples + 1)

    def work(rows: slice) -> None:
        workspace, mean = strips.workspace, remodulation_albedo[rows]
        around, inner = with_halo(rows, 1, height)
        shape = (around.stop - around.start, width, 3)
        now = albedo[rows]
        taken = past[rows]
        if positions is not None:
            taken = workspace.array("taken", (*mean.shape[:2], 4))
            bilinear(past, positions[rows], taken)
        cv2.cvtColor(taken, cv2.COLOR_RGBA2RGB, dst=mean)
        if positions is not None:
            inside = cv2.extractChannel(taken, 3, dst=workspace.array("inside", mean.shape[:2]))
            if inside.min() < _WHOLE:
                outside = np.flatnonzero(inside < _WHOLE)
                mean.reshape(-1, 3)[outside] = np.take(now.reshape(-1, 3), outside, axis=0)
        _limit_tints(mean, albedo[around], inner, workspace)
        _limit(mean, albedo[around], inner, mean, workspace)
        cv2.addWeighted(mean, share, now, 1 - share, 0, dst=mean)
        begin(mean, next_albedo[rows])
        total = cv2.transform(albedo[around], _SUM, dst=workspace.array("total", shape[:2]))
        if total.max() < 3:
            return
        none = (total >= 3).view(np.uint8)
        beside = (cv2.dilate(none, _AROUND) != cv2.erode(none, _AROUND))[inner]
        at = np.flatnonzero(beside)
        own, mixed = now.reshape(-1, 3), mean.reshape(-1, 3)
        mixed[at] = np.minimum(np.take(mixed, at, axis=0), np.take(own, at, axis=0))

    strips.run(work, height, width, pixels=_STRIP_PIXELS)


def _limit(
    image: np.ndarray, around: np.ndarray, inner: slice, out: np.ndarray, workspace: Workspace
) -> None:
    """Bring some rows into the range of the 3x3 pixels around, channel by channel, into ``out``."""
    least, most = (workspace.array(name, around.shape) for name in ("least", "most"))
    cv2.erode(around, _AROUND, dst=least)
    cv2.dilate(around, _AROUND, dst=most)
    cv2.max(image, least[inner], dst=out)
    cv2.min(out, most[inner], dst=out)


def _limit_tints(mean: np.ndarray, around: np.ndarray, inner: slice, workspace: Workspace) -> None:
    """Bring tints of some rows into the range of those of the 3x3 pixels around."""
    tints = cv2.transform(around, TINTS, dst=workspace.array("tints", around.shape))
    own = cv2.transform(mean, TINTS, dst=workspace.array("own tints", mean.shape))
    limited = workspace.array("limited tints", mean.shape)
    _limit(own, tints, inner, limited, workspace)
    # 0 where they are within it: an albedo that stays is what it was
    cv2.subtract(limited, own, dst=limited)
    added = cv2.transform(limited, FROM_TINTS, dst=workspace.array("added", mean.shape))
    cv2.add(mean, added, dst=mean)

"""The previous output, brought to the current pixels."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from stillray.arrays.strips import Strips, pixels_of, with_halo
from stillray.arrays.workspace import Workspace
from stillray.stages.reproject import bilinear
from stillray.stages.sharpening import WHOLE, Sharpening, scale
from stillray.stages.state import History, Prepared

_AROUND = np.ones((3, 3), np.uint8)
#: Share of the four taps that lie in the frame below which light fades instead of being normalised.
_LEAST_VALID = np.float32(1e-3)
# Of what is lost in confidence: a network may give a past that is hardly valid most of the weight.
_STEEP = np.float32(2)


def resampled(
    history: History,
    prepared: Prepared,
    strips: Strips,
    workspace: Workspace | None = None,
    *,
    sharp: bool,
) -> np.ndarray | None:
    """The previous output at a prepared frame's pixels, or None where there is none.

    It lies in the workspace if that is given, or in the history where nothing moves; ``sharp`` as
    for `resample`.
    """
    if history.output is None:
        return None
    out = None if workspace is None else workspace.array("resampled", history.output.shape)
    past = resample(history.output, prepared.picture_positions, strips, out, sharp=sharp)
    return forget_uncovered(past, history.output, prepared, strips)


def forget_uncovered(
    past: np.ndarray, output: np.ndarray, prepared: Prepared, strips: Strips
) -> np.ndarray:
    """The resampled output without what the frame has just uncovered: zeros there.

    Where no tap of the history was accepted, nor around, the surface was not seen before, and what
    the last output shows there is another one. Thin lines of such pixels are edges of surfaces,
    which the samples of a frame meet on either side: they keep their past. Where the past is not
    trusted for its light, its picture is not either: less of it is valid.

    Parameters
    ----------
    past : (h, w, 4) float32
        What `resample` gave; written and returned, but where it is ``output`` itself a copy is.
    output : (h, w, 4) float32
        The last output, which belongs to the history; not changed.
    prepared
        The frame; what is ``disoccluded`` in it had no past.
    strips
        Where the work runs.
    """
    confidence, uncovered = prepared.history_confidence, _uncovered(prepared.disoccluded, strips)
    if uncovered is None and confidence is None:
        return past
    result = np.empty_like(past) if past is output else past

    def work(rows: slice) -> None:
        mine = result[rows]
        if past is output:
            np.copyto(mine, past[rows])
        if confidence is not None:
            lost = np.flatnonzero(confidence[rows] < 1)
            valid = np.maximum(_STEEP * np.take(confidence[rows], lost) + (1 - _STEEP), 0)
            mine.reshape(-1, 4)[lost, 3] *= valid
            pixels_of(mine)[lost[valid == 0]] = 0
        if uncovered is not None:
            # of booleans, which are found ten times as fast as bytes
            pixels_of(mine)[np.flatnonzero(uncovered[rows] != 0)] = 0

    strips.run(work, *past.shape[:2])
    return result


def _uncovered(disoccluded: np.ndarray | None, strips: Strips) -> np.ndarray | None:
    """What is disoccluded but for thin lines, ``(h, w)`` uint8; None where nothing is."""
    if disoccluded is None:
        return None
    height, opened = len(disoccluded), np.empty_like(disoccluded)

    def work(rows: slice) -> bool:
        near, own = with_halo(rows, 2, height)  # one for each half of an opening
        opened[rows] = cv2.morphologyEx(disoccluded[near], cv2.MORPH_OPEN, _AROUND)[own]
        return bool(opened[rows].any())

    return opened if any(strips.run(work, *opened.shape)) else None


def keep(image: np.ndarray, strips: Strips, back_buffer: History | None = None) -> np.ndarray:
    """An output as the next frame wants it: ``(h, w, 4)``, a copy, with 1 for "valid" last.

    It lies in the arrays of a history that nobody needs any more, if one is given.
    """
    height, width = image.shape[:2]
    out = None if back_buffer is None else back_buffer.output
    if out is None or out.shape[:2] != image.shape[:2]:
        out = np.empty((height, width, 4), np.float32)
    kept = out

    def work(rows: slice) -> None:
        # alpha of float images is 1
        cv2.cvtColor(image[rows], cv2.COLOR_RGB2RGBA, dst=kept[rows])

    strips.run(work, height, width)
    return out


def resample(
    output: np.ndarray,
    positions: np.ndarray | None,
    strips: Strips,
    out: np.ndarray | None = None,
    *,
    sharp: bool = False,
) -> np.ndarray:
    """Look the previous output up where the pixels' picture was.

    No geometry is compared here: the edges of an output are smooth, as those of a photograph are,
    and the network decides by what it sees how much of the past a pixel keeps.

    Parameters
    ----------
    output : (h, w, 4) float32
        See `keep`.
    positions : (h, w, 2) float32 or None
        x and y, pixels, finite, see `stillray.stages.prepare.Prepared`; None where nothing moves.
    strips
        Where the work runs.
    out : (h, w, 4) float32, optional
        Written and returned where something moves.
    sharp
        Give each color the luminance that cubic convolution has there (Keys 1981, with the factor
        -0.75 that OpenCV takes), limited to the range of the four pixels around: a mean of four,
        frame after frame, would wash out every edge of a moving picture. Cubic convolution rounds
        positions to 1/32 pixel. Where one of the four is outside, bilinear.

    Returns
    -------
    (h, w, 4) float32
        Radiance, and how much of it lay in the frame, [0, 1]; zeros outside.
    """
    if positions is None:
        return output
    past = np.empty((*positions.shape[:2], 4), np.float32) if out is None else out
    light = Sharpening(output, strips) if sharp else None

    def work(rows: slice) -> None:
        taken, workspace = past[rows], strips.workspace
        valid = _mean_of_taps(output, positions[rows], taken, workspace)
        if light is not None:
            factor = light.factor(positions[rows], taken, valid, workspace)
            scale(taken, factor, workspace)

    strips.run(work, *positions.shape[:2])
    return past


def layer_resampler(
    output: np.ndarray, positions: np.ndarray | None, strips: Strips, *, sharp: bool
) -> Callable[[np.ndarray], np.ndarray]:
    """How the previous outputs of layers are brought to the current pixels.

    Layers add up to the beauty only if they are sharpened as the beauty is, whatever they hold.

    Parameters
    ----------
    output, positions, strips, sharp
        As for `resample`, of the beauty.

    Returns
    -------
    Callable
        From a layer's previous output, see `keep`, to what `resample` gives.
    """
    if positions is None or not sharp:
        return lambda layer: resample(layer, positions, strips)
    height, width = positions.shape[:2]
    light, factor = Sharpening(output, strips), np.empty((height, width), np.float32)

    def sharpening(rows: slice) -> None:
        workspace = strips.workspace
        taken = workspace.array("taken", (*factor[rows].shape, 4))
        valid = _mean_of_taps(output, positions[rows], taken, workspace)
        factor[rows] = light.factor(positions[rows], taken, valid, workspace)

    strips.run(sharpening, height, width)

    def follow(layer: np.ndarray) -> np.ndarray:
        past = resample(layer, positions, strips)
        scale(past, factor, strips.workspace)
        return past

    return follow


def _mean_of_taps(
    output: np.ndarray, positions: np.ndarray, taken: np.ndarray, workspace: Workspace
) -> np.ndarray:
    """Fill means of the taps that there are; the result says how much of them lay in the frame."""
    bilinear(output, positions, taken)
    valid = cv2.extractChannel(taken, 3, dst=workspace.array("valid", taken.shape[:2]))
    if valid.min() < WHOLE:
        at = np.flatnonzero(valid < WHOLE)
        share = np.maximum(np.take(valid, at), _LEAST_VALID)  # nothing is 0, whatever divides it
        taken.reshape(-1, 4)[at, :3] /= share[:, None]
    return valid

"""The previous output, brought to the current pixels."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from stillray.arrays.bounds import at_least, at_most
from stillray.arrays.strips import Strips, pixels_of, with_halo
from stillray.arrays.workspace import Workspace
from stillray.stages import features as encode
from stillray.stages.reproject import bilinear
from stillray.stages.state import History, Prepared

_AROUND, _FOUR = np.ones((3, 3), np.uint8), np.ones((2, 2), np.uint8)
# Shares of the four taps that lie in the frame: below the first, light fades instead of being
# normalised; above the second, only rounding is missing.
_LEAST_VALID, _WHOLE = np.float32(1e-3), np.float32(1 - 1e-3)
# No division by 0; and the most that cubic convolution, limited to the four pixels around, can be
# above their mean: one of them may have all the light and, 1/64 pixel off, 1/4096 of the weight.
_DARK, _MOST = np.float32(1e-30), np.float32(4096)
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
    light = _Luminance(output, strips) if sharp else None

    def work(rows: slice) -> None:
        taken, workspace = past[rows], strips.workspace
        valid = _mean_of_taps(output, positions[rows], taken, workspace)
        if light is not None:
            factor = light.sharpening(positions[rows], taken, valid, workspace)
            _scale(taken, factor, workspace)

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
    light, factor = _Luminance(output, strips), np.empty((height, width), np.float32)

    def sharpening(rows: slice) -> None:
        workspace = strips.workspace
        taken = workspace.array("taken", (*factor[rows].shape, 4))
        valid = _mean_of_taps(output, positions[rows], taken, workspace)
        factor[rows] = light.sharpening(positions[rows], taken, valid, workspace)

    strips.run(sharpening, height, width)

    def follow(layer: np.ndarray) -> np.ndarray:
        past = resample(layer, positions, strips)
        _scale(past, factor, strips.workspace)
        return past

    return follow


class _Luminance:
    """An output's luminance, and the range of each 2x2 pixels from the top left one.

    Lies in the calling thread's workspace arrays until the next one is made.
    """

    def __init__(self, output: np.ndarray, strips: Strips) -> None:
        height, width = output.shape[:2]
        workspace = strips.workspace
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

    def sharpening(
        self, positions: np.ndarray, taken: np.ndarray, valid: np.ndarray, workspace: Workspace
    ) -> np.ndarray:
        """What makes linear interpolation as sharp as cubic convolution: a factor, ``(h, w)``.

        Parameters
        ----------
        positions : (h, w, 2) float32
        taken, valid
            What `_mean_of_taps` gave.
        workspace
            Where the result lies.
        """
        border, shape = cv2.BORDER_REPLICATE, valid.shape
        sharp, limit, linear = (
            workspace.array(name, shape) for name in ("sharp", "limit", "linear")
        )
        cv2.remap(self._values, positions, None, cv2.INTER_CUBIC, sharp, border)
        corner = np.floor(positions, out=workspace.array("corner", positions.shape))
        for limited, extremes in ((cv2.max, self._least), (cv2.min, self._most)):
            cv2.remap(extremes, corner, None, cv2.INTER_NEAREST, limit, border)
            limited(sharp, limit, dst=sharp)
        encode.luminance(taken, out=linear)
        at_least(linear, _DARK, out=linear)
        at_least(sharp, _DARK, out=sharp)
        with np.errstate(over="ignore"):
            np.divide(sharp, linear, out=sharp)
        at_most(sharp, _MOST, out=sharp)
        if valid.min() < _WHOLE:
            sharp[valid < _WHOLE] = 1
        return sharp


def _scale(taken: np.ndarray, factor: np.ndarray, workspace: Workspace) -> None:
    # alpha of float images is 1: what lay in the frame stays as it is
    factors = cv2.cvtColor(factor, cv2.COLOR_GRAY2RGBA, dst=workspace.array("four", taken.shape))
    cv2.multiply(taken, factors, dst=taken)


def _mean_of_taps(
    output: np.ndarray, positions: np.ndarray, taken: np.ndarray, workspace: Workspace
) -> np.ndarray:
    """Fill means of the taps that there are; the result says how much of them lay in the frame."""
    bilinear(output, positions, taken)
    valid = cv2.extractChannel(taken, 3, dst=workspace.array("valid", taken.shape[:2]))
    if valid.min() < _WHOLE:
        at = np.flatnonzero(valid < _WHOLE)
        share = np.maximum(np.take(valid, at), _LEAST_VALID)  # nothing is 0, whatever divides it
        taken.reshape(-1, 4)[at, :3] /= share[:, None]
    return valid

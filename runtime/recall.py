"""The previous output, brought to the current pixels."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from stillray.models_spec.loader import ModelSpec, PyramidKernels
from stillray.prepare import History, Prepared
from stillray.reproject import positions_of
from stillray.scratch import Scratch
from stillray.strips import Strips
from stillray.timing import timed

# Shares of the four taps that lie in the frame: below the first, light fades instead of being
# normalised; above the second, only rounding is missing.
_AROUND = np.ones((3, 3), np.uint8)
_LONGEST = 1 << 14  # positions in a list: OpenCV takes no image of more than 32766 rows
_LEAST_VALID, _WHOLE = np.float32(1e-3), np.float32(1 - 1e-3)


def recalled(
    history: History | None,
    prepared: Prepared,
    spec: ModelSpec,
    strips: Strips,
    timings: dict[str, float],
    kept: Scratch | None = None,
) -> np.ndarray | None:
    """The previous output at a prepared frame's pixels, or None where there is no past.

    It lies in ``kept`` if that is given, or in the history where nothing moves.
    """
    motion = prepared.picture_motion
    if history is None or history.output is None or motion is None:
        return None
    if history.output.shape[:2] != motion.shape[:2]:
        return None
    with timed(timings, "recall"):
        out = None if kept is None else kept.array("recalled", history.output.shape)
        past = recall(history.output, motion, strips, out, sharp=is_sharp(spec))
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
    output: np.ndarray,
    motion: np.ndarray,
    strips: Strips,
    out: np.ndarray | None = None,
    *,
    sharp: bool = False,
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
    sharp
        Interpolate by cubic convolution (Keys 1981), limited to the range of the four pixels
        around: a mean of four, frame after frame, would wash out every edge of a moving picture.
        Positions are rounded to 1/32 pixel. Where one of the four is outside, bilinear.

    Returns
    -------
    (h, w, 4) float32
        Radiance, and how much of it lay in the frame, [0, 1]; zeros outside.
    """
    if not motion.any():
        return output
    height, width = motion.shape[:2]
    past = np.empty((height, width, 4), np.float32) if out is None else out

    def work(rows: slice) -> None:
        scratch, taken = strips.scratch, past[rows]
        positions = scratch.array("positions", motion[rows].shape)
        positions_of(motion[rows], rows, positions)
        if not sharp:
            _bilinear(output, positions, taken)
            return
        _cubic(output, positions, taken)
        least, most = _range_around(output, positions, scratch)
        cv2.min(cv2.max(taken, least, dst=taken), most, dst=taken)
        if least[..., 3].min() < 1:
            at = np.flatnonzero(least[..., 3] < 1)
            for part in np.split(at, range(_LONGEST, at.size, _LONGEST)):
                listed = positions.reshape(-1, 2)[part][:, None]
                taken.reshape(-1, 4)[part] = _bilinear(output, listed)[:, 0]

    strips.run(work, height, width)
    return past


def recall_of_layers(
    output: np.ndarray, motion: np.ndarray, spec: ModelSpec, strips: Strips
) -> Callable[[np.ndarray], np.ndarray]:
    """How the previous outputs of layers are brought to the current pixels.

    The limits of sharp interpolation depend on the light. Layers add up to the beauty only if they
    go as far from linear to cubic interpolation as the beauty did, whatever they hold themselves.

    Parameters
    ----------
    output, motion, strips
        As for `recall`, of the beauty.
    spec
        Of the model.

    Returns
    -------
    Callable
        From a layer's previous output, see `remember`, to what `recall` gives.
    """
    if not is_sharp(spec) or not motion.any():
        return lambda layer: recall(layer, motion, strips)
    limited = recall(output, motion, strips, sharp=True)
    linear, step = _linear_and_step(output, motion, strips)
    shares = np.zeros_like(step)
    np.divide(limited - linear, step, out=shares, where=step != 0)
    np.clip(shares, 0, 1, out=shares)

    def follow(layer: np.ndarray) -> np.ndarray:
        linear, step = _linear_and_step(layer, motion, strips)
        linear += np.multiply(step, shares, out=step)
        return linear

    return follow


def is_sharp(spec: ModelSpec) -> bool:
    """Whether a model recalls its outputs by sharp interpolation."""
    return isinstance(spec.decoder, PyramidKernels) and spec.decoder.sharp_recall


def _linear_and_step(
    output: np.ndarray, motion: np.ndarray, strips: Strips
) -> tuple[np.ndarray, np.ndarray]:
    """Linear interpolation of a whole output, and the step from there to cubic interpolation."""
    linear, step = np.empty_like(output), np.empty_like(output)

    def work(rows: slice) -> None:
        positions = positions_of(motion[rows], rows)
        _bilinear(output, positions, linear[rows])
        _cubic(output, positions, step[rows])
        step[rows] -= linear[rows]

    strips.run(work, *motion.shape[:2])
    return linear, step


def _bilinear(
    output: np.ndarray, positions: np.ndarray, taken: np.ndarray | None = None
) -> np.ndarray:
    """Means of the taps that there are; the last channel says how much of them lay in the frame."""
    border = cv2.BORDER_CONSTANT
    # exact at four channels; for some other counts OpenCV rounds positions to 1/32 pixel
    taken = cv2.remap(output, positions, None, cv2.INTER_LINEAR, taken, border, 0)
    valid = cv2.extractChannel(taken, 3)
    if valid.min() < _WHOLE:
        down, right = np.nonzero((valid > 0) & (valid < _WHOLE))
        share = np.maximum(valid[down, right], _LEAST_VALID)
        taken[down, right, :3] /= share[:, None]
    return taken


def _cubic(
    output: np.ndarray, positions: np.ndarray, taken: np.ndarray | None = None
) -> np.ndarray:
    return cv2.remap(output, positions, None, cv2.INTER_CUBIC, taken, cv2.BORDER_REPLICATE)


def _range_around(
    output: np.ndarray, positions: np.ndarray, scratch: Scratch
) -> tuple[np.ndarray, np.ndarray]:
    """Least and most of the four pixels around each position; zeros lie outside of the frame."""
    shape = (*positions.shape[:2], 4)
    least, most, tap = (scratch.array(name, shape) for name in ("least", "most", "tap"))
    corner = np.floor(positions, out=scratch.array("corner", positions.shape))
    _nearest(output, corner, least)
    np.copyto(most, least)
    for axis, step in ((0, 1), (1, 1), (0, -1)):
        corner[..., axis] += step
        _nearest(output, corner, tap)
        cv2.min(least, tap, dst=least)
        cv2.max(most, tap, dst=most)
    return least, most


def _nearest(output: np.ndarray, positions: np.ndarray, taken: np.ndarray) -> None:
    cv2.remap(output, positions, None, cv2.INTER_NEAREST, taken, cv2.BORDER_CONSTANT, 0)

"""Light that has changed: where the past was brighter or darker than what is there now, let it go.

Accumulation takes noise away only while light stays as it is; a lamp that is switched off would
glow on for as many frames as are remembered. One sample does not tell noise from a change, but
blocks of them do.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.strips import STRIP_PIXELS, Strips
from stillray.stages.accumulate import DARK

_BLOCK = 16  # pixels: 256 samples
_LEAST_BLOCK = 4  # in small frames, which must hold a window
_WINDOW = 5  # blocks that must all agree that light has changed
_AROUND = np.ones((_WINDOW, _WINDOW), np.uint8)
# Stops by which the median of a window must differ: from the first on the past is worth less, from
# the second on nothing.
_FROM, _TO = 0.4, 0.8
# Samples of even light that a window's samples must be worth: where a few of them carry the light,
# their number says nothing.
_LEAST_SAMPLES = 50
_BRIGHTEST = np.float32(256)  # times what is typical: more would drown a block
_MEMORY = 8  # frames


@dataclass(frozen=True, kw_only=True, eq=False)
class Brightness:
    """Light by blocks, one for 16x16 pixels (for fewer in frames of less than 80 pixels).

    Attributes
    ----------
    mean : (rows, columns) float32
        Mean luminance of irradiance, of samples: what is accumulated knows less of bright ones.
    sure : (rows, columns) bool
        Whether the last frame's samples around are worth enough to tell.
    frames
        That it is a mean of, `_MEMORY` at most.
    """

    mean: np.ndarray
    sure: np.ndarray
    frames: int = 1


def can_tell(shape: tuple[int, int]) -> bool:
    """Whether frames of a size, in pixels, are large enough to tell changes of light."""
    return _block(*shape) is not None


def brightness(light: np.ndarray, exposure: float, strips: Strips) -> Brightness | None:
    """Light of a frame's samples, or None if the frame is too small to tell.

    Parameters
    ----------
    light : (h, w) float32
        Luminance of irradiance; what no longer fills a block, at the right and below, is left out.
    exposure
        1 / irradiance.
    strips
        Where the work runs.
    """
    block = _block(*light.shape)
    if block is None:
        return None
    height, width = (extent // block for extent in light.shape)
    mean, square = np.empty((2, height, width), np.float32)

    def work(rows: slice) -> None:
        part = light[block * rows.start : block * rows.stop, : block * width]
        bounded = strips.scratch.array("bounded", part.shape)
        with np.errstate(over="ignore"):
            np.multiply(part, np.float32(exposure), out=bounded)
        np.minimum(bounded, _BRIGHTEST, out=bounded)
        size = (width, rows.stop - rows.start)
        cv2.resize(bounded, size, dst=mean[rows], interpolation=cv2.INTER_AREA)
        np.square(bounded, out=bounded)
        cv2.resize(bounded, size, dst=square[rows], interpolation=cv2.INTER_AREA)

    strips.run(work, height, width, pixels=STRIP_PIXELS // block**2)
    window = (_WINDOW, _WINDOW)
    least = np.float32(_LEAST_SAMPLES / (block * _WINDOW) ** 2)
    first, second = cv2.blur(mean, window), cv2.blur(square, window)
    sure = (first > 0) & (first * first >= least * second)
    return Brightness(mean=mean / np.float32(exposure), sure=sure)


def _block(height: int, width: int) -> int | None:
    block = min(_BLOCK, min(height, width) // _WINDOW)
    return block if block >= _LEAST_BLOCK else None


def follow(
    now: Brightness, past: Brightness, motion: np.ndarray, exposure: float
) -> tuple[np.ndarray | None, Brightness]:
    """How much the past is still worth, by how its brightness compares with the present's.

    The ratio of both is taken block by block, so that it does not matter what the picture shows.
    Noise moves ratios both ways: where one of 5x5 blocks says that nothing changed, or that it did
    the other way, nothing has. Where all agree, their median tells how much.

    Parameters
    ----------
    now
        Of this frame's samples.
    past
        What the last call gave, or the first frame's.
    motion : (h, w, 2) float32
        Pixels, finite.
    exposure
        1 / irradiance; what is black in both has not changed.

    Returns
    -------
    worth : (h, w) float32 or None
        In [0, 1]; None where all of the past is worth what it was.
    brightness
        For the next frame.
    """
    block = _block(*motion.shape[:2])
    assert block is not None
    height, width = now.mean.shape
    moved = motion[block // 2 :: block, block // 2 :: block][:height, :width] / np.float32(block)
    row, column = np.mgrid[:height, :width].astype(np.float32)
    column += moved[..., 0]
    row += moved[..., 1]
    before = cv2.remap(past.mean, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    inside = (column > -1) & (column < width) & (row > -1) & (row < height)
    before = np.where(inside, before, now.mean)
    dark = np.float32(DARK / exposure)
    ratio = (now.mean + dark) / (before + dark)
    kept = np.ones_like(ratio)
    changed = (cv2.dilate(ratio, _AROUND) < 1) | (cv2.erode(ratio, _AROUND) > 1)
    changed &= now.sure | past.sure
    if changed.any():
        stops = np.abs(np.log2(cv2.medianBlur(ratio, _WINDOW)))
        kept[changed] = np.clip((_TO - stops[changed]) / (_TO - _FROM), 0, 1)
        # windows that stick out are smaller, and agree by chance: those beside speak for them
        edge = _WINDOW // 2
        whole = kept[edge:-edge, edge:-edge]
        kept = cv2.copyMakeBorder(whole, *(edge,) * 4, cv2.BORDER_REPLICATE)
    frames = min(past.frames + 1, _MEMORY)
    share = np.maximum(1 - kept, np.float32(1 / frames))
    light = Brightness(mean=before + (now.mean - before) * share, sure=now.sure, frames=frames)
    if kept.min() == 1:
        return None, light
    # blocks' centres lie where resizing puts them, but for the rest that fills no block
    size = (block * width, block * height)
    worth = cv2.resize(kept, size, interpolation=cv2.INTER_LINEAR)
    rest = (motion.shape[0] - size[1], motion.shape[1] - size[0])
    return cv2.copyMakeBorder(worth, 0, rest[0], 0, rest[1], cv2.BORDER_REPLICATE), light

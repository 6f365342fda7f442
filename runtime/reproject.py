"""Reprojection: where a pixel's surface was in the previous frame, and what was known of it."""

from __future__ import annotations

import cv2
import numpy as np

from stillray.models_spec.loader import Temporal
from stillray.strips import planes_of

# A 2x2 block of the previous frame is one smooth surface when its normals' components and its
# depth's logarithm span no more than this: then its four taps are accepted or refused together.
SMOOTH_NORMAL = 0.2
SMOOTH_DEPTH = 0.1
_NEAREST = np.float32(1e-30)  # unit of depth: keeps the logarithm finite
_EMPTY_DEPTH = np.float32(-100)  # "logarithm of the depth" of background: far from all surfaces
_OUTSIDE = np.float32(-8)  # pixels: a position whose four taps all lie outside
_NORMAL_SUM = np.array([[1, 1, 1, 0]], np.float32)
_NO_NORMAL = 0.25  # a normal with no component beyond this points nowhere
_LIST_WIDTH = 256  # pixels of a row when a list of pixels is laid out as an image
_TINY = np.float32(1e-12)  # share of a tap: keeps 0/0 out of pixels without a tap


def pack(normal: np.ndarray | None, depth: np.ndarray | None) -> np.ndarray:
    """Guides of a frame's rows: the geometry that tells whether two pixels show one surface.

    A feature that is missing agrees with everything.

    Parameters
    ----------
    normal : (h, w, 3) float32 or None
        0 where nothing was hit.
    depth : (h, w) float32 or None
        0 where nothing was hit. One of both must be given.

    Returns
    -------
    (h, w, 4) float32
        Normal and the logarithm of depth.
    """
    if depth is not None:
        logarithm = cv2.log(np.maximum(depth, _NEAREST))
        np.copyto(logarithm, _EMPTY_DEPTH, where=depth <= 0)
    elif normal is not None:
        logarithm = np.zeros(normal.shape[:2], np.float32)
    else:
        raise ValueError("one of normal and depth must be given")
    if normal is None:
        one, zero = np.ones_like(logarithm), np.zeros_like(logarithm)
        return cv2.merge([one, zero, zero, logarithm])
    packed = cv2.merge([normal, logarithm])
    # what has no normal gets one, so that it agrees with its like; its depth tells it apart
    none = cv2.inRange(normal, (-_NO_NORMAL,) * 3, (_NO_NORMAL,) * 3)
    if cv2.countNonZero(none):
        packed[none > 0, :3] = (1, 0, 0)
        if depth is None:
            packed[none > 0, 3] = _EMPTY_DEPTH
    return packed


def rough_blocks(packed: np.ndarray, rows: slice, out: np.ndarray) -> None:
    """Mark where the 2x2 block that begins at a pixel holds more than one smooth surface.

    Parameters
    ----------
    packed : (h, w, 4) float32
        Guides of the whole previous frame.
    rows
        The rows of the frame to mark.
    out : (h + 1, w + 1) uint8
        Element (y, x) is of the block with its top left at (y - 1, x - 1), 1 where it is rough.
        Blocks that stick out of the frame are, and have to be marked by the caller.
    """
    top = max(rows.start - 1, 0)
    block = np.ones((2, 2), np.uint8)
    # anchored at its bottom right, the block of (y, x) holds (y - 1, x - 1) .. (y, x)
    strip = packed[top : rows.stop]
    spread = cv2.dilate(strip, block, anchor=(1, 1))
    spread -= cv2.erode(strip, block, anchor=(1, 1))
    smooth = cv2.inRange(spread, (-1.0,) * 4, (*(SMOOTH_NORMAL,) * 3, SMOOTH_DEPTH))
    out[top + 1 : rows.stop, 1:-1] = smooth[1:, 1:] == 0


def reproject(
    history: np.ndarray,
    before: np.ndarray | None,
    rough: np.ndarray | None,
    now: np.ndarray | None,
    motion: np.ndarray | None,
    rows: slice,
    options: Temporal,
) -> np.ndarray:
    """Bring the history to the current pixels, bilinear taps accepted one by one.

    A tap counts when it lies in the frame and shows the same surface: its normal within
    ``normal_cosine`` of the current pixel's, and the deeper of both at most ``1 + depth_ratio``
    times as deep as the other. The weights of the accepted taps are normalised, so that one good
    tap is enough; the sample count is scaled by the accepted share, so that a pixel at a
    disocclusion does not claim more than it has (Fan et al. 2021, section 4.1; differs: per tap,
    as in Schied et al. 2017, section 4.1, and no world positions are needed).

    Most pixels look back at one smooth surface, where the four taps share their fate and one
    interpolation answers for them all; only the others are taken apart.

    Parameters
    ----------
    history : (H, w, 4) float32
        Irradiance and, last, the samples that it holds; the whole previous frame.
    before : (H, w, 4) float32 or None
        Guides of the whole previous frame, see `pack`; None where it had none.
    rough : (H + 1, w + 1) uint8 or None
        Their `rough_blocks`; not needed where nothing moves.
    now : (h, w, 4) float32 or None
        Guides of the rows to fill.
    motion : (h, w, 2) float32 or None
        Pixels, of the rows to fill; None where nothing moves.
    rows
        The rows of the frame to fill.
    options
        Thresholds.

    Returns
    -------
    (h, w, 4) float32
        Irradiance and samples at the current pixels; zeros where no tap was accepted.
    """
    if motion is None:
        taken = history[rows].copy()
        if before is not None and now is not None:
            same = _same_surface(before[rows].copy(), now, options)
            taken = cv2.copyTo(taken, same.view(np.uint8))
        return taken
    height, width = history.shape[:2]
    x, y = positions(motion, rows, height)
    taken = _bilinear(history, x, y)
    if before is not None and now is not None:
        same = _same_surface(_bilinear(before, x, y), now, options)
        taken = cv2.copyTo(taken, same.view(np.uint8))
    left, top = np.floor(x), np.floor(y)
    if rough is None:
        apart = (left < 0) | (left >= width - 1) | (top < 0) | (top >= height - 1)
    else:
        apart = _nearest(rough, left + 1, top + 1) > 0
    at = np.flatnonzero(apart)
    if at.size:
        now_listed = None if now is None else _pixels(now)[at].view(np.float32)
        listed = _tap_by_tap(
            history, before, now_listed, x.reshape(-1)[at], y.reshape(-1)[at], options
        )
        _pixels(taken)[at] = _pixels(listed)
    return taken


def _pixels(image: np.ndarray) -> np.ndarray:
    """Four floats as one 16-byte element: NumPy then picks and puts pixels six times faster."""
    return image.reshape(-1).view(np.complex128)


def positions(motion: np.ndarray, rows: slice, frame_height: int) -> tuple[np.ndarray, np.ndarray]:
    """Where each pixel was; far positions come near, all of their taps still outside."""
    width = motion.shape[1]
    x = motion[..., 0] + np.arange(width, dtype=np.float32)
    y = motion[..., 1] + np.arange(rows.start, rows.stop, dtype=np.float32)[:, None]
    np.clip(x, _OUTSIDE, np.float32(width) - _OUTSIDE, out=x)
    np.clip(y, _OUTSIDE, np.float32(frame_height) - _OUTSIDE, out=y)
    return x, y


def _tap_by_tap(
    history: np.ndarray,
    before: np.ndarray | None,
    now: np.ndarray | None,
    x: np.ndarray,
    y: np.ndarray,
    options: Temporal,
) -> np.ndarray:
    """The definition, for a list of ``n`` pixels: ``(n, 4)``."""
    # laid out as an image, so that OpenCV does the gathering
    count, shape = x.size, (-(-x.size // _LIST_WIDTH), _LIST_WIDTH)
    x, y = (
        np.append(part, np.full(shape[0] * shape[1] - count, _OUTSIDE)).reshape(shape)
        for part in (x, y)
    )
    if now is not None:
        now = np.resize(now, (*shape, 4))  # repeats for the padding, whose taps lie outside
    left, top = np.floor(x), np.floor(y)
    right_share, low_share = x - left, y - top
    total = np.zeros((4, *shape), np.float32)
    weight_sum = np.zeros(shape, np.float32)
    height, width = history.shape[:2]
    for tap_y, share_y in ((0, 1 - low_share), (1, low_share)):
        for tap_x, share_x in ((0, 1 - right_share), (1, right_share)):
            column, row = left + tap_x, top + tap_y
            weight = share_x * share_y
            weight *= (column >= 0) & (column < width) & (row >= 0) & (row < height)
            if before is not None and now is not None:
                weight *= _same_surface(_nearest(before, column, row), now, options)
            for plane, sums in zip(planes_of(_nearest(history, column, row)), total, strict=True):
                plane *= weight
                sums += plane
            weight_sum += weight
    # samples stay scaled by the accepted share; irradiance is normalised
    total[:3] /= np.maximum(weight_sum, _TINY)
    return cv2.merge(list(total)).reshape(-1, 4)[:count]


def _same_surface(before: np.ndarray, now: np.ndarray, options: Temporal) -> np.ndarray:
    """Whether packed guides ``(h, w, 4)`` show one surface: ``(h, w)`` bool; ``before`` is lost."""
    depth_apart = before[..., 3] - now[..., 3]
    np.abs(depth_apart, out=depth_apart)
    near = depth_apart <= np.float32(np.log1p(options.depth_ratio))
    before *= now
    near &= cv2.transform(before, _NORMAL_SUM) >= np.float32(options.normal_cosine)
    return near


def _bilinear(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    # exact at four channels; for some other counts OpenCV rounds positions to 1/32 pixel
    return cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)


def _nearest(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return cv2.remap(image, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=1)

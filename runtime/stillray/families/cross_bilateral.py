"""Spatiotemporal cross-bilateral filter of two estimates (Choi et al. 2024, section 4.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillray.arrays.extend import surround
from stillray.arrays.strips import STRIP_PIXELS, Strips

WINDOW = 11  # pixels, odd (below eq. 8)
EPSILON = np.float32(1e-4)  # of eq. 9, in squared bands
_REACH = WINDOW // 2
# pixels that are filtered at once: some sixty planes of so many stay in a core's cache
_STRIP_PIXELS = 1 << 12


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimates:
    """What is filtered, and what tells edges.

    Attributes
    ----------
    values : (2, 3, h, w) float32
        Both estimates.
    guides : (2, 3, h, w) float32
        What has bands besides: albedo, normals.
    past : (3, h, w) float32
        The last output at these pixels.
    valid : (h, w) float32
        1 where there is a past, 0 where there is none.
    """

    values: np.ndarray
    guides: np.ndarray
    past: np.ndarray
    valid: np.ndarray


def taps(checkered: bool) -> list[tuple[int, int]]:
    """Neighbours that a window sees, ``(row, column)`` from its center.

    Parameters
    ----------
    checkered
        Whether only every other one, as the black squares of a chessboard, the center among them.
    """
    reach = range(-_REACH, _REACH + 1)
    return [(y, x) for y in reach for x in reach if not checkered or (y + x) % 2 == 0]


def cross_bilateral(
    estimates: Estimates, parameters: np.ndarray, strips: Strips, *, checkered: bool
) -> np.ndarray:
    """Filter both estimates, blend each with the past, and combine them (eq. 8 to 10).

    differs: the place's unit is the reach of a window, not a pixel, so that a band of 1 sees all of
    a window; the published eq. 9 does not say. Neighbours outside of the frame are left out.

    Parameters
    ----------
    estimates
        What is filtered.
    parameters : (6, H, W) float32
        Of the network, which may be larger than the frame: bands, of any sign, and last the logit
        of this frame's share.
    strips
        Where the work runs.
    checkered
        See `taps`.

    Returns
    -------
    (3, h, w) float32
        In the workspace of this thread.
    """
    height, width = estimates.valid.shape
    size = height + 2 * _REACH, width + 2 * _REACH
    workspace = strips.workspace
    # what has bands: estimates, albedo, normals; in memory that the regression needs no more
    planes = workspace.array("surrounded", (4, 3, *size))
    out = workspace.array("combined", (3, height, width))
    offsets = taps(checkered)

    def carry_on(rows: slice) -> None:
        surround(estimates.values, planes[:2], _REACH, rows)
        surround(estimates.guides, planes[2:], _REACH, rows)

    def work(rows: slice) -> None:
        theta = parameters[:, rows, :width]
        sums, weights = _sums(planes, theta, rows, height, offsets)
        sums /= weights[:, None]
        with np.errstate(over="ignore"):
            share = 1 - estimates.valid[rows] / (1 + np.exp(theta[-1]))
        now = sums[0] * weights[0] + sums[1] * weights[1]
        now /= weights[0] + weights[1]
        # both estimates are blended with one past by one share: so is their combination
        past = estimates.past[:, rows]
        out[:, rows] = past + share * (now - past)

    strips.run(carry_on, *size, pixels=STRIP_PIXELS // 4)
    strips.run(work, height, width, pixels=_STRIP_PIXELS)
    return out


def _sums(
    planes: np.ndarray,
    theta: np.ndarray,
    rows: slice,
    height: int,
    offsets: list[tuple[int, int]],
) -> tuple[np.ndarray, np.ndarray]:
    """Weighted sums ``(2, 3, h, w)`` and sums of weights ``(2, h, w)`` of a strip's windows."""
    _, count, width = theta.shape
    slopes = -1 / (np.square(theta[:5]) + EPSILON)
    of_place, slopes = slopes[4], slopes[:4]
    own = planes[:, :, rows.start + _REACH : rows.stop + _REACH, _REACH : _REACH + width]
    sums, weights = np.zeros((2, 3, count, width), np.float32), np.zeros((2, count, width), "f4")
    apart, moved = np.empty((4, 3, count, width), "f4"), np.empty_like(sums)
    exponent, shared = np.empty((4, count, width), "f4"), np.empty((count, width), "f4")
    for y, x in offsets:
        least, most = max(0, -x), min(width, width - x)
        top, bottom = max(0, -y - rows.start), min(count, height - y - rows.start)
        if least >= most or top >= bottom:
            continue
        there = (
            slice(rows.start + y + _REACH, rows.stop + y + _REACH),
            slice(x + _REACH, x + _REACH + width),
        )
        np.subtract(planes[:, :, *there], own, out=apart)
        np.square(apart, out=apart)
        np.add(apart[:, 0], apart[:, 1], out=exponent)
        exponent += apart[:, 2]
        exponent *= slopes
        np.multiply(of_place, np.float32((y * y + x * x) / _REACH**2), out=shared)
        shared += exponent[2]
        shared += exponent[3]
        weight = exponent[:2]
        weight += shared
        np.exp(weight, out=weight)
        if (top, bottom, least, most) != (0, count, 0, width):
            weight[:, :top] = weight[:, bottom:] = 0
            weight[:, :, :least] = weight[:, :, most:] = 0
        weights += weight
        np.multiply(planes[:2, :, *there], weight[:, None], out=moved)
        sums += moved
    return sums, weights

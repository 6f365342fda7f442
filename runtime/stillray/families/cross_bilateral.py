"""Spatiotemporal cross-bilateral filter of two estimates (Choi et al. 2024, section 4.2)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.extend import surround
from stillray.arrays.strips import STRIP_PIXELS, Strips

WINDOW = 11  # pixels, odd (below eq. 8)
#: Of a frame in the picture, at most, where geometry or texture changes within a pixel (differs:
#: the network's alone): its samples meet either side in turn, and only a mean of frames is smooth.
EDGE_SHARE = 0.25
EPSILON = np.float32(1e-4)  # of eq. 9, in squared bands
_REACH = WINDOW // 2
_LEAST = np.float32(-80)  # of an exponent, before the smallest normal number
_COLORS = 3
# Pixels that are filtered at once: smaller strips stay in a nearer cache, but two threads wait for
# one another at the interpreter's lock all the more often.
_STRIP_PIXELS = 1 << 16


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
    edges : (h, w) bool or None
        Where this frame's share is at most `EDGE_SHARE`; None: nowhere.
    """

    values: np.ndarray
    guides: np.ndarray
    past: np.ndarray
    valid: np.ndarray
    edges: np.ndarray | None = None


def taps(thinned: bool) -> list[tuple[int, int]]:
    """Neighbours that a window sees, ``(row, column)`` from its center.

    Parameters
    ----------
    thinned
        Whether only the center, its four diagonal neighbours, and of those beyond every other row
        and column but the corners: 25 in place of 121 (docs/decisions.md has what that changes).
    """
    reach = range(-_REACH, _REACH + 1)
    window = [(y, x) for y in reach for x in reach]
    if not thinned:
        return window
    diagonal = [place for place in window if abs(place[0]) == abs(place[1]) == 1]
    others = [(y, x) for y, x in window if y % 2 == x % 2 == 0 and (y * y + x * x) < _REACH**2]
    return sorted(diagonal + others)


def cross_bilateral(
    estimates: Estimates, parameters: np.ndarray, strips: Strips, *, thinned: bool
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
    thinned
        See `taps`.

    Returns
    -------
    (3, h, w) float32
        In the workspace of this thread.
    """
    height, width = estimates.valid.shape
    offsets = taps(thinned)
    planes = _interleaved(estimates, strips)
    out = strips.workspace.array("combined", (3, height, width))

    def work(rows: slice) -> None:
        theta = parameters[:, rows, :width]
        sums, weights = _sums(planes, theta, rows, height, offsets)
        sums /= weights
        with np.errstate(over="ignore"):
            kept = 1 / (1 + np.exp(theta[-1]))
        if estimates.edges is not None:
            np.maximum(kept, 1 - EDGE_SHARE, out=kept, where=estimates.edges[rows])
        share = 1 - estimates.valid[rows] * kept
        now = sums[:, 0] * weights[0] + sums[:, 1] * weights[1]
        now /= weights[0] + weights[1]
        # both estimates are blended with one past by one share: so is their combination
        past = estimates.past[:, rows]
        out[:, rows] = past + share * (now - past)

    strips.run(work, height, width, pixels=_STRIP_PIXELS)
    return out


def _interleaved(estimates: Estimates, strips: Strips) -> np.ndarray:
    """What has bands, row by row, carried on as far as windows reach: ``(H, 3, 4, W)``.

    A row's planes lie one behind the other, so that a strip seen from any neighbour is one run of
    memory: several times as fast as plane by plane. Above and below lies a row more, for what runs
    over. Of the four groups the first two are the estimates.
    """
    height, width = estimates.valid.shape
    size = height + 2 * _REACH, width + 2 * _REACH
    # in memory that the regression needs no more
    planes = strips.workspace.array("surrounded", (size[0] + 2, _COLORS, 4, size[1]))
    planes[0] = planes[-1] = 0
    by_group = planes[1:-1].transpose(2, 1, 0, 3)

    def carry_on(rows: slice) -> None:
        surround(estimates.values, by_group[:2, :, rows], _REACH, rows)
        surround(estimates.guides, by_group[2:, :, rows], _REACH, rows)

    strips.run(carry_on, *size, pixels=STRIP_PIXELS // 4)
    return planes


def _sums(
    planes: np.ndarray,
    theta: np.ndarray,
    rows: slice,
    height: int,
    offsets: list[tuple[int, int]],
) -> tuple[np.ndarray, np.ndarray]:
    """Weighted sums ``(3, 2, h, w)`` and sums of weights ``(2, h, w)`` of a strip's windows."""
    _, count, width = theta.shape
    full = planes.shape[-1]
    inner = slice(_REACH, _REACH + width)
    # columns around the frame are computed along, with slopes of 0, and dropped
    slopes = np.zeros((count, 5, full), np.float32)
    slopes[..., inner] = (-1 / (np.square(theta[:5]) + EPSILON)).transpose(1, 0, 2)
    slopes, of_place = slopes[:, :4], slopes[:, 4]
    flat, pitch = planes.reshape(-1), planes[0].size
    first = (rows.start + _REACH + 1) * pitch
    own = flat[first : first + count * pitch].reshape(count, _COLORS, 4, full)
    # the center's weight is 1
    sums, weights = own[:, :, :2].copy(), np.ones((count, 2, full), "f4")
    exponent, shared = np.empty((count, 4, full), "f4"), np.empty((count, full), "f4")
    weight = np.empty((count, 2, full), "f4")
    for (y, x), found in _distances(flat, first, (count, 4, full), offsets):
        least, most = max(0, -x), min(width, width - x)
        top, bottom = max(0, -y - rows.start), min(count, height - y - rows.start)
        if least >= most or top >= bottom:
            continue
        np.multiply(found, slopes, out=exponent)
        np.multiply(of_place, np.float32((y * y + x * x) / _REACH**2), out=shared)
        shared += exponent[:, 2]
        shared += exponent[:, 3]
        np.add(exponent[:, :2], shared[:, None], out=weight)
        np.maximum(weight, _LEAST, out=weight)  # what is below costs ten times as long
        cv2.exp(weight, weight)
        weight[:top] = weight[bottom:] = 0
        weight[..., : _REACH + least] = weight[..., _REACH + most :] = 0
        weights += weight
        there = flat[first + y * pitch + x :][: count * pitch].reshape(count, _COLORS, -1)
        for color in range(_COLORS):
            cv2.accumulateProduct(
                there[:, color, : 2 * full],
                weight.reshape(count, -1),
                sums[:, color].reshape(count, -1),
            )
    return sums[..., inner].transpose(1, 2, 0, 3), weights[..., inner].transpose(1, 0, 2)


def _distances(
    flat: np.ndarray, first: int, shape: tuple[int, int, int], offsets: list[tuple[int, int]]
) -> Iterator[tuple[tuple[int, int], np.ndarray]]:
    """Squared distances, of `shape` (rows, groups, columns), to all neighbours but the center.

    A pixel is as far from a neighbour as that neighbour is from it: windows being symmetric, half
    of the distances are those of the other half, seen from elsewhere.
    """
    count, groups, full = shape
    pitch = _COLORS * groups * full
    apart = np.empty((count + _REACH, groups * full), np.float32)
    # columns to the side of the first and the last row belong to none
    buffer = np.zeros(apart.size + 2 * _REACH, np.float32)
    for y, x in offsets:
        if (y, x) <= (0, 0):
            continue
        rows = count + y
        own = flat[first - y * pitch :][: rows * pitch].reshape(rows, _COLORS, -1)
        there = flat[first + x :][: rows * pitch].reshape(rows, _COLORS, -1)
        squares = buffer[_REACH:][: rows * groups * full].reshape(rows, -1)
        for color in range(_COLORS):
            np.subtract(there[:, color], own[:, color], out=apart[:rows])
            if color:
                cv2.accumulateSquare(apart[:rows], squares)
            else:
                np.square(apart[:rows], out=squares)
        yield (y, x), squares[y:].reshape(shape)
        start = _REACH - x
        yield (-y, -x), buffer[start : start + count * groups * full].reshape(shape)

"""Cross-regression (Choi et al. 2024, section 4.1): pilot estimates from two halves of the samples.

Around one pixel in 49 one half's radiance, albedo and normals explain the other half's
radiance, by a line that is fitted in a window; what the lines say of a pixel is blended. The noise
of the half that explains is not that of the half that is explained, so that it is not copied.
"""

from __future__ import annotations

import cv2
import numpy as np

from stillray.arrays.extend import surround
from stillray.arrays.strips import STRIP_PIXELS, Strips, with_halo
from stillray.arrays.workspace import Workspace
from stillray.models.products import products

WINDOW = 17  # pixels, odd (section 3)
# Pixels from center to center. differs: one pixel in 16 (section 3); one in 49 takes a third of the
# time (docs/decisions.md).
SPACING = 7
_REACH = WINDOW // 2
_PIXELS = WINDOW**2
_APART = -(-WINDOW // SPACING)  # centers whose windows do not overlap
# Epsilon of eq. 6, in log radiance, and its square for eq. 7: noise that no eye sees.
_NOISE = np.float32(0.01)
# Tikhonov: the mean square that an explanatory variable must have in a window, in its own unit, to
# have half the slope that it would have without.
RIDGE = 1e-3
#: What a pixel's own color weighs in the blend of eq. 5, in like pixels: where no center is like
#: it, lines of others are drawn on far beyond what they were fitted to.
ALONE = np.float32(0.1)
_LEAST_WEIGHT = 1e-6  # of a window, in pixels: outside of frames there is nothing to fit
# Centers in a row whose windows are taken out at once, and rows of centers whose windows are added
# up at once: constants, as sums must not depend on strips.
_CENTERS = 256
_ROWS = 4
_COLORS = 3


def pilots(first: np.ndarray, second: np.ndarray, guides: np.ndarray, strips: Strips) -> np.ndarray:
    """Both pilot estimates (eq. 3 to 7).

    A pilot is limited to the range of what it was fitted to, within the window around a pixel: a
    line that is drawn on beyond its pixels invents light.

    differs: weights are of colors alone (eq. 7); here pixels count less the more their guides
    differ, too. Beside a window that is many times as bright as its wall, the deviation of 3x3
    pixels takes the edge for noise, and the window's light would be smeared over the wall.

    Parameters
    ----------
    first, second : (3, h, w) float32
        The two halves of a frame's samples: log of one and exposed radiance.
    guides : (g, h, w) float32
        Albedo, normals: what both halves share, in units of a difference at which a pixel counts
        1/e; g may be 0.
    strips
        Where the work runs.

    Returns
    -------
    (2, 3, h, w) float32
        What the first half explains of the second, and the other way round; in the workspace of
        this thread.
    """
    halves = (first, second)
    height, width = first.shape[1:]
    rows, columns = (-(-size // SPACING) for size in (height, width))
    padded, shared = _surrounded(halves, guides, strips)

    def work(blocks: slice) -> list[np.ndarray]:
        return [
            _block(padded, shared, range(top, min(top + _ROWS, rows)), columns, strips)
            for top in range(blocks.start * _ROWS, blocks.stop * _ROWS, _ROWS)
        ]

    count = -(-rows // _ROWS)
    parts = [part for some in strips.run(work, count, _ROWS * _PIXELS * columns) for part in some]
    found = strips.workspace.array("pilots", (2, *first.shape))

    def finish(rows: slice) -> None:
        sums = _summed(parts, rows, width)
        near, inside = with_halo(rows, _REACH, height)
        for total, own, other, estimate in zip(sums, halves, halves[::-1], found, strict=True):
            total[:_COLORS] += ALONE * own[:, rows]
            total[_COLORS] += ALONE
            np.divide(total[:_COLORS], total[_COLORS], out=estimate[:, rows])
            _limit(estimate[:, rows], other[:, near], inside)

    strips.run(finish, height, width, pixels=STRIP_PIXELS // 4)
    return found


def _surrounded(
    halves: tuple[np.ndarray, np.ndarray], guides: np.ndarray, strips: Strips
) -> tuple[np.ndarray, np.ndarray]:
    """What windows are taken from: as far as those of the centers reach, on every side.

    Centers lie at 3, 10, 17, ...: beyond the last row or column they stand for it.

    Returns
    -------
    padded : (2, 4, H, W) float32
        Both halves, and the `deviation` of each.
    shared : (g + 1, H, W) float32
        Guides, and 1 within the frame, 0 around it.
    """
    height, width = halves[0].shape[1:]
    noise = strips.workspace.array("deviations", (2, 1, height, width))

    def estimate(rows: slice) -> None:
        near, inside = with_halo(rows, 1, height)
        for half, target in zip(halves, noise, strict=True):
            target[0, rows] = deviation(half[:, near])[inside]

    strips.run(estimate, height, width)
    size = [2 * _REACH + 1 + -(-extent // SPACING) * SPACING for extent in (height, width)]
    of_halves = 2 * (_COLORS + 1)
    planes = strips.workspace.array("surrounded", (of_halves + len(guides) + 1, *size))
    padded = planes[:of_halves].reshape(2, _COLORS + 1, *size)
    shared = planes[of_halves:]

    def carry_on(rows: slice) -> None:
        for half, deviated, target in zip(halves, noise, padded, strict=True):
            surround(half, target[:_COLORS], _REACH, rows)
            surround(deviated, target[_COLORS:], _REACH, rows)
        surround(guides, shared[:-1], _REACH, rows)
        shared[-1, rows] = 0
        within = slice(max(rows.start, _REACH), min(rows.stop, _REACH + height))
        shared[-1, within, _REACH : _REACH + width] = 1

    strips.run(carry_on, size[0], size[1], pixels=STRIP_PIXELS // 4)
    return padded, shared


def deviation(log_radiance: np.ndarray) -> np.ndarray:
    """Standard deviation of a pixel's noise (section 4.1): its distance from its eight neighbours.

    Parameters
    ----------
    log_radiance : (3, h, w) float32

    Returns
    -------
    (h, w) float32
        Length of the difference between the color and the mean of those around it; those outside
        of the frame are as at its edge.
    """
    around = np.full((3, 3), 1 / 8, np.float32)
    around[1, 1] = 0
    squares = np.zeros(log_radiance.shape[1:], np.float32)
    for plane in log_radiance:
        squares += (plane - cv2.filter2D(plane, -1, around, borderType=cv2.BORDER_REPLICATE)) ** 2
    return np.sqrt(squares, out=squares)


def _block(
    padded: np.ndarray, shared: np.ndarray, rows: range, columns: int, strips: Strips
) -> np.ndarray:
    """Sums of eq. 5 over some rows of centers: ``(2, 4, h, w)``, of both halves."""
    workspace = strips.workspace
    height = SPACING * (len(rows) - 1) + WINDOW
    start = SPACING * rows.start + SPACING // 2
    near = slice(start, start + height)
    # so wide that the last window lies in a whole stretch of `_add_columns`
    sums = np.zeros((2, _COLORS + 1, height, shared.shape[2] + _APART * SPACING), np.float32)
    for left in range(0, columns, _CENTERS):
        count = min(_CENTERS, columns - left)
        common, first, second = (
            _columns(planes[:, near], left, count, name, workspace)
            for name, planes in (("common", shared), ("first", padded[0]), ("second", padded[1]))
        )
        said = workspace.array("said", (2, count, _COLORS + 1, height, WINDOW))
        said.fill(0)
        for top in range(0, height - WINDOW + 1, SPACING):
            strips.watch.look()  # a block takes long, and cutting it would add up in another order
            seen = _windows(first, top), _windows(second, top)
            _say(_windows(common, top), seen, _windows(said, top), workspace)
        for half in range(2):
            _add_columns(sums[half], said[half], left)
    return sums


def _say(
    common: np.ndarray,
    seen: tuple[np.ndarray, np.ndarray],
    said: np.ndarray,
    workspace: Workspace,
) -> None:
    """Fit lines in windows, and add what they say, weighed, and their weights.

    Parameters
    ----------
    common : (count, g + 1, pixels) float32
        Guides, and whether a pixel is of the frame.
    seen : two (count, 4, pixels) float32
        Both halves, and the deviation of each.
    said : (2, count, 4, pixels) float32
        What is added to.
    workspace
        Where what lines are fitted to lies: new memory would cost as much as the fit.
    """
    count, planes = common.shape[:2]
    explain = _COLORS + planes
    # what explains, 1, color and guides, then what is explained: one product gives all sums
    shape = (count, explain + _COLORS, _PIXELS)
    variables = workspace.array("explain and explained", shape)
    weighed = workspace.array("weighed", (count, explain, _PIXELS))
    variables[:, 0] = 1
    guides = variables[:, 1 + _COLORS : explain]
    np.subtract(common[:, :-1], common[:, :-1, _PIXELS // 2, None], out=guides)
    apart, inside = np.einsum("ncp,ncp->np", guides, guides), common[:, -1]
    for half, sums in enumerate(said):
        variables[:, explain:] = seen[1 - half][:, :_COLORS]
        weights = _explain(seen[half], apart, variables)
        weights *= inside
        weighed[:, 0] = weights
        np.multiply(variables[:, 1:explain], weights[:, None], out=weighed[:, 1:])
        sums[:, :_COLORS] += _fit(variables, weighed) @ weighed
        sums[:, _COLORS] += weights


def _summed(parts: list[np.ndarray], rows: slice, width: int) -> np.ndarray:
    """Sums of eq. 5 over all blocks, of rows of a frame: ``(2, 4, rows, width)``."""
    sums = np.zeros((2, _COLORS + 1, rows.stop - rows.start, width), np.float32)
    for index, part in enumerate(parts):  # from the top, whatever the rows
        top = SPACING * _ROWS * index + SPACING // 2 - _REACH
        first, last = max(rows.start, top), min(rows.stop, top + part.shape[2])
        if first < last:
            sums[:, :, first - rows.start : last - rows.start] += part[
                :, :, first - top : last - top, _REACH : _REACH + width
            ]
    return sums


def _columns(
    planes: np.ndarray, left: int, count: int, name: str, workspace: Workspace
) -> np.ndarray:
    """Columns of pixels as wide as windows around some centers: ``(count, planes, h, 17)``.

    A window of a column is one run of memory, of an array in the workspace.
    """
    views = np.lib.stride_tricks.sliding_window_view(planes, WINDOW, axis=2)
    start = SPACING * left + SPACING // 2
    chosen = views[:, :, start : start + SPACING * count : SPACING]  # (p, h, count, 17)
    columns = workspace.array(name, (count, *planes.shape[:2], WINDOW))
    np.copyto(columns, chosen.transpose(2, 0, 1, 3))
    return columns


def _windows(columns: np.ndarray, top: int) -> np.ndarray:
    """Windows of `_columns` from some row on, not copied: ``(..., pixels)``."""
    part = columns[..., top : top + WINDOW, :]
    steps = (*part.strides[:-2], part.strides[-1])
    return np.lib.stride_tricks.as_strided(part, (*part.shape[:-2], _PIXELS), steps)


def _explain(planes: np.ndarray, apart: np.ndarray, variables: np.ndarray) -> np.ndarray:
    """Fill in the color's variables (eq. 6); gives the weights (eq. 7), ``(count, pixels)``.

    Parameters
    ----------
    planes : (count, 4, pixels) float32
        A half, and its deviation.
    apart : (count, pixels) float32
        Squares of how far guides are from those of the center.
    variables : (count, more than 4, pixels) float32
        The second to the fourth are written.
    """
    middle = planes[..., _PIXELS // 2, None]
    noise, own = planes[:, _COLORS], middle[:, _COLORS]
    colors = variables[:, 1 : 1 + _COLORS]
    np.subtract(planes[:, :_COLORS], middle[:, :_COLORS], out=colors)
    squares = np.einsum("ncp,ncp->np", colors, colors)
    variance = np.square(noise)
    variance += own**2 + _NOISE**2
    squares /= variance
    squares += apart
    weights = np.exp(np.negative(squares, out=squares), out=squares)
    np.add(noise, own + _NOISE, out=variance)
    colors *= np.reciprocal(variance, out=variance)[:, None]
    return weights


def _fit(variables: np.ndarray, weighed: np.ndarray) -> np.ndarray:
    """Weighted least squares (eq. 4) of three planes: ``(count, 3, v)``.

    Parameters
    ----------
    variables : (count, v + 3, pixels) float32
        The first of them 1; the last three are explained by the others.
    weighed : (count, v, pixels) float32
        What explains, times the weights.
    """
    explain = weighed.shape[1]
    sums = products(weighed, variables).astype(np.float64)
    normal, right = sums[..., :explain], sums[..., explain:]
    total = normal[:, 0, 0].copy()
    diagonal = np.einsum("nii->ni", normal)
    diagonal[:, 1:] += RIDGE * total[:, None] + _LEAST_WEIGHT
    diagonal[:, 0] += _LEAST_WEIGHT
    lines = np.linalg.solve(normal, right)
    wrong = ~np.isfinite(lines).all(axis=(1, 2))
    if wrong.any():  # the weighted mean
        lines[wrong] = 0
        lines[wrong, 0] = right[wrong, 0] / (total[wrong, None] + _LEAST_WEIGHT)
    return lines.transpose(0, 2, 1).astype(np.float32)


def _add_columns(sums: np.ndarray, said: np.ndarray, left: int) -> None:
    """Add columns of what lines say, and of weights, at their places in rows of a block.

    Columns so far apart that they do not overlap are added at once.
    """
    count, step = len(said), _APART * SPACING
    planes = said.transpose(1, 2, 0, 3)
    for first in range(min(_APART, count)):
        number = len(range(first, count, _APART))
        start = SPACING * (left + first) + SPACING // 2
        # of each stretch a column takes the beginning
        at = sums[..., start : start + step * number].reshape(*sums.shape[:2], number, step)
        at[..., :WINDOW] += planes[:, :, first::_APART]


def _limit(estimate: np.ndarray, explained: np.ndarray, inside: slice) -> None:
    """Bring rows of a pilot within the range of what it was fitted to, around each pixel.

    Parameters
    ----------
    estimate : (3, rows, w) float32
        Changed.
    explained : (3, rows, w) float32
        With the rows that windows look at beyond those.
    inside
        Of the rows of ``explained``, those of ``estimate``.
    """
    around = np.ones((WINDOW, WINDOW), np.uint8)
    for plane, target in zip(estimate, explained, strict=True):
        cv2.min(plane, cv2.dilate(target, around)[inside], dst=plane)
        cv2.max(plane, cv2.erode(target, around)[inside], dst=plane)

"""Cross-regression (Choi et al. 2024, section 4.1): pilot estimates from two halves of the samples.

Around one pixel in 36 one half's radiance and normals explain the other half's radiance, by a
line that is fitted in a window; what the lines say of a pixel is blended. The noise of the half
that explains is not that of the half that is explained, so that it is not copied.

A frame is cut into tiles of 6x6 pixels. Lines belong to the corners of tiles: the four tiles that
meet there are a line's window, and four lines speak of each pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.extend import surround
from stillray.arrays.strips import STRIP_PIXELS, Strips, with_halo
from stillray.arrays.workspace import Workspace
from stillray.models.products import products

# Pixels from center to center. differs: one pixel in 16 (section 3); here one in 36.
SPACING = 6
# differs: windows of 17x17 pixels (section 3); here of 2x2 tiles, 12x12 pixels, which are taken as
# they lie (docs/decisions.md).
_SIDE = 2
#: Lines that speak of a pixel.
LINES = _SIDE**2
_RANGE = 8  # pixels to each side, within whose range a pilot stays
_TILE = SPACING**2  # pixels
_PIXELS = LINES * _TILE
# Epsilon of eq. 6, in log radiance, and its square for eq. 7: noise that no eye sees.
_NOISE = np.float32(0.01)
# Tikhonov: the mean square that an explanatory variable must have in a window, in its own unit, to
# have half the slope that it would have without.
RIDGE = 1e-3
#: What a pixel's own color weighs in the blend of eq. 5, in like pixels: where no center is like
#: it, lines of others are drawn on far beyond what they were fitted to.
ALONE = np.float32(0.1)
_LEAST_WEIGHT = 1e-6  # of a window, in pixels: outside of frames there is nothing to fit
_FAR = np.float32(1e4)  # as a square, of pixels that are not of the frame: they weigh nothing
# Centers in a row whose lines are fitted at once: a constant, as sums must not depend on strips.
_CENTERS = 256
_ROWS = 20  # of tiles in a strip, at most: one more row of centers is fitted for each
_COLORS = 3


@dataclass(frozen=True, eq=False)
class Guides:
    """What both halves of the samples share.

    Attributes
    ----------
    planes : (g, h, w) float32
        Albedo, normals; g may be 0.
    units : (g,) float32
        Differences at which a pixel counts 1/e.
    explaining
        How many of them, the last ones, explain light besides (eq. 6).
    """

    planes: np.ndarray
    units: np.ndarray
    explaining: int


@dataclass(frozen=True, eq=False)
class _Tiles:
    """Two rows of tiles, between which centers lie, and a tile more on either side.

    Attributes
    ----------
    planes : (planes, columns + 2, 2, pixels) float32
        Color and `deviation` of the first half, those of the second, guides in their units, and
        last `_FAR` around the frame; there the others are as the pixels at its edge. A tile above
        and one below are one run of memory, and so are those beside: a window is one, too.
    below
        Which of both rows is the lower one: rows take turns, so that none is copied.
    guides, explaining
        How many there are, and how many of them explain light.
    """

    planes: np.ndarray
    below: int
    guides: int
    explaining: int

    def windows(self, centers: range) -> np.ndarray:
        """Windows of some centers, not copied: ``(count, planes, pixels of four tiles)``."""
        part = self.planes[:, centers.start :]
        of_plane, of_tile, _, of_pixel = part.strides
        shape = len(centers), len(part), _PIXELS
        return np.lib.stride_tricks.as_strided(part, shape, (of_tile, of_plane, of_pixel))

    def centers(self, centers: range) -> np.ndarray:
        """The pixels below and right of some centers, ``(count, planes, 1)``."""
        found = self.planes[:, centers.start + 1 : centers.stop + 1, self.below, 0]
        return np.ascontiguousarray(found.T)[..., None]


def pilots(halves: tuple[np.ndarray, np.ndarray], guides: Guides, strips: Strips) -> np.ndarray:
    """Both pilot estimates (eq. 3 to 7).

    A pilot is limited to the range of what it was fitted to in the 17x17 pixels around: a line that
    is drawn on beyond its pixels invents light.

    differs: weights are of colors alone (eq. 7); here pixels count less the more their guides
    differ, too. Beside a window that is many times as bright as its wall, the deviation of 3x3
    pixels takes the edge for noise, and the window's light would be smeared over the wall.

    Parameters
    ----------
    halves : two (3, h, w) float32
        The two halves of a frame's samples: log of one and exposed radiance.
    guides
        Of as many pixels.
    strips
        Where the work runs.

    Returns
    -------
    (2, 3, h, w) float32
        What the first half explains of the second, and the other way round; in the workspace of
        this thread.
    """
    height, width = halves[0].shape[1:]
    noise = _deviations(halves, strips)
    rows, columns = (-(-extent // SPACING) for extent in (height, width))
    found = strips.workspace.array("pilots", (2, *halves[0].shape))

    def fit(some: slice) -> None:
        count = 2 * (_COLORS + 1) + len(guides.planes) + 1
        planes = strips.workspace.array("tiles", (count, columns + 2, _SIDE, _TILE))
        shape = (2, _COLORS + 1, columns + 2, _SIDE, _TILE)
        said = strips.workspace.array("said", shape)
        said.fill(0)
        first = some.start - 1
        _cut(halves, noise, guides, first, planes[:, :, first % _SIDE], strips.workspace)
        for row in range(some.start, some.stop + 1):  # of centers, between two of tiles
            strips.watch.look()
            above, below = (row - 1) % _SIDE, row % _SIDE
            _cut(halves, noise, guides, row, planes[:, :, below], strips.workspace)
            said[:, :, :, below] = 0
            tiles = _Tiles(planes, below, len(guides.planes), guides.explaining)
            for left in range(0, columns + 1, _CENTERS):
                centers = range(left, min(left + _CENTERS, columns + 1))
                _say(tiles, centers, said, strips.workspace)
            if row > some.start:  # all lines around have spoken of the tiles above
                _blend(said[:, :, :, above], halves, found, row - 1)

    # rows of centers between strips are fitted on either side
    strips.run(fit, rows, _TILE * columns, pixels=_ROWS * _TILE * columns)

    def limit(part: slice) -> None:
        near, inside = with_halo(part, _RANGE, height)
        for estimate, other in zip(found, halves[::-1], strict=True):
            _limit(estimate[:, part], other[:, near], inside)

    strips.run(limit, height, width, pixels=STRIP_PIXELS // 4)
    return found


def _deviations(halves: tuple[np.ndarray, np.ndarray], strips: Strips) -> np.ndarray:
    """The `deviation` of either half, ``(2, 1, h, w)``."""
    _, height, width = halves[0].shape
    noise = strips.workspace.array("deviations", (2, 1, height, width))

    def estimate(rows: slice) -> None:
        near, inside = with_halo(rows, 1, height)
        for half, target in zip(halves, noise, strict=True):
            target[0, rows] = deviation(half[:, near])[inside]

    strips.run(estimate, height, width)
    return noise


def _cut(
    halves: tuple[np.ndarray, np.ndarray],
    noise: np.ndarray,
    guides: Guides,
    row: int,
    tiles: np.ndarray,
    workspace: Workspace,
) -> None:
    """Cut a row of tiles out of a frame, -1 for the one above it, see `_Tiles.planes`."""
    count, columns = tiles.shape[:2]
    height, width = noise.shape[2:]
    pixels = slice((row + 1) * SPACING, (row + 2) * SPACING)  # with those above the frame
    part = workspace.array("row of pixels", (count, SPACING, columns * SPACING))
    first = 0
    for planes in (halves[0], noise[0], halves[1], noise[1], guides.planes):
        surround(planes, part[first : first + len(planes)], SPACING, pixels)
        first += len(planes)
    part[2 * (_COLORS + 1) : -1] /= guides.units[:, None, None]
    inside = np.arange(row * SPACING, row * SPACING + SPACING)
    part[-1] = _FAR
    part[-1, (inside >= 0) & (inside < height), SPACING : SPACING + width] = 0
    by_tile = part.reshape(count, SPACING, columns, SPACING).transpose(0, 2, 1, 3)
    tiles.reshape(by_tile.shape)[...] = by_tile  # a view: each tile's pixels are one run


def _blend(
    said: np.ndarray, halves: tuple[np.ndarray, np.ndarray], found: np.ndarray, row: int
) -> None:
    """A row of tiles of the estimates (eq. 5), of sums over lines ``(2, 4, columns + 2, n)``."""
    height, width = found.shape[2:]
    rows = slice(row * SPACING, min(row * SPACING + SPACING, height))
    by_tile = said[:, :, 1:-1].reshape(2, _COLORS + 1, -1, SPACING, SPACING)
    sums = by_tile.swapaxes(2, 3).reshape(2, _COLORS + 1, SPACING, -1)
    for total, half, estimate in zip(sums, halves, found, strict=True):
        total = total[:, : rows.stop - rows.start, :width]
        total[:_COLORS] += ALONE * half[:, rows]
        total[_COLORS] += ALONE
        np.divide(total[:_COLORS], total[_COLORS], out=estimate[:, rows])


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


def _say(tiles: _Tiles, chosen: range, sums: np.ndarray, workspace: Workspace) -> None:
    """Fit lines at some centers, and add what they say, weighed, and their weights.

    Parameters
    ----------
    tiles
        Around the centers.
    chosen
        Which of a row.
    sums : (2, 4, columns + 2, 2, pixels) float32
        What is added to: of either half, in both rows of tiles.
    workspace
        Where what lines are fitted to lies: new memory would cost as much as the fit.
    """
    count, explain = len(chosen), 1 + _COLORS + tiles.explaining
    windows, centers = tiles.windows(chosen), tiles.centers(chosen)
    # what explains, 1, color and guides, then what is explained: one product gives all sums
    shape = (count, explain + _COLORS, _PIXELS)
    variables = workspace.array("explain and explained", shape)
    weighed = workspace.array("weighed", (2, count, explain, _PIXELS))
    guides = workspace.array("guides of windows", (count, tiles.guides, _PIXELS))
    of_guides = slice(-1 - tiles.guides, -1)
    np.subtract(windows[:, of_guides], centers[:, of_guides], out=guides)
    apart = np.einsum("ncp,ncp->np", guides, guides)
    apart += windows[:, -1]
    variables[:, 0] = 1
    variables[:, 1 + _COLORS : explain] = guides[:, tiles.guides - tiles.explaining :]
    normal = np.empty((2, count, explain, explain + _COLORS), np.float32)
    for half in range(2):
        own, other = (slice(first, first + _COLORS + 1) for first in (4 * half, 4 - 4 * half))
        variables[:, explain:] = windows[:, other][:, :_COLORS]
        weights = _explain(windows[:, own], centers[:, own], apart, variables)
        weighed[half, :, 0] = weights
        np.multiply(variables[:, 1:explain], weights[:, None], out=weighed[half, :, 1:])
        normal[half] = products(weighed[half], variables)
    # beside three colors the weights themselves
    lines = np.zeros((2, count, _COLORS + 1, explain), np.float32)
    fitted = _fit(normal.reshape(2 * count, explain, -1))
    lines[:, :, :_COLORS], lines[..., _COLORS, 0] = fitted.reshape(2, count, _COLORS, explain), 1
    for half in range(2):
        said = workspace.array("of lines", (count, _COLORS + 1, _PIXELS))
        np.matmul(lines[half], weighed[half], out=said)
        by_tile = said.reshape(count, _COLORS + 1, _SIDE, _SIDE, _TILE).transpose(2, 1, 0, 3, 4)
        for beside, tile in enumerate(by_tile):
            sums[half, :, chosen.start + beside : chosen.stop + beside] += tile


def _explain(
    planes: np.ndarray, centers: np.ndarray, apart: np.ndarray, variables: np.ndarray
) -> np.ndarray:
    """Fill in the color's variables (eq. 6); gives the weights (eq. 7), ``(count, pixels)``.

    Parameters
    ----------
    planes : (count, 4, pixels) float32
        A half, and its deviation.
    centers : (count, 4, 1) float32
        The same of the centers.
    apart : (count, pixels) float32
        Squares of how far guides are from those of the center.
    variables : (count, more than 4, pixels) float32
        The second to the fourth are written.
    """
    noise, own = planes[:, _COLORS], centers[:, _COLORS]
    colors = variables[:, 1 : 1 + _COLORS]
    np.subtract(planes[:, :_COLORS], centers[:, :_COLORS], out=colors)
    squares = np.einsum("ncp,ncp->np", colors, colors)
    variance = np.square(noise)
    variance += own**2 + _NOISE**2
    squares /= variance
    squares += apart
    weights = np.exp(np.negative(squares, out=squares), out=squares)
    np.add(noise, own + _NOISE, out=variance)
    colors *= np.reciprocal(variance, out=variance)[:, None]
    return weights


def _fit(sums: np.ndarray) -> np.ndarray:
    """Weighted least squares (eq. 4) of three planes: ``(n, 3, v)``.

    Parameters
    ----------
    sums : (n, v, v + 3) float32
        Normal equations and their right sides, of variables the first of which is 1.
    """
    explain = sums.shape[1]
    # equations one behind the other: all of them are solved at once
    matrix = sums.transpose(1, 2, 0).astype(np.float64, order="C")
    total, mean = matrix[0, 0].copy(), matrix[0, explain:].copy()
    for i in range(explain):
        matrix[i, i] += _LEAST_WEIGHT + (RIDGE * total if i else 0)
    # without pivots: matrices are symmetric and, with the ridge, positive
    with np.errstate(all="ignore"):
        for i in range(explain):
            matrix[i, i + 1 :] /= matrix[i, i]
            matrix[i + 1 :, i + 1 :] -= matrix[i + 1 :, i, None] * matrix[i, None, i + 1 :]
        lines = matrix[:, explain:]
        for i in range(explain - 1, 0, -1):
            lines[:i] -= matrix[:i, i, None] * lines[None, i]
    wrong = ~np.isfinite(lines).all(axis=(0, 1))
    if wrong.any():  # the weighted mean
        lines[..., wrong] = 0
        lines[0][:, wrong] = mean[:, wrong] / (total[wrong] + _LEAST_WEIGHT)
    return lines.transpose(2, 1, 0).astype(np.float32)


def _limit(estimate: np.ndarray, explained: np.ndarray, inside: slice) -> None:
    """Bring rows of a pilot within the range of what it was fitted to, near each pixel.

    Parameters
    ----------
    estimate : (3, rows, w) float32
        Changed.
    explained : (3, rows, w) float32
        With the rows that windows look at beyond those.
    inside
        Of the rows of ``explained``, those of ``estimate``.
    """
    around = np.ones((2 * _RANGE + 1, 2 * _RANGE + 1), np.uint8)
    for plane, target in zip(estimate, explained, strict=True):
        cv2.min(plane, cv2.dilate(target, around)[inside], dst=plane)
        cv2.max(plane, cv2.erode(target, around)[inside], dst=plane)

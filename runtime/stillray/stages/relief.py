"""Relief that was filtered away, found again in what the filter took from a frame.

What a filter takes away is noise, and what it should have kept. Noise knows nothing of normals,
relief does: around a pixel what was taken is explained by a line through the fine part of the
normals, and what the line says is put back. So plaster, mouldings and carving are shaded again
where few samples hid that, at no invention of a network's.

Lines fitted to features in a window are those of Bitterli et al. 2016, section 3; smoothing what a
smoother left is twicing (Tukey 1977, section 16). A slope is as large as the noise around allows:
Bayes' estimate with a prior of no slope, less what noise alone would explain.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from stillray.arrays.bounds import at_most
from stillray.arrays.gain import multiply
from stillray.arrays.strips import STRIP_PIXELS, Strips, planes_of, with_halo
from stillray.arrays.workspace import Workspace
from stillray.stages.block_sums import (
    BLOCK,
    LEAST_WEIGHT,
    NEIGHBOURS,
    enlarged,
    mean_of_blocks,
    widened,
    with_neighbours,
)
from stillray.stages.features import luminance
from stillray.stages.state import Prepared

FINE = 5  # pixels, odd: from their mean over so many normals differ by their fine part
#: How far a normal may be from those around to count 1/e: what is bent more is an edge between
#: surfaces, of which each has its own light.
BENT = 0.9
#: And the depth, relative, from that of 3x3 pixels.
APART = 0.02
#: Relative to the picture: what may have been taken from a pixel at most. Bounds fireflies.
MOST_TAKEN = 1.0
DARKEST = 0.01  # exposed radiance that is added where relative means relative to it
PRIOR = 1.0  # standard deviation of slopes
RIDGE = 4e-4  # mean square of a normal's fine part at which a slope is half
#: Of what noise alone would explain, this share is taken off.
DOUBT = 0.5
#: How alike fine normals of neighbours are, from where nothing is put back to where all is: relief
#: finer than pixels is noise in normals, which the light of the same samples shares.
RESOLVED = (0.05, 0.35)
LEAST_GAIN, MOST_GAIN = 0.4, 2.0
LEAST_EXPLAINED = 1e-12  # variance
_BRIGHTEST = 1e37  # of which nothing that follows makes infinity
_FITTED = 2048  # blocks whose lines are fitted at once: small, as they take many arrays
#: Entries of a symmetric matrix of three rows, in the order of their sums.
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
# Weight, it with what was taken and with its square, with normals, with both, with pairs of
# normals; normals with those beside and below
_SUMS = 3 + 3 + 3 + len(PAIRS) + 1


def shade(
    image: np.ndarray,
    prepared: Prepared,
    window: float,
    strips: Strips,
    workspace: Workspace,
    weights: np.ndarray | None = None,
) -> np.ndarray:
    """Put a picture's relief back.

    Parameters
    ----------
    image : (h, w, 3) float32
        Radiance that was filtered, finite and >= 0; multiplied by the gain.
    prepared
        The frame it was made of, with normals.
    window
        Standard deviation of the window in which lines are fitted, pixels, > 0.
    strips
        Where the work runs.
    workspace
        Where arrays lie from frame to frame.
    weights : (h, w) float32, optional
        Written: how far pixels lie on a surface that goes on, see `surface_weight`.

    Returns
    -------
    (h, w) float32
        The gain, in [`LEAST_GAIN`, `MOST_GAIN`]; 1 where normals are even or explain nothing. It
        lies in the workspace.
    """
    height, width = image.shape[:2]
    rows, columns = -(-height // BLOCK), -(-width // BLOCK)
    sums = workspace.array("sums of relief", (_SUMS, rows, columns))
    fine = workspace.array("fine normals", (3, height, width))

    def add_up(blocks: slice) -> None:
        some = slice(BLOCK * blocks.start, min(BLOCK * blocks.stop, height))
        weight = _add_up(image, prepared, some, fine[:, some], sums[:, blocks], strips.workspace)
        if weights is not None:
            weights[some] = weight

    strips.run(add_up, rows, columns, pixels=STRIP_PIXELS // BLOCK**2)
    slopes = _slopes(sums, window, strips, workspace)
    found = workspace.array("slopes of relief", (3, BLOCK * rows, BLOCK * columns))
    enlarged(slopes, strips, found)
    gain = workspace.array("gain of relief", (height, width))

    def tell(some: slice) -> None:
        total = gain[some]
        np.multiply(found[0, some, :width], fine[0, some], out=total)
        for slope, normal in zip(found[1:, some, :width], fine[1:, some], strict=True):
            cv2.accumulateProduct(slope, normal, total)
        total += 1
        np.clip(total, LEAST_GAIN, MOST_GAIN, out=total)
        multiply(image[some], total, strips.workspace)

    strips.run(tell, height, width)
    return gain


def _add_up(
    image: np.ndarray,
    prepared: Prepared,
    rows: slice,
    weighed: np.ndarray,
    sums: np.ndarray,
    workspace: Workspace,
) -> np.ndarray:
    """Means over blocks of rows into ``(16, rows, columns)``, and their weighed fine normals.

    The result is their weight.
    """
    assert prepared.normal is not None
    detail = _fine_normals(prepared.normal, rows, workspace)
    weight = surface_weight(prepared.depth, rows, detail, workspace)
    taken = _taken(image, prepared, rows, workspace)
    np.multiply(detail, weight, out=weighed)
    inside, places = workspace.array("product", weight.shape), iter(sums)

    def mean(plane: np.ndarray) -> None:
        mean_of_blocks(plane, next(places))

    mean(weight)
    mean(np.multiply(weight, taken, out=inside))
    mean(np.multiply(inside, taken, out=inside))
    for plane in weighed:
        mean(plane)
    for plane in weighed:
        mean(np.multiply(plane, taken, out=inside))
    for first, second in PAIRS:
        mean(np.multiply(weighed[first], detail[second], out=inside))
    mean(with_neighbours(weighed, inside, workspace))
    return weight


def _fine_normals(normal: np.ndarray, rows: slice, workspace: Workspace) -> np.ndarray:
    """Rows of normals less their mean over `FINE` pixels, ``(3, rows, w)``."""
    near, inside = with_halo(rows, FINE // 2, len(normal))
    shape = (3, near.stop - near.start, normal.shape[1])
    planes = planes_of(normal[near], out=workspace.array("normals", shape))
    kernel, around = np.full(FINE, 1 / FINE, np.float32), workspace.array("around", shape[1:])
    for plane in planes:
        # each window is added anew, so that a strip of rows gives what the whole frame gives
        cv2.sepFilter2D(plane, -1, kernel, kernel, dst=around, borderType=cv2.BORDER_REPLICATE)
        plane -= around
    return planes[:, inside]


def surface_weight(
    depth: np.ndarray | None, rows: slice, detail: np.ndarray, workspace: Workspace
) -> np.ndarray:
    """How far rows of pixels lie on a surface that goes on, ``(rows, w)`` in [0, 1].

    Parameters
    ----------
    depth : (h, w) float32 or None
        Where nothing was hit, 0, the weight is 0.
    rows
        Of the frame.
    detail : (n, rows, w) float32
        What is small on such a surface, as the fine part of normals is; may have no planes.
    workspace
        Where the result lies.
    """
    shape = detail.shape[1:]
    weight, square = (workspace.array(name, shape) for name in ("weight", "square"))
    weight.fill(0)
    for plane in detail:
        weight += np.multiply(plane, plane, out=square)
    weight *= np.float32(-1 / BENT**2)
    if depth is None:
        return cv2.exp(weight, dst=weight)
    near, inside = with_halo(rows, 1, len(depth))
    kernel = np.full(3, 1 / 3, np.float32)
    # the inverse is linear on planes; of what was not hit it is 0
    inverse = workspace.array("inverse", (near.stop - near.start, depth.shape[1]))
    hit = depth[near] > 0
    inverse.fill(0)
    np.divide(1, depth[near], out=inverse, where=hit)
    around = workspace.array("around", inverse.shape)
    cv2.sepFilter2D(inverse, -1, kernel, kernel, dst=around, borderType=cv2.BORDER_REPLICATE)
    around *= depth[near]
    around -= 1
    np.clip(around, -1, 1, out=around)  # far beyond what counts, and its square has no bounds
    around *= around
    around *= np.float32(1 / APART**2)
    weight -= around[inside]
    cv2.exp(weight, dst=weight)
    weight *= hit[inside]
    return weight


def _taken(image: np.ndarray, prepared: Prepared, rows: slice, workspace: Workspace) -> np.ndarray:
    """What was taken from rows of pixels, relative to what is left, bounded."""
    shape = (rows.stop - rows.start, image.shape[1])
    left = luminance(image[rows], out=workspace.array("left", shape))
    taken = workspace.array("taken", shape)
    if prepared.remodulation_albedo is None:
        np.copyto(taken, prepared.luminance[rows])
    else:
        luminance(prepared.remodulation_albedo[rows], out=taken)
        with np.errstate(over="ignore"):
            taken *= prepared.luminance[rows]
    return relative(taken, left, prepared.history.exposure)


def relative(light: np.ndarray, left: np.ndarray, exposure: float) -> np.ndarray:
    """What was taken from light ``(h, w)``, by what is left of it, bounded; both are written to."""
    at_most(light, _BRIGHTEST, out=light)
    light -= left
    left += np.float32(DARKEST / exposure)
    light /= left
    return np.clip(light, -MOST_TAKEN, MOST_TAKEN, out=light)


def _slopes(sums: np.ndarray, window: float, strips: Strips, workspace: Workspace) -> np.ndarray:
    """Slopes of what was taken along normals, ``(3, rows, columns)``."""
    _, rows, columns = sums.shape
    wide = workspace.array("wide sums of relief", sums.shape, np.float64)
    slopes = workspace.array("slopes of blocks", (3, rows, columns))

    def fit(some: slice) -> None:
        slopes[:, some] = _fitted(wide[:, some], window)

    widened(sums, window, strips, wide)
    strips.run(fit, rows, columns, pixels=_FITTED)
    return slopes


def _fitted(sums: np.ndarray, window: float) -> np.ndarray:
    """Slopes of lines fitted to sums over windows, ``(16, rows, columns)`` float64; changed."""
    weight = sums[0] + LEAST_WEIGHT
    sums[1:] /= weight
    taken, square, *others, alike = sums[1:]
    means, products, squares = others[:3], others[3:6], others[6:]
    alike /= NEIGHBOURS * (squares[0] + squares[3] + squares[5] + LEAST_EXPLAINED)
    noise = np.maximum(square - taken**2, 0)
    pixels = 4 * np.pi * window**2 * weight
    ridge = noise / (pixels * PRIOR**2) + RIDGE
    matrix = [
        both - means[i] * means[j] + (ridge if i == j else 0)
        for both, (i, j) in zip(squares, PAIRS, strict=True)
    ]
    products = [both - mean * taken for both, mean in zip(products, means, strict=True)]
    slopes = np.stack(solved(matrix, products))
    explained = sum(slope * p for slope, p in zip(slopes, products, strict=True))
    return believed(slopes, explained, 3 * noise / pixels, alike)


def believed(
    slopes: np.ndarray, explained: np.ndarray, by_chance: np.ndarray, alike: np.ndarray
) -> np.ndarray:
    """Slopes less what noise alone would explain, where what they are along is resolved; changed.

    Parameters
    ----------
    slopes : (..., rows, columns)
    explained, by_chance : (rows, columns)
        Variance that they explain, and that noise alone would.
    alike : (rows, columns)
        Correlation of neighbours, see `RESOLVED`.
    """
    slopes *= np.clip(1 - DOUBT * by_chance / (explained + LEAST_EXPLAINED), 0, 1)
    least, most = RESOLVED
    slopes *= np.clip((alike - least) / (most - least), 0, 1)
    return slopes


def solved(matrix: Sequence[Any], right: Sequence[Any]) -> list[Any]:
    """Solutions of three linear equations a block, of arrays or of tensors.

    Parameters
    ----------
    matrix
        Six entries in the order of `PAIRS`, of a matrix whose eigenvalues are the ridge or more.
    right
        Three.
    """
    a, b, c, d, e, f = matrix
    x, y, z = right
    # Cramer's rule
    minors = (d * f - e * e, c * e - b * f, b * e - c * d)
    whole = a * minors[0] + b * minors[1] + c * minors[2]
    last = b * c - a * e
    inverse = (minors, (minors[1], a * f - c * c, last), (minors[2], last, a * d - b * b))
    return [(p * x + q * y + r * z) / whole for p, q, r in inverse]

"""Texture that was filtered away, found again in what the filter took from a frame.

Light is divided by the albedo and by what varnish would add to it, `stillray.stages.demodulate`. Of
a surface without varnish a part of its texture stays in the light then, the more the darker it is,
and where noise hides it the filter takes it away: paintings and cloth look washed out. Of radiance
``(a + v) E``, of albedo ``a``, divided by ``a + s``, the quotient is ``E (1 + (v - s) x)`` with
``x = 1 / (a + s)``: a line. So what the filter took is explained by a line through the fine part of
x, as `stillray.stages.relief` explains it by one through the normals', with the same estimate of
its slope. A picture that has its texture has nothing left that x explains.

The samples that make a frame's light noisy make its albedo noisy, too, where it changes within a
pixel: what the line would explain is their common noise. So the light is that of all frames, and
the albedo is smoothed by its neighbours, the less the more samples it has; of single samples
nothing is put back. Nor is the next frame shown it, whose filter would take its noise for light.
"""

from __future__ import annotations

import cv2
import numpy as np

from stillray.arrays.gain import multiply
from stillray.arrays.strips import STRIP_PIXELS, Strips, with_halo
from stillray.arrays.workspace import Workspace
from stillray.model_spec.loader import ModelSpec
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
from stillray.stages.relief import LEAST_EXPLAINED, believed, relative, surface_weight
from stillray.stages.state import Prepared

FEWEST_SAMPLES = 2.0  # a pixel of a frame, of which anything is put back
FINE = 9  # pixels, odd: from its mean over so many x differs by its fine part
PRIOR = 0.5  # standard deviation of slopes
RIDGE = 1e-3  # mean square of the fine part of x at which a slope is half
#: What each neighbour along an axis weighs in an albedo of one sample; of n samples an nth of it,
#: and nothing where that is less than the second.
SMOOTHED, LEAST_SMOOTHED = 0.25, 1 / 128
#: Pixels, odd: beside an albedo that says nothing, which counts as white, one of several samples is
#: a mean with white.
BESIDE_NONE = 5
LEAST_GAIN, MOST_GAIN = 0.4, 2.0
# Weight, it with what was taken and with its square, with x, with both, with the square of x; x
# with that beside and below
_SUMS = 7


def put_back(
    image: np.ndarray,
    prepared: Prepared,
    spec: ModelSpec,
    weights: np.ndarray | None,
    strips: Strips,
    workspace: Workspace,
) -> np.ndarray:
    """Put a picture's texture back.

    Parameters
    ----------
    image : (h, w, 3) float32
        Radiance that was filtered, finite and >= 0; multiplied by the gain.
    prepared
        The frame it was made of, with albedo, whose samples are known.
    spec
        The model's: the window in which lines are fitted, and what albedo says nothing.
    weights : (h, w) float32 or None
        How far pixels lie on a surface that goes on, where `stillray.stages.relief` has found
        that; changed.
    strips
        Where the work runs.
    workspace
        Where arrays lie from frame to frame.

    Returns
    -------
    (h, w) float32
        The gain, in [`LEAST_GAIN`, `MOST_GAIN`]; 1 where the albedo is even or explains nothing. It
        lies in the workspace.
    """
    height, width = image.shape[:2]
    rows, columns = -(-height // BLOCK), -(-width // BLOCK)
    sums = workspace.array("sums of texture", (_SUMS, rows, columns))
    gain = workspace.array("gain of texture", (height, width))  # the fine part of x, until it is

    def add_up(blocks: slice) -> None:
        some, own = slice(BLOCK * blocks.start, min(BLOCK * blocks.stop, height)), strips.workspace
        weight = _weight(prepared, spec.demodulate.black, weights, some, own)
        _add_up((image, prepared), weight, some, gain[some], sums[:, blocks], own)

    strips.run(add_up, rows, columns, pixels=STRIP_PIXELS // BLOCK**2)
    wide = workspace.array("wide sums of texture", sums.shape, np.float64)
    widened(sums, spec.texture.window, strips, wide)
    slopes = _fitted(wide, spec.texture.window).astype(np.float32)
    found = workspace.array("slopes of texture", (1, BLOCK * rows, BLOCK * columns))
    enlarged(slopes[None], strips, found)

    def tell(some: slice) -> None:
        own = gain[some]
        own *= found[0, some, :width]
        own += 1
        np.clip(own, LEAST_GAIN, MOST_GAIN, out=own)
        multiply(image[some], own, strips.workspace)

    strips.run(tell, height, width)
    return gain


def take_back(output: np.ndarray, gain: np.ndarray, strips: Strips) -> None:
    """Divide what is remembered of a picture, ``(h, w, 4)``, by the gain of `put_back`."""

    def work(rows: slice) -> None:
        workspace = strips.workspace
        part = np.reciprocal(gain[rows], out=workspace.array("inverse gain", gain[rows].shape))
        # alpha of float images is 1: the fourth channel stays as it is
        shape = output[rows].shape
        four = cv2.cvtColor(part, cv2.COLOR_GRAY2RGBA, dst=workspace.array("four", shape))
        cv2.multiply(output[rows], four, dst=output[rows])

    strips.run(work, *gain.shape)


def _weight(
    prepared: Prepared,
    black: float,
    weights: np.ndarray | None,
    rows: slice,
    workspace: Workspace,
) -> np.ndarray:
    """What rows of pixels weigh, ``(rows, w)``: nothing beside an albedo that says nothing."""
    albedo = prepared.albedo
    assert albedo is not None
    if weights is None:
        even = np.empty((0, *albedo[rows].shape[:2]), np.float32)
        weight = surface_weight(prepared.depth, rows, even, workspace)
    else:
        weight = weights[rows]
    near, inside = with_halo(rows, BESIDE_NONE // 2, len(albedo))
    none = cv2.inRange(albedo[near], (-1.0,) * 3, (black,) * 3)
    if cv2.hasNonZero(none):
        beside = cv2.dilate(none, np.ones((BESIDE_NONE, BESIDE_NONE), np.uint8))[inside]
        weight[beside > 0] = 0
    return weight


def _add_up(
    of: tuple[np.ndarray, Prepared],
    weight: np.ndarray,
    rows: slice,
    weighed: np.ndarray,
    sums: np.ndarray,
    workspace: Workspace,
) -> None:
    """Means over blocks of rows into ``(7, rows, columns)``, and the weighed fine part of x."""
    image, prepared = of
    albedo, detail = _fine(prepared, rows, workspace)
    taken = _taken(image, prepared, albedo, rows, workspace)
    inside, places = workspace.array("product", weight.shape), iter(sums)

    def mean(plane: np.ndarray) -> None:
        mean_of_blocks(plane, next(places))

    mean(weight)
    mean(np.multiply(weight, taken, out=inside))
    mean(np.multiply(inside, taken, out=inside))
    mean(np.multiply(weight, detail, out=weighed))
    mean(np.multiply(weighed, taken, out=inside))
    mean(np.multiply(weighed, detail, out=inside))
    mean(with_neighbours(weighed[None], inside, workspace))


def _fine(prepared: Prepared, rows: slice, workspace: Workspace) -> tuple[np.ndarray, np.ndarray]:
    """Rows of what the picture was multiplied by, smoothed, and the fine part of x there."""
    by, samples = prepared.remodulation_albedo, prepared.counts.mean
    assert by is not None
    assert samples is not None
    near, inside = with_halo(rows, FINE // 2 + 1, len(by))
    albedo, border = by[near], cv2.BORDER_REPLICATE
    if share := smoothed(samples):
        kernel = np.array([share, 1 - 2 * share, share], np.float32)
        out = workspace.array("smoothed albedo", albedo.shape)
        albedo = cv2.sepFilter2D(albedo, -1, kernel, kernel, dst=out, borderType=border)
    x = luminance(albedo, out=workspace.array("x", albedo.shape[:2]))
    np.reciprocal(x, out=x)
    kernel, around = np.full(FINE, 1 / FINE, np.float32), workspace.array("around", x.shape)
    # each window is added anew, so that a strip of rows gives what the whole frame gives
    cv2.sepFilter2D(x, -1, kernel, kernel, dst=around, borderType=border)
    x -= around
    return albedo[inside], x[inside]


def smoothed(samples: float) -> float:
    """What each neighbour along an axis weighs in an albedo of so many samples."""
    share = SMOOTHED / max(samples, 1.0)
    return share if share >= LEAST_SMOOTHED else 0.0


def _taken(
    image: np.ndarray, prepared: Prepared, albedo: np.ndarray, rows: slice, workspace: Workspace
) -> np.ndarray:
    """What was taken from rows of the accumulated light, relative to what is left, bounded."""
    light = workspace.array("light", albedo.shape)
    cv2.cvtColor(prepared.mean[rows], cv2.COLOR_RGBA2RGB, dst=light)
    with np.errstate(over="ignore"):
        light *= albedo
    taken = luminance(light, out=workspace.array("taken", albedo.shape[:2]))
    left = luminance(image[rows], out=workspace.array("left", albedo.shape[:2]))
    return relative(taken, left, prepared.history.exposure)


def _fitted(sums: np.ndarray, window: float) -> np.ndarray:
    """Slopes of lines fitted to sums over windows, ``(7, rows, columns)`` float64; changed."""
    weight = sums[0] + LEAST_WEIGHT
    sums[1:] /= weight
    taken, square, x, both, squares, alike = sums[1:]
    alike /= NEIGHBOURS * (squares + LEAST_EXPLAINED)
    noise = np.maximum(square - taken**2, 0)
    pixels = 4 * np.pi * window**2 * weight
    together = both - x * taken
    slopes: np.ndarray = together / (squares - x**2 + noise / (pixels * PRIOR**2) + RIDGE)
    return believed(slopes, slopes * together, noise / pixels, alike)

"""Light of rare samples that was filtered away, put back where many of them agree.

A renderer that clamps nothing writes a few samples that are hundreds of times as bright as the
picture: light of lamps that paths find by chance. Robust filters take each of them for a firefly,
and the picture is left too dark by what they carry together. One sample says nothing of its
surroundings, but of hundreds in a window the mean is known: so what samples stand above the
picture is divided into bands of brightness, the mean of each band is put back as far as it exceeds
its standard error, from the whole window's to that of a smaller one, and the picture multiplied by
what comes of it. The brighter a band, the rarer and the less known: it goes last.

Samples at the rim of a lamp are that lamp's, which the picture shows: what the filter takes from
there says nothing of the walls around it, and the sky behind.

How far a mean that is known to a standard error is believed is Breiman's garrote (1995), as in
`stillray.stages.history_rejection`.
"""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np

from stillray.arrays.gain import multiply_all
from stillray.arrays.strips import STRIP_PIXELS, Strips, with_halo
from stillray.arrays.workspace import Workspace
from stillray.stages.features import luminance

BLOCK = 8  # pixels: sums are taken of blocks
#: Blocks along an edge of the windows in which samples must agree, odd; the last tells most of
#: where the light is.
WINDOWS = (41, 25, 9)
#: Edges of the bands: how far samples stand above the picture, relative to it. Beyond the last
#: a sample counts as that.
BANDS = (8.0, 64.0, 512.0, 4096.0, 32768.0, 1e6)
ERRORS = 2.5  # standard errors by which a mean must differ to count
FEWEST = 7  # samples that stand above: of fewer no mean differs by so many
DARKEST = 0.004  # exposed radiance that is added where relative means relative to it
LEAST = 0.03  # of the picture's light: less is left away, and more loses the less the more it is
MOST = 4.0  # times as bright as it was filtered a picture becomes at most
#: Of a picture's light relative to that around it: beside pixels of as much, `BESIDE` in all along
#: each axis, samples that stand above it are a lamp's.
SHOWN, BESIDE = BANDS[0], 5
_AROUND = np.full(3, 1 / 3, np.float32)  # blocks of which "the picture" is the mean


def restore(
    image: np.ndarray,
    color: np.ndarray,
    exposure: float,
    strips: Strips,
    workspace: Workspace,
    zoom: int = 1,
) -> np.ndarray | None:
    """Put the light of rare samples back into a picture.

    Parameters
    ----------
    image : (zoom h, zoom w, 3) float32
        Radiance that was filtered, finite and >= 0; multiplied by the gain.
    color : (h, w, 3) float32
        The frame it was made of, finite and >= 0.
    exposure
        1 / radiance.
    strips
        Where the work runs.
    workspace
        Where arrays lie from frame to frame.
    zoom
        Pixels of the image for one of the frame, along each axis.

    Returns
    -------
    (zoom h, zoom w) float32 or None
        The gain, in [1, `MOST`], that layers are multiplied by, too; None where too few samples
        stand above the picture. It lies in the workspace.
    """
    height, width = image.shape[:2]
    small = image
    if zoom > 1:
        small = workspace.array("picture of the frame's size", color.shape)
        cv2.resize(image, color.shape[1::-1], dst=small, interpolation=cv2.INTER_AREA)
    found = gains(small, color, exposure, strips, workspace)
    if found is None:
        return None
    gain = workspace.array("gain of rare light", tuple(zoom * BLOCK * size for size in found.shape))
    cv2.resize(found, gain.shape[::-1], dst=gain, interpolation=cv2.INTER_LINEAR)
    gain = gain[:height, :width]
    multiply_all(image, gain, strips)
    return gain


def gains(
    image: np.ndarray, color: np.ndarray, exposure: float, strips: Strips, workspace: Workspace
) -> np.ndarray | None:
    """What the picture is multiplied by at the middles of blocks, ``(rows, columns)`` float32.

    Parameters are those of `restore`; nothing is changed. None where it is 1 everywhere.
    """
    height, width = image.shape[:2]
    rows, columns = -(-height // BLOCK), -(-width // BLOCK)
    picture = workspace.array("picture", (height, width))
    means = workspace.array("picture of blocks", (rows, columns))

    def see(blocks: slice) -> None:
        some = _pixels(blocks, height)
        luminance(image[some], out=picture[some])
        means[blocks] = _block_means(picture[some])

    strips.run(see, rows, columns, pixels=STRIP_PIXELS // BLOCK**2)
    # each window is added anew, here and below: running sums keep a residue of what has passed
    usual = cv2.sepFilter2D(means, -1, _AROUND, _AROUND, borderType=cv2.BORDER_REPLICATE)
    usual += np.float32(DARKEST / exposure)
    around = workspace.array("around of pixels", (rows * BLOCK, columns * BLOCK))
    cv2.resize(usual, around.shape[::-1], dst=around, interpolation=cv2.INTER_LINEAR)
    kept, usually = (workspace.array(name, (rows, columns)) for name in ("kept", "usually"))

    def compare(blocks: slice) -> tuple[np.ndarray, np.ndarray]:
        some = _pixels(blocks, height)
        above = strips.workspace.array("above", picture[some].shape)
        luminance(color[some], out=above)
        above -= picture[some]
        above /= around[some, :width]
        wider, inside = with_halo(some, BESIDE // 2, height)
        relative = strips.workspace.array("relative", picture[wider].shape)
        np.divide(picture[wider], around[wider, :width], out=relative)
        shown = cv2.dilate(relative, np.ones((BESIDE, BESIDE), np.uint8))[inside]
        far = np.flatnonzero((above > BANDS[0]) & (shown < SHOWN))
        values = above.reshape(-1)[far]
        cv2.threshold(above, BANDS[0], 0, cv2.THRESH_TRUNC, dst=above)
        usually[blocks] = _block_means(above)
        kept[blocks] = _block_means(relative[inside])
        down, across = np.divmod(far, width)
        return columns * (blocks.start + down // BLOCK) + across // BLOCK, values

    parts = strips.run(compare, rows, columns, pixels=STRIP_PIXELS // BLOCK**2)
    places, values = (np.concatenate(each) for each in zip(*parts, strict=True))
    if len(places) < FEWEST:
        return None
    counts = _block_counts(height, width)
    pixels = [_summed(counts, side) for side in WINDOWS]
    missing = _in_bands(places, np.minimum(values, BANDS[-1]), pixels)
    own, least = (_summed(plane * counts, WINDOWS[-1]) / pixels[-1] for plane in (kept, usually))
    # the picture has it already where samples that are not rare are darker than it
    missing += np.minimum(least, 0)
    missing /= own
    if missing.max() <= LEAST:
        return None
    more = np.clip(missing, LEAST, MOST - 1)
    gain: np.ndarray = 1 + more - LEAST**2 / more
    return gain.astype(np.float32)


def _in_bands(places: np.ndarray, values: np.ndarray, pixels: list[np.ndarray]) -> np.ndarray:
    """Mean light above `BANDS` that is believed, relative to the picture, ``(rows, columns)``.

    Parameters
    ----------
    places, values : (n,)
        Blocks of samples that stand above the picture, and by how much, relative to it.
    pixels : (rows, columns) each
        Of each of `WINDOWS` around each block.
    """
    shape = pixels[0].shape
    total = np.zeros(shape)
    for low, high in pairwise(BANDS):
        there = values > low
        if not there.any():
            break
        light = np.minimum(values[there], high).astype(np.float64) - low
        sums = np.bincount(places[there], light, shape[0] * shape[1]).reshape(shape)
        total += _believed(sums, pixels)
    return total


def _believed(sums: np.ndarray, pixels: list[np.ndarray]) -> np.ndarray:
    """A band's mean: the widest window's, then what the next tell better, as far as they differ."""
    mean, square = np.zeros_like(sums), np.zeros_like(sums)
    # blocks are what varies: a sample that a pixel filter spreads over pixels is one
    squares = sums * sums
    for side, count in zip(WINDOWS, pixels, strict=True):
        new, spread = _summed(sums, side) / count, _summed(squares, side) / count
        # a window without bright samples knows no better than its surroundings how they vary
        square = np.maximum(spread, square)
        apart = new - mean
        doubt = ERRORS**2 * square / count
        sure = np.square(apart)
        share = np.zeros_like(mean)
        np.divide(sure - doubt, sure, out=share, where=sure > doubt)
        mean += share * apart
        square = spread
    return mean


def _pixels(blocks: slice, height: int) -> slice:
    return slice(BLOCK * blocks.start, min(BLOCK * blocks.stop, height))


def _block_means(plane: np.ndarray) -> np.ndarray:
    """Of an ``(h, w)`` plane, ``(rows, columns)``; the border goes on."""
    bottom, right = (-size % BLOCK for size in plane.shape)
    if bottom or right:
        plane = cv2.copyMakeBorder(plane, 0, bottom, 0, right, cv2.BORDER_REPLICATE)
    size = (plane.shape[1] // BLOCK, plane.shape[0] // BLOCK)
    means: np.ndarray = cv2.resize(plane, size, interpolation=cv2.INTER_AREA)
    return means


def _block_counts(height: int, width: int) -> np.ndarray:
    """Pixels of each block."""
    down, across = (np.minimum(BLOCK, size - np.arange(0, size, BLOCK)) for size in (height, width))
    counts: np.ndarray = np.outer(down, across).astype(np.float64)
    return counts


def _summed(plane: np.ndarray, side: int) -> np.ndarray:
    """Sums over windows of so many blocks; beyond the frame is nothing."""
    ones, border = np.ones(side), cv2.BORDER_CONSTANT
    sums: np.ndarray = cv2.sepFilter2D(plane, cv2.CV_64F, ones, ones, borderType=border)
    return sums

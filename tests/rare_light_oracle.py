"""`stillray.stages.rare_light` in float64, by loops over blocks."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from stillray.stages import rare_light

_REC709 = np.array([0.2126, 0.7152, 0.0722])


def gain_of(image: np.ndarray, color: np.ndarray, exposure: float, zoom: int = 1) -> np.ndarray:
    """The gain at every pixel of the image; arrays as `rare_light.restore` takes them."""
    height, width = color.shape[:2]
    given, image = image, np.zeros((height, width, 3))
    for y, x in np.ndindex(height, width):
        image[y, x] = given[zoom * y : zoom * (y + 1), zoom * x : zoom * (x + 1)].mean((0, 1))
    picture, samples = (each.astype(np.float64) @ _REC709 for each in (image, color))
    means = _blocks(picture, beyond=True) / rare_light.BLOCK**2
    padded = np.pad(means, 1, mode="edge")
    usual = np.zeros_like(means)
    for r, c in np.ndindex(*means.shape):
        usual[r, c] = padded[r : r + 3, c : c + 3].mean() + rare_light.DARKEST / exposure
    near = _enlarged(usual)[:height, :width]
    above = (samples - picture) / near
    counted = above.copy()
    reach = rare_light.BESIDE // 2
    for y, x in np.ndindex(height, width):
        beside = np.s_[max(y - reach, 0) : y + reach + 1, max(x - reach, 0) : x + reach + 1]
        if (picture[beside] / near[beside]).max() >= rare_light.SHOWN:
            counted[y, x] = 0  # of a lamp that the picture shows
    if (counted > rare_light.BANDS[0]).sum() < rare_light.FEWEST:
        return np.ones(given.shape[:2])
    counts = _blocks(np.ones((height, width)))
    missing = np.zeros_like(means)
    for low, high in pairwise(rare_light.BANDS):
        missing += _believed(np.clip(counted, low, high) - low, counts)
    last = rare_light.WINDOWS[-1]
    kept, least = (
        _wide(_blocks(plane, beyond=True) / rare_light.BLOCK**2 * counts, last)
        / _wide(counts, last)
        for plane in (picture / near, np.minimum(above, rare_light.BANDS[0]))
    )
    more = np.minimum((missing + np.minimum(least, 0)) / kept, rare_light.MOST - 1)
    gain = np.ones_like(more)
    counts_for = more > rare_light.LEAST
    gain[counts_for] += more[counts_for] - rare_light.LEAST**2 / more[counts_for]
    return _enlarged(gain, zoom)[: given.shape[0], : given.shape[1]]


def _believed(light: np.ndarray, counts: np.ndarray) -> np.ndarray:
    believed, before = np.zeros_like(counts), np.zeros_like(counts)
    for window in rare_light.WINDOWS:
        pixels = _wide(counts, window)
        mean, square = (_wide(_blocks(light) ** power, window) / pixels for power in (1, 2))
        doubt = rare_light.ERRORS**2 * np.maximum(square, before) / pixels
        apart = mean - believed
        for place in np.ndindex(*counts.shape):
            if apart[place] ** 2 > doubt[place]:
                believed[place] += (1 - doubt[place] / apart[place] ** 2) * apart[place]
        before = square
    return believed


def _blocks(plane: np.ndarray, *, beyond: bool = False) -> np.ndarray:
    """Sums over blocks; of pixels beyond the frame, too, if the border is to go on."""
    side = rare_light.BLOCK
    sticks_out = [(0, -size % side) for size in plane.shape]
    padded = np.pad(plane, sticks_out, mode="edge") if beyond else np.pad(plane, sticks_out)
    sums = np.zeros([size // side for size in padded.shape])
    for r, c in np.ndindex(*sums.shape):
        sums[r, c] = padded[r * side : (r + 1) * side, c * side : (c + 1) * side].sum()
    return sums


def _wide(blocks: np.ndarray, window: int) -> np.ndarray:
    """Sums over windows of blocks; beyond the frame is nothing."""
    reach, sums = window // 2, np.zeros_like(blocks)
    for r, c in np.ndindex(*blocks.shape):
        rows = slice(max(r - reach, 0), r + reach + 1)
        sums[r, c] = blocks[rows, max(c - reach, 0) : c + reach + 1].sum()
    return sums


def _enlarged(blocks: np.ndarray, zoom: int = 1) -> np.ndarray:
    """Linear between the middles of blocks; beyond the outermost they go on."""
    side = zoom * rare_light.BLOCK
    padded = np.pad(blocks, 1, mode="edge")
    result = np.zeros([size * side for size in blocks.shape])
    for y, x in np.ndindex(*result.shape):
        down, right = ((place + 0.5) / side + 0.5 for place in (y, x))
        top, left = int(down), int(right)
        upper, lower = (
            padded[row, left] + (right - left) * (padded[row, left + 1] - padded[row, left])
            for row in (top, top + 1)
        )
        result[y, x] = upper + (down - top) * (lower - upper)
    return result

"""`stillray.stages.texture` pixel by pixel and block by block, in float64."""

from __future__ import annotations

import numpy as np

from stillray.stages import block_sums, relief
from stillray.stages import texture as stage

SHARES = np.array([0.2126, 0.7152, 0.0722])


def texture_gain(image, prepared, black: float, window: float) -> np.ndarray:
    """The gain of `stages.texture.put_back`, ``(h, w)``."""
    height, width = image.shape[:2]
    weight, fine, taken = (np.zeros((height, width)) for _ in range(3))
    albedo = _smoothed(prepared.remodulation_albedo.astype(np.float64), prepared.counts.mean)
    x = 1 / (albedo @ SHARES)
    dark = relief.DARKEST / prepared.history.exposure
    for place in np.ndindex(height, width):
        weight[place] = _weight(prepared, place, black)
        fine[place] = x[place] - _around(x, place, stage.FINE // 2).mean()
        left = image[place] @ SHARES
        now = (prepared.mean[place][:3] * albedo[place]) @ SHARES
        taken[place] = np.clip((now - left) / (left + dark), -1, 1)
    size = block_sums.BLOCK
    blocks = (-(-height // size), -(-width // size))
    slopes = np.zeros(blocks)
    for block in np.ndindex(*blocks):
        slopes[block] = _slope(fine, weight, taken, block, window)
    gain = np.zeros((height, width))
    for y, x_ in np.ndindex(height, width):
        slope = 0.0
        for row, down in _shares(y, blocks[0]):
            for column, right in _shares(x_, blocks[1]):
                slope += down * right * slopes[row, column]
        gain[y, x_] = 1 + slope * weight[y, x_] * fine[y, x_]
    return np.clip(gain, stage.LEAST_GAIN, stage.MOST_GAIN)


def _around(plane: np.ndarray, place: tuple[int, int], reach: int) -> np.ndarray:
    """The pixels of a window, the border repeated."""
    rows, columns = (
        np.clip(np.arange(at - reach, at + reach + 1), 0, length - 1)
        for at, length in zip(place, plane.shape, strict=False)
    )
    return plane[np.ix_(rows, columns)]


def _smoothed(albedo: np.ndarray, samples: float) -> np.ndarray:
    share = stage.SMOOTHED / max(samples, 1)
    if share < stage.LEAST_SMOOTHED:
        return albedo
    line = np.array([share, 1 - 2 * share, share])
    result = np.zeros_like(albedo)
    for place in np.ndindex(albedo.shape[:2]):
        result[place] = np.einsum("a,b,abc->c", line, line, _around(albedo, place, 1))
    return result


def _weight(prepared, place: tuple[int, int], black: float) -> float:
    y, x = place
    reach = stage.BESIDE_NONE // 2
    beside = prepared.albedo[max(y - reach, 0) : y + reach + 1, max(x - reach, 0) : x + reach + 1]
    if (beside <= black).all(axis=-1).any():
        return 0.0
    exponent = 0.0
    if prepared.normal is not None:
        for axis in range(3):
            own = prepared.normal[..., axis].astype(np.float64)
            exponent += (own[place] - _around(own, place, relief.FINE // 2).mean()) ** 2
    weight = np.exp(-exponent / relief.BENT**2)
    if prepared.depth is None:
        return weight
    depth = prepared.depth.astype(np.float64)
    if depth[place] == 0:
        return 0.0
    near = _around(depth, place, 1)
    inverse = np.divide(1, near, where=near > 0, out=np.zeros_like(near))
    return weight * np.exp(-(((inverse.mean() * depth[place] - 1) / relief.APART) ** 2))


def _shares(at: int, count: int) -> list[tuple[int, float]]:
    """Blocks between whose middles a pixel lies, and what they weigh."""
    place = min(max((at + 0.5) / block_sums.BLOCK - 0.5, 0), count - 1)
    first = int(place)
    return [(first, first + 1 - place), (min(first + 1, count - 1), place - first)]


def _slope(fine, weight, taken, block: tuple[int, int], window: float) -> float:
    """Of one block: pixels weighed by how far their block is, a Gaussian of block to block."""
    size, sigma = block_sums.BLOCK, window / block_sums.BLOCK
    reach = int(np.ceil(3 * sigma))
    line = np.exp(-(np.arange(-reach, reach + 1) ** 2) / (2 * sigma**2))
    line /= line.sum()
    height, width = weight.shape
    near = np.zeros((height, width))
    for y, x in np.ndindex(height, width):
        far = y // size - block[0], x // size - block[1]
        if max(map(abs, far)) <= reach:
            near[y, x] = line[far[0] + reach] * line[far[1] + reach] / size**2
    share = near * weight
    total = share.sum() + block_sums.LEAST_WEIGHT
    mean = {
        name: (share * plane).sum() / total
        for name, plane in {
            "t": taken, "tt": taken**2, "x": fine, "xt": fine * taken, "xx": fine**2,
        }.items()
    }  # fmt: skip
    alike, weighed = 0.0, weight * fine
    for y, x in np.ndindex(height, width):
        if x + 1 < width:
            alike += near[y, x] * weighed[y, x] * weighed[y, x + 1]
        if y + 1 < height and y % size != size - 1:
            alike += near[y, x] * weighed[y, x] * weighed[y + 1, x]
    alike /= total * (2 - 1 / size) * (mean["xx"] + relief.LEAST_EXPLAINED)
    noise = max(mean["tt"] - mean["t"] ** 2, 0)
    pixels = 4 * np.pi * window**2 * total
    together = mean["xt"] - mean["x"] * mean["t"]
    ridge = noise / (pixels * stage.PRIOR**2) + stage.RIDGE
    slope = together / (mean["xx"] - mean["x"] ** 2 + ridge)
    by_chance = relief.DOUBT * noise / pixels / (slope * together + relief.LEAST_EXPLAINED)
    least, most = relief.RESOLVED
    resolved = np.clip((alike - least) / (most - least), 0, 1)
    return slope * np.clip(1 - by_chance, 0, 1) * resolved

"""Nonlinearly weighted first-order regression (Bitterli et al. 2016), for comparison: NFOR.

A frame comes in two halves of its samples. Around every pixel each half is fitted by a plane in the
features, with weights of non-local means from the other half, so that what is fitted and what
weighs it have independent noise; all fits that reach a pixel are averaged. That is done with two
bandwidths, of which each pixel takes the one of less error, which the halves tell, too; and the
mean of both halves is filtered once more.

differs: features have no halves here and no variance, so they are not filtered beforehand
(section 5.1). Variance is that of the two halves, a mean over the patch, where renderers give one
of samples. Distances of patches are means over channels (Rousselle et al. 2012).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from stillray.errors import InputError
from stillray.frame import Frame
from stillray.stages.features import depth_scale
from stillray.stages.repair import repair_feature, repair_radiance
from stillray_training.peers.sequence import MAX_DEPTH

_MAX_DISTANCE = 1e4  # of two pixels in units of their variance: beyond it they are just different
_LEAST_OWN = 1e-4  # weight of a pixel in its own fit
_RIDGE = 1e-6  # share of the normal matrix's mean diagonal: features may be constant in a window
_EPSILON = 1e-7  # radiance squared: keeps 0 / 0 out where variance is 0
_MAX_RADIANCE = 1e9  # squares of squares stay in float64 with room for sums


@dataclass(frozen=True, kw_only=True)
class NforOptions:
    """Parameters as published (section 5)."""

    window: int = 9  # pixels to each side that a fit takes in, >= 1
    patch: int = 3  # pixels to each side of the patches that are compared, >= 0
    bandwidths: tuple[float, float] = (0.5, 1.0)  # of the first filtering, > 0
    last_bandwidth: float = 1.0  # of the second
    error_patch: int = 1  # patches by which errors and choices are smoothed


@dataclass(frozen=True, kw_only=True, eq=False)
class Neighbours:
    """One offset: pixels, their neighbours there, and how alike the two are.

    Attributes
    ----------
    down, right
        From pixel to neighbour.
    here, there
        Rows and columns of the pixels that have this neighbour, and of the neighbours.
    weight : (h, w) float64
        Of those pixels, in [0, 1].
    """

    down: int
    right: int
    here: tuple[slice, slice]
    there: tuple[slice, slice]
    weight: np.ndarray


def neighbours(
    guide: np.ndarray, variance: np.ndarray, window: int, patch: int, bandwidth: float
) -> Iterator[Neighbours]:
    """Weights of non-local means, one offset after the other (Rousselle et al. 2012, eq. 2 to 4).

    Parameters
    ----------
    guide : (h, w, c) float64
        What patches are compared in.
    variance : (h, w, c) float64
        Of the guide, >= 0.
    window, patch
        As `NforOptions` has them.
    bandwidth
        Standard deviations that patches may differ by.
    """
    height, width = guide.shape[:2]
    for down in range(-window, window + 1):
        for right in range(-window, window + 1):
            if abs(down) >= height or abs(right) >= width:
                continue
            here = _overlap(height, down), _overlap(width, right)
            there = _overlap(height, -down), _overlap(width, -right)
            own, other = variance[here], variance[there]
            apart = (guide[here] - guide[there]) ** 2 - (own + np.minimum(own, other))
            apart /= _EPSILON + bandwidth**2 * (own + other)
            distance = _box_mean(np.minimum(apart, _MAX_DISTANCE).mean(-1), patch)
            weight = np.exp(-np.maximum(distance, 0))
            if down == right == 0:
                np.maximum(weight, _LEAST_OWN, out=weight)
            yield Neighbours(down=down, right=right, here=here, there=there, weight=weight)


def _overlap(size: int, step: int) -> slice:
    """Places from which a step stays within the size."""
    return slice(max(0, -step), size - max(0, step))


def _box_mean(plane: np.ndarray, reach: int) -> np.ndarray:
    """Mean over a square of pixels, of those that there are."""
    side = (2 * reach + 1, 2 * reach + 1)
    sums, counts = (
        cv2.boxFilter(values, cv2.CV_64F, side, normalize=False, borderType=cv2.BORDER_CONSTANT)
        for values in (plane, np.ones_like(plane))
    )
    mean: np.ndarray = sums / counts
    return mean


def nl_means(
    image: np.ndarray, guide: np.ndarray, variance: np.ndarray, window: int, patch: int
) -> np.ndarray:
    """An image ``(h, w, c)`` averaged by how alike patches of the guide are, bandwidth 1."""
    total, weights = np.zeros_like(image), np.zeros(image.shape[:2])
    for one in neighbours(guide, variance, window, patch, 1.0):
        total[one.here] += one.weight[..., None] * image[one.there]
        weights[one.here] += one.weight
    mean: np.ndarray = total / weights[..., None]
    return mean


def collaborative_regression(
    image: np.ndarray,
    features: np.ndarray,
    guide: np.ndarray,
    variance: np.ndarray,
    options: NforOptions,
    bandwidth: float,
) -> np.ndarray:
    """Fit a window around every pixel, and average all fits that reach a pixel (section 4.3).

    Parameters
    ----------
    image : (h, w, 3) float64
        What is fitted.
    features : (h, w, n) float64
        What it is fitted by, beside a constant and the place.
    guide, variance : (h, w, 3) float64
        What weighs the pixels, see `neighbours`.
    options
        Window and patch.
    bandwidth
        See `neighbours`.

    Returns
    -------
    (h, w, 3) float64
    """
    window, (height, width) = options.window, image.shape[:2]
    count = 3 + features.shape[2]
    # planes, so that a pair of them and their product lie in the cache
    planes = np.ascontiguousarray(np.moveaxis(features, -1, 0))
    light = np.ascontiguousarray(np.moveaxis(image, -1, 0))
    normal = np.zeros((count, count, height, width))
    right_side = np.zeros((count, 3, height, width))
    found = list(neighbours(guide, variance, window, options.patch, bandwidth))
    for one in found:
        rows = _design(planes, one, window)
        for i, row in enumerate(rows):
            weighed = one.weight * row
            for j in range(i, count):
                normal[i, j][one.here] += weighed * rows[j]
            for channel in range(3):
                right_side[i, channel][one.here] += weighed * light[channel][one.there]
    fits = _solved(normal, right_side)
    total, weights = np.zeros_like(light), np.zeros((height, width))
    for one in found:
        rows = _design(planes, one, window)
        for channel in range(3):
            fit = sum(row * fits[i, channel][one.here] for i, row in enumerate(rows))
            total[channel][one.there] += one.weight * fit
        weights[one.there] += one.weight
    mean: np.ndarray = np.moveaxis(total / weights, 0, -1)
    return mean


def _design(planes: np.ndarray, one: Neighbours, window: int) -> list[np.ndarray]:
    """Columns of the design matrix: a constant, the step, the differences of features."""
    ones = np.ones(one.weight.shape)
    steps = [ones, ones * (one.right / window), ones * (one.down / window)]
    return steps + [plane[one.there] - plane[one.here] for plane in planes]


def _solved(normal: np.ndarray, right_side: np.ndarray) -> np.ndarray:
    """Coefficients ``(n, 3, h, w)``, of the upper half of a normal matrix ``(n, n, h, w)``."""
    count = len(normal)
    upper = np.moveaxis(normal, (0, 1), (2, 3))
    matrix = upper + np.swapaxes(np.triu(upper, 1), 2, 3)
    ridge = _RIDGE * np.trace(matrix, axis1=2, axis2=3) / count
    matrix += ridge[..., None, None] * np.eye(count)
    fits = np.linalg.solve(matrix, np.moveaxis(right_side, (0, 1), (2, 3)))
    return np.ascontiguousarray(np.moveaxis(fits, (2, 3), (0, 1)))


def nfor(
    first: np.ndarray,
    second: np.ndarray,
    features: np.ndarray,
    options: NforOptions = NforOptions(),
) -> np.ndarray:
    """Filter two halves of a frame's samples (section 5).

    Parameters
    ----------
    first, second : (h, w, 3) float64
        Radiance of independent samples, as many each, finite.
    features : (h, w, n) float64
        About 1 in size.
    options
        Parameters.

    Returns
    -------
    (h, w, 3) float64
        Radiance; where a fit overshoots, below 0.
    """
    variance = _variance_of_half(first, second, options.patch)
    pairs, errors = [], []
    for bandwidth in options.bandwidths:
        pair = [
            collaborative_regression(image, features, guide, variance, options, bandwidth)
            for image, guide in ((first, second), (second, first))
        ]
        pairs.append(pair)
        errors.append(estimated_error(first, second, pair, variance))
    mean = (first + second) / 2

    def smoothed(image: np.ndarray) -> np.ndarray:
        return nl_means(image, mean, variance / 2, options.window, options.error_patch)

    narrow, wide = (smoothed(error) for error in errors)
    share = smoothed((wide < narrow).astype(np.float64))
    chosen = [a + share * (b - a) for a, b in zip(*pairs, strict=True)]
    both = (chosen[0] + chosen[1]) / 2
    left = (chosen[0] - chosen[1]) ** 2 / 4
    return collaborative_regression(both, features, both, left, options, options.last_bandwidth)


def _variance_of_half(first: np.ndarray, second: np.ndarray, patch: int) -> np.ndarray:
    """Of one half, from the difference of both, a mean over the patch."""
    squares = (first - second) ** 2 / 2
    return np.dstack([_box_mean(plane, patch) for plane in np.moveaxis(squares, -1, 0)])


def estimated_error(
    first: np.ndarray, second: np.ndarray, filtered: list[np.ndarray], variance: np.ndarray
) -> np.ndarray:
    """Mean squared error of the mean of both filtered halves, noisy (section 5.3).

    A filtered half has no noise of the other one, so that their squared difference is the error
    and the other's variance; their mean has less of what is left of noise.
    """
    own = ((second - filtered[0]) ** 2 + (first - filtered[1]) ** 2) / 2 - variance
    error: np.ndarray = own - (filtered[0] - filtered[1]) ** 2 / 4
    return error


class Nfor:
    """`nfor` on frames of two halves; remembers nothing.

    Parameters
    ----------
    options
        Parameters.
    """

    def __init__(self, options: NforOptions | None = None) -> None:
        self._options = options or NforOptions()

    def denoise(self, frame: Frame) -> np.ndarray:
        """Denoise a frame: radiance ``(h, w, 3)`` float32, >= 0.

        Raises
        ------
        InputError
            The frame has no second half.
        """
        if frame.color_b is None:
            raise InputError("frame must have color_b, a second half of its samples, for nfor")
        first, second = (
            np.minimum(repair_radiance(color)[0].astype(np.float64), _MAX_RADIANCE)
            for color in (frame.color, frame.color_b)
        )
        image = nfor(first, second, features_of(frame), self._options)
        return np.maximum(image, 0).astype(np.float32)


def features_of(frame: Frame) -> np.ndarray:
    """Albedo, normal and depth over its mean, ``(h, w, n)`` float64, of those that there are."""
    planes = [np.zeros((*frame.shape, 0))]
    if frame.albedo is not None:
        planes.append(repair_feature(frame.albedo, 0, 1))
    if frame.normal is not None:
        planes.append(repair_feature(frame.normal, -1, 1))
    if frame.depth is not None:
        depth = repair_feature(frame.depth, 0, MAX_DEPTH)
        planes.append((depth / np.float32(depth_scale(depth)))[..., None])
    return np.concatenate(planes, -1, dtype=np.float64)

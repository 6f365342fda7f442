"""History rejection: where the past disagrees with this frame by more than noise can, let it go.

Geometry tells whether a pixel shows the surface that it showed before, not whether that surface is
still lit as it was: shadows and reflections move over surfaces that stay, lamps are switched. What
the past says is compared with what the frame's samples say, over windows of 2 to 96 pixels, in
units of the standard error of their difference; so a quiet frame notices small changes, and a noisy
one large ones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.bounds import at_least, at_most
from stillray.arrays.strips import Strips, with_halo
from stillray.arrays.workspace import Workspace
from stillray.stages.accumulate import DARK, MIN_WEIGHT
from stillray.stages.features import luminance_of_planes

#: Planes that `compare` fills: weight, and weighted difference, light, variance.
PLANES = 4
_LEVELS = 5  # blocks of 2, 4, 8, 16, 32 pixels; windows are single blocks of 2, and 3x3 blocks
#: Standard errors that a difference must exceed, from windows of one block of 2x2 pixels to 3x3
#: blocks of 32x32. Of M independent normal differences the largest is about sqrt(2 ln M) (Donoho
#: and Johnstone 1994); M windows fill 1280x720 pixels. One more, since noise is not normal; but not
#: for windows of 12 pixels, by which the shadows of moving things are noticed first.
THRESHOLDS = (6.0, 5.5, 4.1, 4.8, 4.4, 4.0)
_WINDOW = 3  # blocks
_NOISE_LEVEL = 3  # blocks of 16 pixels
_NOISE_FRAMES = 8
# Share of the light that interpolation, rounding and filters of a renderer may change.
_SYSTEMATIC = np.float32(0.01)
# Samples that a window counts as at most: robust weights are not free of bias.
_MOST_SAMPLES = np.float32(1500)
# Pixels over which the network will average noise: a bias is as bad as noise so much smaller.
_FILTERED = np.float32(100)
_LEAST_WEIGHT = np.float32(1e-3)  # of a window's pixels, below which it says nothing
_BRIGHTEST = np.float32(1e9)  # exposed: its square, summed, stays in range
_BESSEL = np.float32(4 / 3)  # of variances within four pixels


@dataclass(frozen=True, kw_only=True, eq=False)
class Noise:
    """Variance of one sample, by blocks of 16x16 pixels: rare bright samples show over frames.

    Attributes
    ----------
    variance : (rows, columns) float32
        Of exposed irradiance luminance.
    exposure
        1 / irradiance.
    frames
        That it is a mean of, `_NOISE_FRAMES` at most.
    """

    variance: np.ndarray
    exposure: float
    frames: int = 1


def compare(
    light: np.ndarray,
    weight: np.ndarray,
    past: np.ndarray,
    exposure: float,
    out: np.ndarray,
    workspace: Workspace,
) -> None:
    """Reduce the difference between a frame's samples and its past to blocks of 2x2 pixels.

    A pixel's difference ``d`` counts with ``a = w n / (n + 1)``, the reciprocal of its variance in
    units of a sample's, where ``w`` is the weight of the sample and ``n`` the samples of the past.
    The past is a mean with the same weights, so that ``w d`` is 0 on average if nothing changed,
    however long the tail of the noise is.

    Parameters
    ----------
    light : (h, w) float32
        Luminance of irradiance of some rows, from an even one on.
    weight : (h, w) float32
        See `stillray.stages.accumulate.sample_weight`; 0 where a sample says nothing.
    past : (4, h, w) float32
        Reprojected irradiance and samples.
    exposure
        1 / irradiance.
    out : (PLANES, ceil(h / 2), ceil(w / 2)) float32
        Means over blocks of ``a``, ``a d``, ``a x`` where ``x`` is the exposed light, and ``a``
        times the variance of a sample, by the covariance of ``d`` and ``x`` within the block: what
        is lit unevenly and stays so is in ``x`` and not in ``d``.
    workspace
        Where temporaries lie.
    """
    shape = light.shape
    even = (shape[0] + shape[0] % 2, shape[1] + shape[1] % 2)
    planes = workspace.array("compared", (5, *even))
    if even != shape:
        planes.fill(0)
    counted, difference, shown = planes[:3, : shape[0], : shape[1]]
    temporary = planes[4, : shape[0], : shape[1]]
    scale = np.float32(exposure)
    with np.errstate(over="ignore"):
        np.multiply(light, scale, out=shown)
        if weight.min() < MIN_WEIGHT:  # as `stillray.stages.accumulate.clamp_fireflies` does
            shown *= at_most(weight, MIN_WEIGHT, out=temporary) / np.float32(MIN_WEIGHT)
        before = luminance_of_planes(past, out=difference)
        before *= scale
    at_most(shown, _BRIGHTEST, out=shown)
    at_most(before, _BRIGHTEST, out=before)
    np.subtract(shown, before, out=difference)
    samples = past[3]
    np.add(samples, 1, out=temporary)
    np.divide(samples, temporary, out=counted)
    at_least(weight, MIN_WEIGHT, out=temporary)
    counted *= temporary
    if weight.min() <= 0:
        counted[weight <= 0] = 0
    size = (even[1] // 2, even[0] // 2)

    def reduced(plane: np.ndarray, target: np.ndarray | None = None) -> np.ndarray:
        return cv2.resize(plane, size, dst=target, interpolation=cv2.INTER_AREA)

    held, apart, lit, variance = out
    reduced(planes[0], held)
    planes[1] *= planes[0]
    reduced(planes[1], apart)
    np.multiply(planes[1], planes[2], out=planes[3])
    reduced(planes[3], variance)
    planes[2] *= planes[0]
    reduced(planes[2], lit)
    # a E[d x] - (a d) (a x) / a
    blocks = workspace.array("blocks", lit.shape)
    at_least(held, _LEAST_WEIGHT, out=blocks)
    np.divide(lit, blocks, out=blocks)
    blocks *= apart
    variance -= blocks
    variance *= _BESSEL


def confidence(
    blocks: np.ndarray,
    noise: Noise | None,
    motion: np.ndarray,
    exposure: float,
    strips: Strips,
    thresholds: Sequence[float] = THRESHOLDS,
) -> tuple[np.ndarray | None, Noise]:
    """How far the past can be trusted, by its bias.

    The bias is found by shrinkage from coarse windows to fine ones: a window's difference corrects
    what coarser windows found by ``r (1 - (k s / r)^2)+`` where ``r`` is what it differs from that
    by, ``s`` its standard error and ``k`` the threshold (the non-negative garrote, Gao 1998). A
    past of ``n`` samples of variance ``v`` and bias ``b`` knows no more than
    ``n / (1 + n m b^2 / v)`` samples without one, if ``m`` pixels are averaged: the share of ``n``
    that this leaves is the confidence.

    Parameters
    ----------
    blocks : (PLANES, rows, columns) float32
        What `compare` gave.
    noise
        What the last call gave, or None.
    motion : (h, w, 2) float32
        Pixels, finite.
    exposure
        1 / irradiance.
    strips
        Where the work runs, and is looked at.
    thresholds
        In the order of `THRESHOLDS`.

    Returns
    -------
    confidence : (h, w) float32 or None
        In [0, 1]; None where all of the past holds.
    noise
        For the next frame.
    """
    look = strips.watch.look
    pyramid = [blocks]
    while len(pyramid) < _LEVELS and min(pyramid[-1].shape[1:]) > 1:
        pyramid.append(_halved(pyramid[-1], look))
    lowest = min(_NOISE_LEVEL, len(pyramid) - 1)
    window = _Window.around(pyramid[lowest], lowest, strips)
    noise = _follow_noise(noise, window, motion, exposure, lowest)
    usual = np.maximum(noise.variance, window.variance)
    bias = np.zeros(pyramid[-1].shape[1:], np.float32)
    for level in reversed(range(len(pyramid))):
        shape = pyramid[level].shape[1:]
        window = _Window.around(pyramid[level], level, strips)
        at_level = _at_level(usual, lowest, level, shape)
        look()
        bias = _doubled(bias, shape)
        bias = _corrected(bias, window, at_level, thresholds[level + 1], strips)
    look()
    kept = _confidence_of_blocks(blocks, bias, window, at_level, thresholds[0], strips)
    if kept is None:
        return None, noise
    by_pixel = strips.workspace.array("confidence", motion.shape[:2])
    return _by_pixel(kept, by_pixel, strips), noise


@dataclass(frozen=True, kw_only=True, eq=False)
class _Window:
    """What windows say: samples that they count as, difference, light and variance of a sample."""

    samples: np.ndarray
    difference: np.ndarray
    light: np.ndarray
    variance: np.ndarray

    @staticmethod
    def around(planes: np.ndarray, level: int, strips: Strips) -> _Window:
        """Windows of 3x3 blocks."""
        # Outside of the frame there are no samples. OpenCV carries the sums of columns on from row
        # to row: planes are blurred as a whole, so that a picture does not depend on strips.
        size, border = (_WINDOW, _WINDOW), cv2.BORDER_CONSTANT
        blurred = []
        for plane in planes:
            blurred.append(cv2.blur(plane, size, borderType=border))
            strips.watch.look()
        held, difference, light, variance = blurred
        count = np.float32(_WINDOW**2 * (4 << 2 * level))

        def work(rows: slice) -> None:
            share = np.reciprocal(at_least(held[rows], _LEAST_WEIGHT))
            for mean in (difference, light, variance):
                mean[rows] *= share
            at_least(variance[rows], 0, out=variance[rows])
            held[rows] *= count

        strips.run(work, *held.shape)
        return _Window(samples=held, difference=difference, light=light, variance=variance)

    def of(self, rows: slice) -> _Window:
        """Some rows of them."""
        return _Window(
            samples=self.samples[rows],
            difference=self.difference[rows],
            light=self.light[rows],
            variance=self.variance[rows],
        )

    @staticmethod
    def alone(planes: np.ndarray, window: _Window) -> _Window:
        """Single blocks of 2x2 pixels, with the light and the variance of the windows around."""
        return _Window(
            samples=4 * planes[0],
            difference=planes[1] / at_least(planes[0], _LEAST_WEIGHT),
            light=window.light,
            variance=window.variance,
        )

    def systematic(self) -> np.ndarray:
        """Differences that are no change of light."""
        error: np.ndarray = np.abs(self.difference) * np.float32(0.5)
        error += self.light
        error += np.float32(DARK)
        error *= _SYSTEMATIC
        return error


def _halved(planes: np.ndarray, look: Callable[[], None]) -> np.ndarray:
    """Means of 2x2 blocks; what sticks out of the frame is zeros."""
    height, width = planes.shape[1:]
    bottom, right = height % 2, width % 2
    size = ((width + right) // 2, (height + bottom) // 2)
    out = np.empty((len(planes), size[1], size[0]), np.float32)
    for plane, target in zip(planes, out, strict=True):
        if bottom or right:
            plane = cv2.copyMakeBorder(plane, 0, bottom, 0, right, cv2.BORDER_CONSTANT, value=0)
        cv2.resize(plane, size, dst=target, interpolation=cv2.INTER_AREA)
        look()
    return out


def _doubled(plane: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Linear interpolation to twice the size, of which ``shape`` is taken; itself at that size."""
    if plane.shape == shape:
        return plane
    size = (2 * plane.shape[1], 2 * plane.shape[0])
    return cv2.resize(plane, size, interpolation=cv2.INTER_LINEAR)[: shape[0], : shape[1]]


def _by_pixel(kept: np.ndarray, result: np.ndarray, strips: Strips) -> np.ndarray:
    """`_doubled` of a whole frame, into ``result``."""
    shape = result.shape

    def work(blocks: slice) -> None:
        near, own = with_halo(blocks, 1, len(kept))
        rows = slice(2 * blocks.start, min(2 * blocks.stop, shape[0]))
        top = 2 * own.start
        size = (2 * kept.shape[1], 2 * (near.stop - near.start))
        doubled = cv2.resize(kept[near], size, interpolation=cv2.INTER_LINEAR)
        result[rows] = doubled[top : top + rows.stop - rows.start, : shape[1]]

    strips.run(work, *kept.shape)
    return result


def _at_level(variance: np.ndarray, own: int, level: int, shape: tuple[int, ...]) -> np.ndarray:
    """The variance of one level's blocks at those of another."""
    if level > own:
        return cv2.resize(variance, shape[::-1], interpolation=cv2.INTER_AREA)
    size = (variance.shape[1] << (own - level), variance.shape[0] << (own - level))
    return cv2.resize(variance, size, interpolation=cv2.INTER_LINEAR)[: shape[0], : shape[1]]


def _follow_noise(
    before: Noise | None, window: _Window, motion: np.ndarray, exposure: float, level: int
) -> Noise:
    """The mean over frames of the variance at a level's blocks."""
    now = window.variance
    if before is None or before.variance.shape != now.shape:
        return Noise(variance=now, exposure=exposure)
    block = 2 << level
    row, column = (
        np.minimum(np.arange(count) * block + block // 2, size - 1)
        for count, size in zip(now.shape, motion.shape, strict=False)
    )
    moved = motion[row[:, None], column] / np.float32(block)
    place = np.stack(np.meshgrid(*(np.arange(n, dtype=np.float32) for n in now.shape[::-1])), -1)
    place += moved
    past = cv2.remap(
        before.variance, place, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    past *= np.float32(min((exposure / before.exposure) ** 2, float(_BRIGHTEST)))
    frames = min(before.frames + 1, _NOISE_FRAMES)
    seen = window.samples > _LEAST_WEIGHT
    past += (now - past) * seen / np.float32(frames)
    return Noise(variance=past, exposure=exposure, frames=frames)


def _corrected(
    bias: np.ndarray, window: _Window, usual: np.ndarray, threshold: float, strips: Strips
) -> np.ndarray:
    """The bias that coarser windows found, corrected by what finer ones say."""
    corrected = np.empty_like(window.difference)

    def work(rows: slice) -> None:
        corrected[rows] = _shrunk(bias[rows], window.of(rows), usual[rows], threshold)

    strips.run(work, *corrected.shape)
    return corrected


def _confidence_of_blocks(
    blocks: np.ndarray,
    bias: np.ndarray,
    window: _Window,
    usual: np.ndarray,
    threshold: float,
    strips: Strips,
) -> np.ndarray | None:
    """What is left of the past of each block of 2x2 pixels; None where nothing is lost."""
    kept = np.empty_like(bias)

    def work(rows: slice) -> bool:
        own = blocks[:, rows]
        alone = _Window.alone(own, window.of(rows))
        found = _shrunk(bias[rows], alone, usual[rows], threshold)
        kept[rows] = _kept(found, alone, own[0])
        return bool(found.any())

    return kept if any(strips.run(work, *kept.shape)) else None


def _shrunk(bias: np.ndarray, window: _Window, usual: np.ndarray, threshold: float) -> np.ndarray:
    """`_corrected` of a strip."""
    error: np.ndarray = np.maximum(window.variance, usual)
    error *= 1 / at_least(window.samples, _LEAST_WEIGHT) + 1 / _MOST_SAMPLES
    error *= np.float32(threshold**2)
    error += np.square(window.systematic())
    rest: np.ndarray = window.difference - bias
    square = np.square(rest)
    error /= np.maximum(square, error, out=square)  # never 0: some light is systematic
    rest *= np.subtract(1, error, out=error)
    rest += bias
    return rest


def _kept(bias: np.ndarray, window: _Window, held: np.ndarray) -> np.ndarray:
    """What a bias leaves of the past's samples, by blocks of 2x2 pixels."""
    samples = held / at_least(1 - held, _LEAST_WEIGHT)  # of n / (n + 1)
    variance = window.variance + np.square(window.systematic())
    lost: np.ndarray = np.square(bias)
    lost *= samples
    lost *= _FILTERED
    lost /= variance
    lost += 1
    return np.reciprocal(lost, out=lost)

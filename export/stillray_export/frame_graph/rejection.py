"""Where the past disagrees by more than noise can: the twin of `stages.history_rejection`."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from stillray.stages import history_rejection as runtime
from stillray.stages.accumulate import DARK, MIN_WEIGHT
from stillray_export.frame_graph.exposure import size_of
from stillray_export.frame_graph.lookup import grid, linear_taps, mean_of, pixels_of, planes_like
from stillray_export.frame_graph.windows import area_means, enlarged, halved, mean_around
from stillray_training.decoders.luminance import luminance

# the runtime's numbers, so that there is one place for each
_LEVELS, _NOISE_LEVEL = runtime._LEVELS, runtime._NOISE_LEVEL
_LEAST = float(runtime._LEAST_WEIGHT)
_BRIGHTEST = float(runtime._BRIGHTEST)


@dataclass(frozen=True, eq=False)
class Noise:
    """Variance of one sample by blocks of 16x16 pixels, see `history_rejection.Noise`.

    Attributes
    ----------
    variance : (1, 1, rows, columns)
    exposure, frames
        Scalars; 0 frames are no past.
    """

    variance: Tensor
    exposure: Tensor
    frames: Tensor


def compare(light: Tensor, weight: Tensor, past: Tensor, exposure: Tensor) -> Tensor:
    """The difference between samples and past, by blocks of 2x2 pixels.

    Parameters
    ----------
    light : (1, 1, h, w)
        Luminance of irradiance.
    weight : (1, 1, h, w)
        0 where a sample says nothing.
    past : (1, 4, h, w)
        Reprojected irradiance and samples.
    exposure
        Scalar.

    Returns
    -------
    (1, PLANES, ceil(h / 2), ceil(w / 2))
        See `stillray.stages.history_rejection.compare`.
    """
    shown = light * exposure * (weight.clamp(max=MIN_WEIGHT) / MIN_WEIGHT)
    shown = shown.clamp(max=_BRIGHTEST)
    difference = shown - (luminance(past) * exposure).clamp(max=_BRIGHTEST)
    samples = past[:, 3:]
    counted = samples / (samples + 1) * weight.clamp(min=MIN_WEIGHT)
    counted = torch.where(weight > 0, counted, 0.0)
    apart = difference * counted
    means = halved(torch.cat([counted, apart, shown * counted, apart * shown], 1))
    held, apart, lit, product = (means[:, i : i + 1] for i in range(4))
    variance = (product - lit / held.clamp(min=_LEAST) * apart) * float(runtime._BESSEL)
    return torch.cat([held, apart, lit, variance], 1)


def confidence(
    blocks: Tensor, noise: Noise, motion: Tensor, exposure: Tensor
) -> tuple[Tensor, Noise]:
    """How far the past can be trusted, see `stillray.stages.history_rejection.confidence`.

    differs from the runtime's: frames of less than 17 pixels to a side have all levels, too.

    Parameters
    ----------
    blocks : (1, PLANES, rows, columns)
        What `compare` gave.
    noise
        What the last frame has left.
    motion : (1, 2, h, w)
        Pixels.
    exposure
        Scalar.

    Returns
    -------
    confidence : (1, 1, h, w)
        In [0, 1].
    noise
        For the next frame.
    """
    pyramid = [blocks]
    while len(pyramid) < _LEVELS:
        pyramid.append(halved(pyramid[-1]))
    window = _Window.around(pyramid[_NOISE_LEVEL], _NOISE_LEVEL)
    noise = _follow_noise(noise, window, motion, exposure)
    usual = torch.maximum(noise.variance, window.variance)
    bias: Tensor | None = None
    for level in reversed(range(_LEVELS)):
        height, width = pyramid[level].shape[2:]
        window = _Window.around(pyramid[level], level)
        at_level = _at_level(usual, level, pyramid[level])
        found = window.difference * 0 if bias is None else enlarged(bias, 2, height, width)
        bias = _corrected(found, window, at_level, runtime.THRESHOLDS[level + 1])
    assert bias is not None
    alone = _Window.alone(blocks, window)
    bias = _corrected(bias, alone, at_level, runtime.THRESHOLDS[0])
    kept = _kept(bias, alone, blocks[:, :1])
    height, width = motion.shape[2:]
    return enlarged(kept, 2, height, width), noise


@dataclass(frozen=True, eq=False)
class _Window:
    """What windows say: samples that they are worth, difference, light and variance."""

    samples: Tensor
    difference: Tensor
    light: Tensor
    variance: Tensor

    @staticmethod
    def around(planes: Tensor, level: int) -> _Window:
        means = mean_around(planes, runtime._WINDOW)
        held = means[:, :1]
        difference, light, variance = (
            means[:, i : i + 1] / held.clamp(min=_LEAST) for i in (1, 2, 3)
        )
        held = held * float(runtime._WINDOW**2 * (4 << 2 * level))
        return _Window(held, difference, light, variance.clamp(min=0))

    @staticmethod
    def alone(planes: Tensor, window: _Window) -> _Window:
        held = planes[:, :1]
        difference = planes[:, 1:2] / held.clamp(min=_LEAST)
        return _Window(4 * held, difference, window.light, window.variance)

    def systematic(self) -> Tensor:
        """Differences that are no change of light."""
        return (self.difference.abs() * 0.5 + self.light + DARK) * float(runtime._SYSTEMATIC)


def _at_level(variance: Tensor, level: int, like: Tensor) -> Tensor:
    """The variance of the noise's blocks at those of another level."""
    height, width = like.shape[2:]
    if level < _NOISE_LEVEL:
        return enlarged(variance, 1 << (_NOISE_LEVEL - level), height, width)
    if level == _NOISE_LEVEL:
        return variance
    return area_means(variance, (height, width), size_of(like), 3)


def _follow_noise(before: Noise, window: _Window, motion: Tensor, exposure: Tensor) -> Noise:
    now = window.variance
    block = 2 << _NOISE_LEVEL
    height, width = motion.shape[2:]
    here = grid(now)
    row = (here[:, 1:] * block + block // 2).clamp(max=height - 1)
    column = (here[:, :1] * block + block // 2).clamp(max=width - 1)
    at = (row.to(torch.int32) * width + column.to(torch.int32)).flatten()
    moved = planes_like(pixels_of(motion).index_select(0, at), now)
    taps = linear_taps(here + moved / block, before.variance)
    past = planes_like(mean_of(taps, pixels_of(before.variance), zeros=False), now)
    ratio = exposure / before.exposure.clamp(min=1e-30)
    past = past * ratio.clamp(max=_BRIGHTEST**0.5).square()
    frames = (before.frames + 1).clamp(max=runtime._NOISE_FRAMES)
    seen = (window.samples > _LEAST).to(torch.float32)
    followed = past + (now - past) * seen / frames
    return Noise(torch.where(before.frames > 0, followed, now), exposure, frames)


def _corrected(bias: Tensor, window: _Window, usual: Tensor, threshold: float) -> Tensor:
    """The bias that coarser windows found, corrected by what finer ones say."""
    share = 1 / window.samples.clamp(min=_LEAST) + 1 / float(runtime._MOST_SAMPLES)
    error = torch.maximum(window.variance, usual) * share * threshold**2
    error = error + window.systematic().square()
    rest = window.difference - bias
    return bias + rest * (1 - error / torch.maximum(rest.square(), error))


def _kept(bias: Tensor, window: _Window, held: Tensor) -> Tensor:
    """What a bias leaves of the past's samples, by blocks of 2x2 pixels."""
    samples = held / (1 - held).clamp(min=_LEAST)
    variance = window.variance + window.systematic().square()
    return 1 / (1 + bias.square() * samples * float(runtime._FILTERED) / variance)

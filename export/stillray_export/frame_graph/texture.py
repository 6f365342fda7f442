"""Texture that was filtered away, as `stillray.stages.texture` finds it."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from stillray.model_spec import ModelSpec
from stillray.stages import block_sums, relief
from stillray.stages import texture as stage
from stillray_export.frame_graph.block_sums import alike, averaged, widened
from stillray_export.frame_graph.encode import Prepared
from stillray_export.frame_graph.relief import belief, relative
from stillray_export.frame_graph.windows import enlarged, mean_with_border, repeated
from stillray_training.decoders.luminance import luminance


def texture_gain(
    image: Tensor, frame: Prepared, weight: Tensor, spec: ModelSpec, exposure: Tensor
) -> Tensor:
    """What a picture is multiplied by, ``(1, 1, h, w)``; 1 where samples are few or not told.

    Parameters
    ----------
    image : (1, 3, h, w)
        That was filtered.
    frame
        It was made of.
    weight : (1, 1, h, w)
        How far pixels lie on a surface that goes on.
    spec
        The model's.
    exposure
        Of the picture, a scalar.
    """
    height, width = image.shape[2:]
    none = (frame.albedo.amax(1, keepdim=True) <= spec.demodulate.black).to(torch.float32)
    reach = stage.BESIDE_NONE // 2
    weight = weight * (1 - F.max_pool2d(none, stage.BESIDE_NONE, stride=1, padding=reach))
    albedo = _smoothed(frame.divisor, frame.told)
    x = 1 / luminance(albedo)
    fine = x - mean_with_border(x, stage.FINE)
    taken = relative(luminance(frame.irradiance * albedo), luminance(image), exposure)
    weighed = fine * weight
    planes = [weight, weight * taken, weight * taken * taken]
    planes += [weighed, weighed * taken, weighed * fine, alike(weighed)]
    slopes = _fitted(widened(averaged(torch.cat(planes, 1)), spec.texture.window), spec)
    gain = 1 + enlarged(slopes, block_sums.BLOCK, height, width) * weighed
    told = frame.told >= stage.FEWEST_SAMPLES
    return torch.where(told, gain.clamp(stage.LEAST_GAIN, stage.MOST_GAIN), 1.0)


def _smoothed(albedo: Tensor, samples: Tensor) -> Tensor:
    share = stage.SMOOTHED / samples.clamp(min=1)
    share = torch.where(share >= stage.LEAST_SMOOTHED, share, 0.0)
    padded = repeated(albedo, 1)
    across = share * (padded[..., :-2] + padded[..., 2:]) + (1 - 2 * share) * padded[..., 1:-1]
    return (
        share * (across[..., :-2, :] + across[..., 2:, :]) + (1 - 2 * share) * across[..., 1:-1, :]
    )


def _fitted(sums: Tensor, spec: ModelSpec) -> Tensor:
    weight, *means = sums.split(1, 1)
    weight = weight + block_sums.LEAST_WEIGHT
    taken, square, x, both, squares, near = (mean / weight for mean in means)
    near = near / (squares + relief.LEAST_EXPLAINED)
    noise = (square - taken.square()).clamp(min=0)
    pixels = 4 * math.pi * spec.texture.window**2 * weight
    together = both - x * taken
    ridge = noise / (pixels * stage.PRIOR**2) + stage.RIDGE
    slopes = together / (squares - x.square() + ridge)
    return slopes * belief(slopes * together, noise / pixels, near)

"""Relief that was filtered away, as `stillray.stages.relief` finds it."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from stillray.stages import block_sums
from stillray.stages import relief as stage
from stillray_export.frame_graph.block_sums import alike, averaged, widened
from stillray_export.frame_graph.windows import enlarged, mean_with_border
from stillray_training.decoders.luminance import luminance


def relief_gain(
    image: Tensor,
    radiance: Tensor,
    surface: tuple[Tensor, Tensor],
    window: float,
    exposure: Tensor,
) -> Tensor:
    """What a picture is multiplied by, ``(1, 1, h, w)``.

    Parameters
    ----------
    image : (1, 3, h, w)
        That was filtered.
    radiance : (1, 1, h, w)
        Luminance of this frame.
    surface
        Of `surface_weight`.
    window
        Pixels.
    exposure
        Of the picture, a scalar.
    """
    height, width = image.shape[2:]
    fine, weight = surface
    taken = relative(radiance, luminance(image), exposure)
    weighed = fine * weight
    pairs = [weighed[:, i : i + 1] * fine[:, j : j + 1] for i, j in stage.PAIRS]
    planes = [weight, weight * taken, weight * taken * taken, weighed, weighed * taken, *pairs]
    planes.append(alike(weighed))
    slopes = _fitted(widened(averaged(torch.cat(planes, 1)), window), window)
    large = enlarged(slopes, block_sums.BLOCK, height, width)
    gain = 1 + (large * weighed).sum(1, keepdim=True)
    return gain.clamp(stage.LEAST_GAIN, stage.MOST_GAIN)


def relative(light: Tensor, left: Tensor, exposure: Tensor) -> Tensor:
    """What was taken from light, by what is left of it, bounded."""
    taken = (light - left) / (left + stage.DARKEST / exposure)
    return taken.clamp(-stage.MOST_TAKEN, stage.MOST_TAKEN)


def surface_weight(normal: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
    """The fine part of normals, and how far pixels lie on a surface that goes on.

    Both are ``(1, c, h, w)``; ``normal`` and ``depth`` are 0 where there are none.
    """
    fine = normal - mean_with_border(normal, stage.FINE)
    bent = fine.square().sum(1, keepdim=True) / stage.BENT**2
    hit = (depth > 0).to(torch.float32)
    inverse = hit / torch.where(depth > 0, depth, 1)
    apart = (mean_with_border(inverse, 3) * depth - 1) / stage.APART
    given = depth.amax() > 0
    return fine, torch.where(given, (-bent - apart.square()).exp() * hit, (-bent).exp())


def _fitted(sums: Tensor, window: float) -> Tensor:
    weight, *means = sums.split(1, 1)
    weight = weight + block_sums.LEAST_WEIGHT
    taken, square, *others = (mean / weight for mean in means)
    normals, both, squares, near = others[:3], others[3:6], others[6:12], others[12]
    near = near / (squares[0] + squares[3] + squares[5] + stage.LEAST_EXPLAINED)
    noise = (square - taken.square()).clamp(min=0)
    pixels = 4 * math.pi * window**2 * weight
    ridge = noise / (pixels * stage.PRIOR**2) + stage.RIDGE
    matrix = [
        square - normals[i] * normals[j] + (ridge if i == j else 0)
        for square, (i, j) in zip(squares, stage.PAIRS, strict=True)
    ]
    products = [found - normal * taken for found, normal in zip(both, normals, strict=True)]
    slopes = stage.solved(matrix, products)
    explained = sum(slope * product for slope, product in zip(slopes, products, strict=True))
    return torch.cat(slopes, 1) * belief(explained, 3 * noise / pixels, near)


def belief(explained: Tensor, by_chance: Tensor, near: Tensor) -> Tensor:
    """How far slopes are believed, see `stillray.stages.relief.believed`."""
    share = 1 - stage.DOUBT * by_chance / (explained + stage.LEAST_EXPLAINED)
    least, most = stage.RESOLVED
    resolved = (near / block_sums.NEIGHBOURS - least) / (most - least)
    return share.clamp(0, 1) * resolved.clamp(0, 1)

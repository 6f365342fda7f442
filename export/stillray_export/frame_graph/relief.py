"""Relief that was filtered away, as `stillray.stages.relief` finds it."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from stillray.stages import relief as stage
from stillray_export.frame_graph.windows import enlarged, mean_with_border
from stillray_training.decoders.luminance import luminance


def relief_gain(
    image: Tensor, radiance: Tensor, normal: Tensor, depth: Tensor, window: float, dark: Tensor
) -> Tensor:
    """What a picture is multiplied by, ``(1, 1, h, w)``.

    Parameters
    ----------
    image : (1, 3, h, w)
        That was filtered.
    radiance : (1, 1, h, w)
        Luminance of this frame.
    normal, depth : (1, 3, h, w), (1, 1, h, w)
        0 where there are none.
    window
        Pixels.
    dark
        Radiance that is added where relative means relative to it.
    """
    height, width = image.shape[2:]
    fine = normal - mean_with_border(normal, stage.FINE)
    weight = _weight(fine, depth)
    left = luminance(image)
    taken = (radiance - left) / (left + dark)
    taken = taken.clamp(-stage.MOST_TAKEN, stage.MOST_TAKEN)
    weighed = fine * weight
    pairs = [weighed[:, i : i + 1] * fine[:, j : j + 1] for i, j in stage.PAIRS]
    block = stage.BLOCK
    beside = (weighed[..., :-1] * weighed[..., 1:]).sum(1, keepdim=True)
    below = (weighed[..., :-1, :] * weighed[..., 1:, :]).sum(1, keepdim=True)
    last = (torch.arange(height - 1) % block == block - 1)[:, None]
    alike = F.pad(beside, [0, 1]) + F.pad(torch.where(last, 0, below), [0, 0, 0, 1])
    planes = [weight, weight * taken, weight * taken * taken, weighed, weighed * taken, *pairs]
    planes.append(alike)
    padded = F.pad(torch.cat(planes, 1), [0, -width % block, 0, -height % block])
    slopes = _slopes(F.avg_pool2d(padded, block), window)
    gain = 1 + (enlarged(slopes, block, height, width) * weighed).sum(1, keepdim=True)
    return gain.clamp(stage.LEAST_GAIN, stage.MOST_GAIN)


def _weight(fine: Tensor, depth: Tensor) -> Tensor:
    bent = fine.square().sum(1, keepdim=True) / stage.BENT**2
    hit = (depth > 0).to(torch.float32)
    inverse = hit / torch.where(depth > 0, depth, 1)
    apart = (mean_with_border(inverse, 3) * depth - 1) / stage.APART
    given = depth.amax() > 0
    return torch.where(given, (-bent - apart.square()).exp() * hit, (-bent).exp())


def _slopes(sums: Tensor, window: float) -> Tensor:
    sigma = window / stage.BLOCK
    reach = math.ceil(3 * sigma)
    places = torch.arange(-reach, reach + 1, dtype=torch.float32)
    kernel = (-places.square() / (2 * sigma**2)).exp()
    kernel = kernel / kernel.sum()
    planes = sums.transpose(0, 1)  # each plane alone
    planes = F.conv2d(planes, kernel[None, None, :, None], padding=(reach, 0))
    planes = F.conv2d(planes, kernel[None, None, None, :], padding=(0, reach))
    weight, *means = planes.transpose(0, 1).split(1, 1)
    weight = weight + stage.LEAST_WEIGHT
    taken, square, *others = (mean / weight for mean in means)
    normals, both, squares, alike = others[:3], others[3:6], others[6:12], others[12]
    alike = alike / (squares[0] + squares[3] + squares[5] + stage.LEAST_EXPLAINED)
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
    by_chance = 3 * noise / pixels
    share = 1 - stage.DOUBT * by_chance / (explained + stage.LEAST_EXPLAINED)
    least, most = stage.RESOLVED
    resolved = (alike / stage.NEIGHBOURS - least) / (most - least)
    return torch.cat(slopes, 1) * share.clamp(0, 1) * resolved.clamp(0, 1)

"""Light of rare samples that was filtered away, as `stillray.stages.rare_light` puts it back."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor
from torch.nn import functional as F

from stillray.stages import rare_light as stage
from stillray_export.frame_graph.windows import enlarged, mean_with_border
from stillray_training.decoders.luminance import luminance


def rare_light_gain(image: Tensor, radiance: Tensor, exposure: Tensor) -> Tensor:
    """What a picture is multiplied by, ``(1, 1, h, w)``.

    Parameters
    ----------
    image : (1, 3, h, w)
        That was filtered.
    radiance : (1, 1, h, w)
        Luminance of this frame.
    exposure
        A scalar.
    """
    height, width = image.shape[2:]
    block, first = stage.BLOCK, stage.BANDS[0]
    picture = luminance(image)
    usual = mean_with_border(_block_means(picture), 3) + stage.DARKEST / exposure
    around = enlarged(usual, block, height, width)
    above = (radiance - picture) / around
    relative = picture / around
    shown = F.max_pool2d(relative, stage.BESIDE, 1, stage.BESIDE // 2) >= stage.SHOWN
    counted = torch.where(shown, 0, above)
    rare = (counted > first).to(torch.float32)
    counts = _block_sums(torch.ones_like(above))
    pixels = [_summed(counts, side) for side in stage.WINDOWS]
    missing = torch.zeros_like(counts)
    for low, high in pairwise(stage.BANDS):
        light = counted.clamp(low, high) - low
        missing = missing + _believed(_block_sums(light), pixels)
    kept, usually = (
        _summed(_block_means(plane) * counts, stage.WINDOWS[-1]) / pixels[-1]
        for plane in (relative, above.clamp(max=first))
    )
    missing = missing + usually.clamp(max=0)
    more = (missing / kept).clamp(stage.LEAST, stage.MOST - 1)
    gain = enlarged(1 + more - stage.LEAST**2 / more, block, height, width)
    return torch.where(rare.sum() >= stage.FEWEST, gain, 1)


def _believed(sums: Tensor, pixels: list[Tensor]) -> Tensor:
    mean, square, squares = torch.zeros_like(sums), torch.zeros_like(sums), sums * sums
    for side, count in zip(stage.WINDOWS, pixels, strict=True):
        new, spread = _summed(sums, side) / count, _summed(squares, side) / count
        apart = new - mean
        sure, doubt = apart.square(), stage.ERRORS**2 * torch.maximum(spread, square) / count
        believed = sure > doubt
        share = torch.where(believed, (sure - doubt) / torch.where(believed, sure, 1), 0)
        mean, square = mean + share * apart, spread
    return mean


def _block_means(plane: Tensor) -> Tensor:
    """The border goes on."""
    at = (torch.arange(size + -size % stage.BLOCK).clamp(max=size - 1) for size in plane.shape[2:])
    rows, columns = at
    return F.avg_pool2d(plane[:, :, rows][..., columns], stage.BLOCK)


def _block_sums(plane: Tensor) -> Tensor:
    """Beyond the frame is nothing."""
    bottom, right = (-size % stage.BLOCK for size in plane.shape[2:])
    return F.avg_pool2d(F.pad(plane, [0, right, 0, bottom]), stage.BLOCK) * stage.BLOCK**2


def _summed(plane: Tensor, side: int) -> Tensor:
    ones = torch.ones(1, 1, side, 1)
    down = F.conv2d(plane, ones, padding=(side // 2, 0))
    return F.conv2d(down, ones.transpose(2, 3), padding=(0, side // 2))

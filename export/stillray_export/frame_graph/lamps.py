"""Small lamps that were filtered away, as `stillray.stages.lamps` finds them."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from stillray.stages import lamps as stage
from stillray_export.frame_graph.windows import mean_with_border
from stillray_training.decoders.luminance import luminance


def restored(image: Tensor, radiance: Tensor, exposure: Tensor) -> Tensor:
    """A picture into which the light of small lamps is put back, ``(1, 3, h, w)``.

    Parameters
    ----------
    image : (1, 3, h, w)
        That was filtered.
    radiance : (1, 3, h, w)
        The frame's own light times the albedo.
    exposure
        A scalar.
    """
    samples = luminance(radiance)
    picture = luminance(image) + stage.DARKEST / exposure
    most = stage.MOST * mean_with_border(picture, stage.AROUND)
    share, light = torch.zeros_like(samples), torch.zeros_like(samples)
    for block in stage.BLOCKS:
        opened = _opened(samples, picture, block)
        level = torch.minimum(opened, most)
        own = ((level / picture - block.brighter) / (stage.FADE * block.brighter)).clamp(0, 1)
        if block.strewn < 1:
            own = own * _by_design(samples, picture, opened > 0, block)
        better = own * (level - picture) > share * (light - picture)
        share, light = torch.where(better, own, share), torch.where(better, level, light)
    scale = light / torch.where(samples > 0, samples, 1)
    return image + share * (radiance * scale - image)


def _opened(samples: Tensor, picture: Tensor, block: stage.Block) -> Tensor:
    size = (block.height, block.width)
    below, beside = block.height - 1, block.width - 1
    padded, seen = (F.pad(planes, (0, beside, 0, below)) for planes in (samples, picture))
    least = -F.max_pool2d(-padded, size, stride=1)
    largest, kept = (F.max_pool2d(planes, size, stride=1) for planes in (padded, seen))
    lost = (largest <= block.alike * least) & (least > block.brighter * kept)
    found = torch.where(lost, least, 0)
    return F.max_pool2d(F.pad(found, (beside, 0, below, 0)), size, stride=1)


def _by_design(samples: Tensor, picture: Tensor, in_blocks: Tensor, block: stage.Block) -> Tensor:
    beside = F.max_pool2d(in_blocks.to(torch.float32), 3, stride=1, padding=1)
    strewn = (samples > block.brighter * picture).to(torch.float32) * (1 - beside)
    around = F.avg_pool2d(strewn, stage.AROUND, stride=1, padding=stage.AROUND // 2)
    return (2 - around * (2 / block.strewn)).clamp(0, 1)

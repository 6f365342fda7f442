"""Tone, the twin of a part of `stillray.stages.features`."""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional as F


def tone_map(radiance: Tensor, exposure: Tensor) -> Tensor:
    """``x e / (1 + x e)`` in [0, 1); 1 where ``x e`` leaves float32."""
    return 1 - 1 / (1 + radiance * exposure)


def local_luminance(toned_nchw: Tensor, size: int) -> Tensor:
    """Mean of ``size x size`` tone-mapped pixels, the border repeated."""
    half = size // 2
    across = F.pad(toned_nchw, (half, half, 0, 0), mode="replicate")
    across = F.avg_pool2d(across, (1, size), stride=1)
    down = F.pad(across, (0, 0, half, half), mode="replicate")
    return F.avg_pool2d(down, (size, 1), stride=1)

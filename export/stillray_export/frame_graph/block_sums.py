"""Sums over blocks and windows of those, the twin of `stillray.stages.block_sums`."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from stillray.stages.block_sums import BLOCK


def averaged(planes_nchw: Tensor) -> Tensor:
    """Means of blocks; beyond the planes is nothing."""
    height, width = planes_nchw.shape[2:]
    return F.avg_pool2d(F.pad(planes_nchw, [0, -width % BLOCK, 0, -height % BLOCK]), BLOCK)


def alike(weighed_nchw: Tensor) -> Tensor:
    """Products of planes with those to the right, and below in their block, ``(1, 1, h, w)``."""
    height = weighed_nchw.shape[2]
    beside = (weighed_nchw[..., :-1] * weighed_nchw[..., 1:]).sum(1, keepdim=True)
    below = (weighed_nchw[..., :-1, :] * weighed_nchw[..., 1:, :]).sum(1, keepdim=True)
    last = (torch.arange(height - 1) % BLOCK == BLOCK - 1)[:, None]
    return F.pad(beside, [0, 1]) + F.pad(torch.where(last, 0, below), [0, 0, 0, 1])


def widened(means_nchw: Tensor, window: float) -> Tensor:
    """Means of blocks over Gaussian windows of a standard deviation in pixels."""
    sigma = window / BLOCK
    reach = math.ceil(3 * sigma)
    places = torch.arange(-reach, reach + 1, dtype=torch.float32)
    kernel = (-places.square() / (2 * sigma**2)).exp()
    kernel = kernel / kernel.sum()
    planes = means_nchw.transpose(0, 1)  # each plane alone
    planes = F.conv2d(planes, kernel[None, None, :, None], padding=(reach, 0))
    planes = F.conv2d(planes, kernel[None, None, None, :], padding=(0, reach))
    return planes.transpose(0, 1)

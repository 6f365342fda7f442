"""Differentiable reconstruction: the twin, in PyTorch, of `stillray.families.bilateral_grid`."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from stillray.families.bilateral_grid import GUIDE_RANGE, grid_cells
from stillray.model_spec.decoders import BilateralGrids

# Cells squared: what rounds off the tip of the tent in its gradient (section 4.2).
_TIP = 1e-7


class Tent(torch.autograd.Function):
    """Weights of the two cells beside a position; the gradient is that of sqrt(a^2 + e) for |a|."""

    @staticmethod
    def forward(ctx: Any, part: Tensor) -> tuple[Tensor, Tensor]:
        ctx.save_for_backward(part)
        return 1 - part, part.clone()

    @staticmethod
    def backward(ctx: Any, *gradients: Any) -> Tensor:
        (part,) = ctx.saved_tensors
        near, far = gradients
        rest = 1 - part
        return far * rest / (rest**2 + _TIP).sqrt() - near * part / (part**2 + _TIP).sqrt()


def bilateral_grids(
    irradiance_nchw: Tensor, samples_nchw: Tensor, maps_nchw: Tensor, options: BilateralGrids
) -> Tensor:
    """Splat into grids, slice them again and blend (Meng et al. 2020, eq. 8 to 15).

    Parameters
    ----------
    irradiance_nchw : (n, 3, h, w)
    samples_nchw : (n, 1, h, w)
        Samples that each pixel holds, >= 0.
    maps_nchw : (n, 2 m - 1, h, w)
        Guides and blend weights, see `stillray_training.networks.guide.GuideNet`; what lies
        beyond [0, 1] is taken for the nearer of them.
    options
        The grids.

    Returns
    -------
    (n, 3, h, w)
    """
    bounded = maps_nchw.clamp(0, 1)
    weight = samples_nchw if options.weigh_samples else torch.ones_like(samples_nchw)
    rest = torch.ones_like(samples_nchw)  # of the blend, for the scales that follow
    total = torch.zeros_like(irradiance_nchw)
    for scale in range(options.grids):
        guide = bounded[:, scale : scale + 1]
        image = splat_and_slice(irradiance_nchw, weight, guide, options, scale)
        if scale < options.grids - 1:
            share = bounded[:, options.grids + scale, None]
            total = total + rest * share * image
            rest = rest * (1 - share)
        else:
            total = total + rest * image
    return total


def splat_and_slice(
    irradiance_nchw: Tensor,
    weight_nchw: Tensor,
    guide_nchw: Tensor,
    options: BilateralGrids,
    scale: int,
) -> Tensor:
    """One grid: construction (eq. 10 to 12) and slicing (eq. 13) with the same guide.

    Parameters
    ----------
    irradiance_nchw : (n, 3, h, w)
    weight_nchw : (n, 1, h, w)
        What each pixel counts, >= 0; cells that nothing counts in are left out.
    guide_nchw : (n, 1, h, w)
        In [0, 1].
    options
        The grids.
    scale
        0 for the finest.

    Returns
    -------
    (n, 3, h, w)
        0 where all cells around a pixel are empty.
    """
    count, _, height, width = irradiance_nchw.shape
    spacing = options.spacing << scale
    rows, columns, depths = grid_cells(height, width, options, scale)
    position = guide_nchw[:, 0] * (GUIDE_RANGE / (options.depth_spacing * 2**scale))
    floor = position.detach().floor().clamp(max=depths - 2)
    part = position - floor
    # an exported graph cannot hold a gradient of our own
    tent = Tent.apply(part) if part.requires_grad else (1 - part, part)
    across = torch.arange(width, device=part.device)
    down = torch.arange(height, device=part.device)
    first = torch.arange(count, device=part.device)[:, None, None] * (rows * columns * depths)
    first = first + (down // spacing)[:, None] * (columns * depths) + across // spacing * depths
    first = first + floor.long()
    right = (across % spacing).to(part.dtype) / spacing
    lower = ((down % spacing).to(part.dtype) / spacing)[:, None]
    weights, cells = [], []
    for step_y, weight_y in ((0, 1 - lower), (columns * depths, lower)):
        for step_x, weight_x in ((0, 1 - right), (depths, right)):
            for step_z, weight_z in enumerate(tent):
                weights.append(weight_y * weight_x * weight_z)
                cells.append(first + (step_y + step_x + step_z))
    corners = torch.stack(weights).flatten()  # (8 n h w): every pixel once a corner
    at = torch.stack(cells).flatten()[None]
    light = torch.cat([irradiance_nchw * weight_nchw, weight_nchw], 1)
    light = light.transpose(0, 1).reshape(4, 1, -1)  # planes by pixels
    splats = (light * corners.view(8, -1)).reshape(4, -1)
    grid = light.new_zeros(4, count * rows * columns * depths)
    grid = grid.scatter_add(1, at.expand(4, -1), splats)
    filled = (grid[3:] > 0).to(grid.dtype)
    means = grid[:3] / torch.where(grid[3:] > 0, grid[3:], torch.ones_like(grid[3:]))
    read = torch.cat([means, filled]).gather(1, at.expand(4, -1)) * corners
    sums = read.view(4, 8, -1).sum(1)
    found = torch.where(sums[3:] > 0, sums[3:], torch.ones_like(sums[3:]))
    return (sums[:3] / found).view(3, count, height, width).transpose(0, 1)

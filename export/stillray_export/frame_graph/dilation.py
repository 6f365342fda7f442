"""Silhouettes follow the nearer surface: the twin of `stillray.stages.motion_dilation`."""

from __future__ import annotations

import torch
from torch import Tensor

from stillray_export.frame_graph.lookup import grid, pixels_of, planes_like
from stillray_export.frame_graph.windows import neighbours

_NEARER = 0.98
_FAR = 1e30


def follow_nearer(motion_nchw: Tensor, depth_nchw: Tensor) -> Tensor:
    """Where the picture of each pixel was: x and y, ``(1, 2, h, w)``.

    differs from the runtime's: depths count to the last bit, not to a millionth; among equal ones
    both take the first by row and column modulo 3.

    Parameters
    ----------
    motion_nchw : (1, 2, h, w)
        Pixels.
    depth_nchw : (1, 1, h, w)
        0 where nothing was hit; all 0 where depth is not given.
    """
    width = depth_nchw.shape[3]
    here = grid(depth_nchw)
    column, row = here[:, :1], here[:, 1:]
    depth = torch.where(depth_nchw > 0, depth_nchw, _FAR)
    order = torch.remainder(row, 3) * 4 + torch.remainder(column, 3)
    least, first, step = depth, order, torch.zeros_like(depth)
    around = zip(neighbours(depth, 2 * _FAR), neighbours(order, 99.0), strict=True)
    for number, (other, place) in enumerate(around):
        if number == 4:  # the pixel itself
            continue
        # the first of those as near; an Or would leave WebGPU, which has none
        nearer = torch.where(other == least, place - first, other - least) < 0
        step = torch.where(nearer, float(number), step)
        first, least = torch.where(nearer, place, first), torch.where(nearer, other, least)
    hidden = least < depth * _NEARER
    step = torch.where(hidden, step, 4.0)
    down = (step / 3).floor() - 1
    right = step - 3 * (down + 1) - 1
    at = torch.cat([column + right, row + down], 1)
    index = (at[:, 1].to(torch.int32) * width + at[:, 0].to(torch.int32)).flatten()
    return planes_like(pixels_of(motion_nchw).index_select(0, index), motion_nchw) + here

"""Repair of what a renderer may write, the twin of `stillray.stages.repair`.

Not a number fails every comparison: so nothing here asks for it by name, which some accelerators
cannot.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from stillray.stages.repair import MAX_MOTION, MAX_RADIANCE
from stillray_export.frame_graph.windows import mean_around

_FINITE = 3.4e38
_BLOCK = 4  # pixels: beyond windows of 5x5, holes are filled from blocks, each level four times so
_LEVELS = 5


def repair_radiance(color_nchw: Tensor, empty: Tensor) -> tuple[Tensor, Tensor]:
    """Radiance that is finite and not negative, and where it was filled in.

    differs from the runtime's: the smallest of windows of 3x3 and 5x5 pixels that has any valid
    one, then of 3x3 blocks of 4, 16, ... pixels: a window for each pixel of a wide hole would cost
    every frame without one as much.

    Parameters
    ----------
    color_nchw : (1, 3, h, w)
        Any values.
    empty : (1, 1, h, w)
        1 where a pixel has no samples, else 0.

    Returns
    -------
    color : (1, 3, h, w)
    broken : (1, 1, h, w)
        1 where a pixel carries no sample of its own, else 0.
    """
    finite = (color_nchw.abs() <= _FINITE).to(torch.float32).amin(1, keepdim=True)
    valid = finite * (1 - empty)
    color = torch.where(valid > 0, color_nchw, 0.0).clamp(0, MAX_RADIANCE)
    return _filled(torch.cat([color, valid], 1)), 1 - valid


def _filled(planes: Tensor) -> Tensor:
    """Color of ``(1, 4, h, w)`` color, 0 where it is not valid, and validity."""
    windows = [planes, mean_around(planes, 3), mean_around(planes, 5)]
    color, valid = _first_of(windows)
    return torch.where(valid > 0, color, _from_blocks(planes))


def _first_of(windows: list[Tensor]) -> tuple[Tensor, Tensor]:
    """The mean of the first window that has any valid pixel, and whether there was one."""
    color, valid = windows[-1][:, :3], windows[-1][:, 3:]
    color = color / valid.clamp(min=1e-30)
    for window in reversed(windows[:-1]):
        share = window[:, 3:]
        color = torch.where(share > 0, window[:, :3] / share.clamp(min=1e-30), color)
        valid = torch.maximum(valid, share)
    return color, valid


def _from_blocks(planes: Tensor) -> Tensor:
    height, width = planes.shape[2:]
    levels = [planes]
    for _ in range(_LEVELS):
        rows, columns = levels[-1].shape[2:]
        padded = F.pad(levels[-1], (0, -columns % _BLOCK, 0, -rows % _BLOCK))
        levels.append(F.avg_pool2d(padded, _BLOCK))
    found: Tensor | None = None
    for level in reversed(levels[1:]):
        window = mean_around(level, 3)
        color, valid = _first_of([window])
        if found is not None:
            size = color.shape[2:]
            larger = F.interpolate(found, scale_factor=float(_BLOCK), mode="nearest")
            color = torch.where(valid > 0, color, larger[..., : size[0], : size[1]])
        found = color
    assert found is not None
    return F.interpolate(found, scale_factor=float(_BLOCK), mode="nearest")[..., :height, :width]


def repair_feature(feature_nchw: Tensor, low: float, high: float) -> Tensor:
    """In its range; what is not finite becomes 0."""
    return torch.where(feature_nchw.abs() <= _FINITE, feature_nchw, 0.0).clamp(low, high)


def repair_motion(motion_nchw: Tensor) -> Tensor:
    """Motion that is not finite, or too far, becomes `MAX_MOTION`: from outside of the frame."""
    return torch.where(motion_nchw.abs() <= MAX_MOTION, motion_nchw, MAX_MOTION)

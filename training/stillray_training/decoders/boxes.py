"""Means of square windows, differentiable and without residues of running sums."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F


class BoxMean(torch.autograd.Function):
    """Mean of a k x k window, zeros outside the image; its own adjoint."""

    @staticmethod
    def forward(ctx: Any, planes: Tensor, size: int) -> Tensor:
        ctx.size = size
        return box_mean(planes, size)

    @staticmethod
    def backward(ctx: Any, *gradients: Any) -> tuple[Tensor, None]:
        return box_mean(gradients[0], ctx.size), None


def box_mean(planes: Tensor, size: int) -> Tensor:
    """Mean of ``size x size`` windows of ``(n, c, h, w)``, zeros outside the image.

    Each window is summed anew, along one axis and then the other, by doubling: 13 = 8 + 4 + 1.
    A running sum would be no faster here and keeps a residue of large values it has passed.
    """
    half = size // 2
    across = _window_sum(F.pad(planes, (half, half)), size, 3)
    return _window_sum(F.pad(across, (0, 0, half, half)), size, 2) / size**2


def _window_sum(planes: Tensor, size: int, axis: int) -> Tensor:
    length = planes.shape[axis] - size + 1
    total: Tensor | None = None
    power, start = planes, 0  # `power` holds sums of `width` neighbours
    width = 1
    while width <= size:
        if size & width:
            part = power.narrow(axis, start, length)
            total = part.clone() if total is None else total.add_(part)
            start += width
        if 2 * width <= size:
            count = power.shape[axis] - width
            power = power.narrow(axis, 0, count) + power.narrow(axis, width, count)
        width *= 2
    assert total is not None
    return total


def pooled_box_mean(planes: Tensor, size: int) -> Tensor:
    """The same as `box_mean` in two operators of ONNX, for exported graphs."""
    half = size // 2
    across = F.avg_pool2d(planes, (1, size), stride=1, padding=(0, half))
    return F.avg_pool2d(across, (size, 1), stride=1, padding=(half, 0))

"""Differentiable reconstruction: the twin, in PyTorch, of `stillray.kernels`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F

from stillray.models_spec.loader import Decoder


class _BoxMean(torch.autograd.Function):
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


def fused_kernels(
    irradiance_nchw: Tensor,
    samples_nchw: Tensor,
    logits_nchw: Tensor,
    options: Decoder,
    box: Callable[[Tensor, int], Tensor] = _BoxMean.apply,
) -> Tensor:
    """Filter with fused weight-sharing kernels (Fan et al. 2021, eq. 3 to 5).

    No kernel map is built: the softmax over a shared importance map is a ratio of box sums.

    Parameters
    ----------
    irradiance_nchw : (n, 3, h, w)
    samples_nchw : (n, 1, h, w)
        Samples that each pixel holds, > 0.
    logits_nchw : (n, 2 m, h, w)
        m importance maps and m fusion maps.
    options
        Kernel sizes and the bound of the logits.
    box
        How window means are taken; an exported graph cannot hold the default.

    Returns
    -------
    (n, 3, h, w)
    """
    bounded = logits_nchw.contiguous().clamp(-options.logit_bound, options.logit_bound)
    importance, alpha = bounded.chunk(2, dim=1)
    alpha = alpha.softmax(dim=1)
    weights = importance.exp()
    if options.weigh_samples:
        weights = weights * samples_nchw
    total = torch.zeros_like(irradiance_nchw)
    for index, size in enumerate(options.kernel_sizes):
        weight = weights[:, index : index + 1]
        sums = box(torch.cat([weight * irradiance_nchw, weight], dim=1), size)
        total = total + alpha[:, index : index + 1] * (sums[:, :3] / sums[:, 3:])
    return total

"""Differentiable reconstruction: the twin, in PyTorch, of `stillray.families.box_filter`."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from stillray.model_spec.decoders import FusedKernels
from stillray_training.decoders.boxes import BoxMean


def fused_kernels(
    irradiance_nchw: Tensor,
    samples_nchw: Tensor,
    logits_nchw: Tensor,
    options: FusedKernels,
    box: Callable[[Tensor, int], Tensor] = BoxMean.apply,
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

"""Differentiable reconstruction: the twin, in PyTorch, of `stillray.families.multi_resolution`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor
from torch.nn import functional as F

from stillray.model_spec.decoders import FusedKernels
from stillray_training.decoders.boxes import BoxMean
from stillray_training.decoders.fused_kernels import fused_kernels

#: From irradiance, samples and logits of a level, ``(n, c, h, w)`` each, to filtered irradiance.
LevelFilter = Callable[[Tensor, Tensor, Tensor], Tensor]


def multi_resolution_kernels(
    irradiance_nchw: Tensor,
    samples_nchw: Tensor,
    logits: Sequence[Tensor],
    options: FusedKernels,
    box: Callable[[Tensor, int], Tensor] = BoxMean.apply,
) -> Tensor:
    """Filter with fused kernels at every resolution, and blend from the coarsest to the finest.

    Parameters
    ----------
    irradiance_nchw : (n, 3, h, w)
        Sizes that are multiples of 2^(levels - 1).
    samples_nchw : (n, 1, h, w)
        Samples that each pixel holds, > 0.
    logits
        One map a level, finest first: importance and fusion maps as `fused_kernels` takes them,
        then, but at the coarsest, the blend with the coarser level.
    options
        Kernel sizes and the bound of the logits.
    box
        How window means are taken; an exported graph cannot hold the default.

    Returns
    -------
    (n, 3, h, w)
    """

    def level_filter(light: Tensor, held: Tensor, maps: Tensor) -> Tensor:
        return fused_kernels(light, held, maps, options, box)

    return filtered_resolutions(irradiance_nchw, samples_nchw, logits, options, level_filter)


def filtered_resolutions(
    irradiance_nchw: Tensor,
    samples_nchw: Tensor,
    logits: Sequence[Tensor],
    options: FusedKernels,
    level_filter: LevelFilter,
) -> Tensor:
    """`multi_resolution_kernels` with any filter of a level.

    Parameters
    ----------
    irradiance_nchw, samples_nchw
        As there.
    logits
        One map a level, finest first: what the filter takes, then, but at the coarsest, the blend
        with the coarser level.
    options
        The bound of the blend's logits, and whether means are weighted by samples.
    level_filter
        Filters one level.

    Returns
    -------
    (n, 3, h, w)
    """
    light, held = [irradiance_nchw], [samples_nchw]
    for _ in logits[1:]:
        weight = held[-1] if options.weigh_samples else torch.ones_like(held[-1])
        sums = F.avg_pool2d(torch.cat([weight * light[-1], weight, held[-1]], 1), 2)
        weighted, total, samples = sums.split((3, 1, 1), 1)
        light.append(weighted / total)
        held.append(samples)
    result = level_filter(light[-1], held[-1], logits[-1])
    for level in reversed(range(len(logits) - 1)):
        filters, alpha = logits[level].split((logits[level].shape[1] - 1, 1), 1)
        fine = level_filter(light[level], held[level], filters)
        bounded = alpha.clamp(-options.logit_bound, options.logit_bound)
        result = blended(fine, result, bounded.sigmoid())
    return result


def blended(fine_nchw: Tensor, coarser_nchw: Tensor, alpha_nchw: Tensor) -> Tensor:
    """Fan et al. 2021, eq. 7, within the range of what is blended.

    Parameters
    ----------
    fine_nchw : (n, 3, h, w)
    coarser_nchw : (n, 3, h / 2, w / 2)
    alpha_nchw : (n, 1, h, w)
        How far the fine level's mean gives way to the coarser level, [0, 1].
    """
    least = torch.minimum(-F.max_pool2d(-fine_nchw, 2), coarser_nchw)
    most = torch.maximum(F.max_pool2d(fine_nchw, 2), coarser_nchw)
    step = coarser_nchw - F.avg_pool2d(fine_nchw, 2)
    step, least, most = (
        F.interpolate(planes, scale_factor=2.0, mode="nearest") for planes in (step, least, most)
    )
    return torch.minimum(torch.maximum(fine_nchw + alpha_nchw * step, least), most)

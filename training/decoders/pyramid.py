"""Differentiable reconstruction: the twin, in PyTorch, of `stillray.pyramid`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor
from torch.nn import functional as F

from stillray.models_spec.loader import PyramidKernels
from stillray.pyramid import NEIGHBOURS, level_layout
from stillray.training.decoders.boxes import BoxMean


def kernel_pyramid(
    irradiance_nchw: Tensor,
    samples_nchw: Tensor,
    logits: Sequence[Tensor],
    options: PyramidKernels,
    box: Callable[[Tensor, int], Tensor] = BoxMean.apply,
) -> Tensor:
    """Filter at every resolution and blend from the coarsest to the finest.

    Parameters
    ----------
    irradiance_nchw : (n, 3, h, w)
        Sizes that are multiples of 2^(levels - 1).
    samples_nchw : (n, 1, h, w)
        Samples that each pixel holds, > 0.
    logits
        One map a level, finest first, see `stillray.pyramid.level_layout`.
    options
        Kernel sizes and the bound of the logits.
    box
        How window means are taken.

    Returns
    -------
    (n, 3, h, w)
    """
    levels = len(logits)
    bounded = [
        level.contiguous().clamp(-options.logit_bound, options.logit_bound) for level in logits
    ]
    layouts = [level_layout(level, levels, options) for level in range(levels)]
    light, held = [irradiance_nchw], [samples_nchw]
    for maps, layout in zip(bounded[:-1], layouts[:-1], strict=True):
        importance = maps[:, layout.pool].exp()
        weight = importance * held[-1]
        pooled = F.avg_pool2d(torch.cat([weight * light[-1], weight, importance], 1), 2)
        light.append(pooled[:, :3] / pooled[:, 3:4])
        held.append(pooled[:, 3:4] / pooled[:, 4:])
    result: Tensor | None = None
    for level in reversed(range(levels)):
        maps, layout, own = bounded[level], layouts[level], light[level]
        logit = maps[:, layout.blend]
        zero = torch.zeros_like(logit[:, :1])
        if result is None:
            shares = torch.cat([zero, logit], 1).softmax(1)
            total = shares[:, :1] * own
        else:
            shares = torch.cat([logit, zero], 1).softmax(1)
            total = shares[:, :1] * own + shares[:, -1:] * F.interpolate(
                result, scale_factor=2.0, mode="bilinear", align_corners=False
            )
        weights = maps[:, layout.importance].exp() * held[level]
        for index, size in enumerate(options.kernel_sizes):
            weight = weights[:, index : index + 1]
            sums = box(torch.cat([weight * own, weight], 1), size)
            total = total + shares[:, index + 1 : index + 2] * (sums[:, :3] / sums[:, 3:])
        result = total
    assert result is not None
    return result


def renewed(
    irradiance_nchw: Tensor,
    samples_nchw: Tensor,
    new_nchw: Tensor,
    worth_nchw: Tensor,
    logits_nchw: Tensor,
    options: PyramidKernels,
) -> tuple[Tensor, Tensor]:
    """What was accumulated, with more of the new sample where the past does not hold.

    Parameters
    ----------
    irradiance_nchw : (n, 3, h, w)
        Accumulated.
    samples_nchw : (n, 1, h, w)
        Samples that each pixel holds, > 0.
    new_nchw : (n, 3, h, w)
        Irradiance of this frame.
    worth_nchw : (n, 1, h, w)
        What its samples are worth, > 0.
    logits_nchw : (n, planes, h, w)
        Of the finest level; that of `LevelLayout.renew` is used.
    options
        The bound of the logits.

    Returns
    -------
    (n, 3, h, w), (n, 1, h, w)
        Irradiance, and the samples that it holds.
    """
    layout = level_layout(0, 2, options)
    more = logits_nchw[:, layout.renew].clamp(-options.logit_bound, options.logit_bound).exp()
    total = samples_nchw + more * worth_nchw
    light = (samples_nchw * irradiance_nchw + more * worth_nchw * new_nchw) / total
    return light, total / (1 + more)


def resolve(
    radiance_nchw: Tensor,
    logits_nchw: Tensor,
    previous_nchw: Tensor,
    valid_nchw: Tensor,
    options: PyramidKernels,
) -> Tensor:
    """Average each pixel with its neighbours and with the previous output.

    Parameters
    ----------
    radiance_nchw : (n, 3, h, w)
        Filtered and re-modulated.
    logits_nchw : (n, planes, h, w)
        Of the finest level; those of `LevelLayout.resolve` are used.
    previous_nchw : (n, 3, h, w)
        Radiance of the previous output at these pixels.
    valid_nchw : (n, 1, h, w)
        How much of it lay in the frame, [0, 1].
    options
        The bound of the logits.

    Returns
    -------
    (n, 3, h, w)
    """
    layout = level_layout(0, 2, options)
    weights = logits_nchw[:, layout.resolve].clamp(-options.logit_bound, options.logit_bound).exp()
    height, width = radiance_nchw.shape[2:]
    padded = F.pad(radiance_nchw, (1, 1, 1, 1), mode="replicate")
    past = weights[:, -1:] * valid_nchw
    total = radiance_nchw + past * previous_nchw
    for index, (down, right) in enumerate(NEIGHBOURS):
        moved = padded[..., 1 + down : 1 + down + height, 1 + right : 1 + right + width]
        total = total + weights[:, index : index + 1] * moved
    return total / (1 + weights[:, :-1].sum(1, keepdim=True) + past)

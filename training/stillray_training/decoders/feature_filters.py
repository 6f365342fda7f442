"""Differentiable reconstruction: the twin, in PyTorch, of
`stillray.families.feature_reconstruction`, which says what it does and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch.nn import functional as F

from stillray.families.feature_reconstruction import Rules
from stillray.families.filter_layout import GaussianPlanes, level_layout, target_layout
from stillray.stages.history_rejection import Noise
from stillray_training.decoders.demodulate import divisor
from stillray_training.decoders.gaussian import gaussian, share_of_bright


@dataclass(frozen=True)
class Enlarged:
    """A frame at the picture's pixels, ``(n, 3, h, w)`` each; zeros for albedos that there are
    not. The exposure is ``(n, 1, 1, 1)``."""

    color: Tensor
    albedo: Tensor
    specular: Tensor
    exposure: Tensor


@dataclass(frozen=True)
class Remembered:
    """What is remembered, ``(n, 4, h, w)`` each.

    Attributes
    ----------
    light, albedo, specular
        Means, and the samples that they are worth: 0 where the past is not known.
    output
        The last picture, and the logarithm of its depth.
    noises
        Of the samples of each patch, see `stillray_training.upscaling.agreement`; None where
        nothing was compared yet.
    recalled : (n, 1, h, w) or None
        What light and picture weigh, as a share of what the network says, see
        `stillray.stages.recall`; None: all of it.
    """

    light: Tensor
    albedo: Tensor
    specular: Tensor
    output: Tensor
    noises: tuple[Noise | None, ...] | None = field(default=None, kw_only=True)
    recalled: Tensor | None = field(default=None, kw_only=True)


def reconstruct(
    frame: Enlarged, past: Remembered, outputs: Sequence[Tensor], rules: Rules
) -> tuple[Tensor, tuple[Tensor, Tensor, Tensor]]:
    """The picture of a frame, and what is accumulated with it.

    Parameters
    ----------
    frame, past
        At the picture's pixels; sizes that all levels divide.
    outputs
        The network's planes, the picture's by blocks of 2x2 pixels first.
    rules
        Of the specification.

    Returns
    -------
    (n, 3, h, w)
        The picture.
    tuple of (n, 4, h, w)
        Light, albedo and specular albedo with their samples.
    """
    bound = rules.filters.logit_bound
    levels = len(outputs)
    layout = target_layout(levels, rules.filters)
    finest, *coarser = (planes.clamp(-bound, bound) for planes in outputs)
    finest = F.pixel_shuffle(finest, 2)
    enlarged = _filtered(frame.color, finest, layout.light)
    guides = _filtered(torch.cat([frame.albedo, frame.specular], 1), finest, layout.guides)
    keep = finest[:, layout.keep].split(1, 1)
    new = (enlarged, *guides.split(3, 1))
    before = (past.light, past.albedo, past.specular)
    odds = [each.exp() for each in keep]
    picture = finest[:, layout.output : layout.output + 1].exp()
    if past.recalled is not None:
        odds[0], picture = odds[0] * past.recalled, picture * past.recalled
    light, albedo, specular = (
        _accumulated(parts[0], parts[1], parts[2], rules.max_samples)
        for parts in zip(new, before, odds, strict=True)
    )
    by = divisor(albedo[:, :3], rules.demodulate)
    by_specular = divisor(specular[:, :3], rules.demodulate)
    planes = torch.cat([light[:, :3] / by, light[:, :3] / by_specular, light[:, :3]], 1)
    shares = _shares(finest[:, layout.partition])[:, 1:] * light[:, 3:]
    pools = []
    for level, share in enumerate(shares.split(1, 1), start=1):
        pooled = F.avg_pool2d(torch.cat([planes * share, share], 1), 1 << level)
        pools.append(pooled[:, :-1] / pooled[:, -1:])

    def share_of(values: Tensor) -> Tensor | None:
        """What pixels weigh by the brightness of their light as it is."""
        tone = rules.filters.filter_tone
        return share_of_bright(values[:, 6:].detach(), frame.exposure, tone) if tone else None

    result: Tensor | None = None
    for level in reversed(range(1, levels)):
        own = level_layout(level, levels, rules.filters)
        maps, values = coarser[level - 1], pools[level - 1]
        if result is not None:
            values = _mixed(values, result, maps, own.coarser)
        for distance in own.distances:
            values = _filtered(values, maps, own.denoise, distance, share_of(values))
        result = values
    if result is not None:
        planes = _mixed(planes, result, finest, layout.coarser)
    planes = _filtered(planes, finest, layout.denoise, 1, share_of(planes))
    plain, diffuse, glossy, alone = _shares(finest[:, layout.compose]).split(1, 1)
    image = diffuse * planes[:, :3] * by + glossy * planes[:, 3:6] * by_specular
    image = image + plain * planes[:, 6:] + alone * enlarged
    known = (past.light[:, 3:] > 0).to(image.dtype)
    held = picture / (1 + picture) * known
    image = image * (1 - held) + held * past.output[:, :3]
    return image, (light, albedo, specular)


def _filtered(
    values: Tensor,
    maps: Tensor,
    planes: GaussianPlanes,
    distance: int = 1,
    share: Tensor | None = None,
) -> Tensor:
    weight = maps[:, planes.importance : planes.importance + 1].exp()
    if share is not None:
        weight = weight * share
    return gaussian(values, maps[:, planes.features], weight, weight, distance)


def _accumulated(new: Tensor, past: Tensor, factor: Tensor, most: float) -> Tensor:
    held = factor * past[:, 3:]
    total = held + 1
    mean = (held * past[:, :3] + new) / total
    count = (total * total / (held * factor + 1)).clamp(max=most)
    return torch.cat([mean, count], 1)


def _mixed(values: Tensor, below: Tensor, maps: Tensor, logit: int | None) -> Tensor:
    assert logit is not None
    share = maps[:, logit : logit + 1].sigmoid()
    twice = F.interpolate(below, scale_factor=2.0, mode="nearest")
    return values * (1 - share) + share * twice


def _shares(logits: Tensor) -> Tensor:
    return torch.cat([torch.zeros_like(logits[:, :1]), logits], 1).softmax(1)

"""Differentiable reconstruction: the twin, in PyTorch, of `stillray.families.kernel_pyramid`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from stillray.families.pyramid_logits import NEIGHBOURS, level_layout
from stillray.model_spec.decoders import PyramidKernels
from stillray_training.decoders.boxes import BoxMean
from stillray_training.decoders.gaussian import gaussian, share_of_bright
from stillray_training.decoders.luminance import luminance


class LevelParts(NamedTuple):
    """Bounded logits of one level, ``(n, planes, h, w)`` each, by what they are for.

    See `stillray.families.pyramid_logits.LevelLayout`.
    """

    importance: Tensor
    pool: Tensor
    blend: Tensor
    resolve: Tensor
    sample_blend: Tensor
    double: Tensor
    around: Tensor
    features: Tensor
    filters: Tensor


def level_parts(logits: Sequence[Tensor], options: PyramidKernels) -> list[LevelParts]:
    """What a network gave, taken apart and bounded once for all that read it.

    Parameters
    ----------
    logits
        One map a level, finest first, see `stillray.families.pyramid_logits.level_layout`; the
        finest may come as planes of half its size, see `depth_to_space.DepthToSpace`.
    options
        The bound.
    """
    finest, *coarser = logits
    if finest.shape[2:] == coarser[0].shape[2:]:
        finest = F.pixel_shuffle(finest, 2)
    bound = options.logit_bound
    levels = []
    for level, planes in enumerate((finest, *coarser)):
        layout = level_layout(level, len(logits), options)
        # one split, not slices: the gradient of a slice is a whole map of zeros
        parts = (getattr(layout, name) for name in LevelParts._fields)
        sizes = [part.stop - part.start for part in parts]
        levels.append(LevelParts(*planes.contiguous().clamp(-bound, bound).split(sizes, 1)))
    return levels


def kernel_pyramid(
    irradiance_nchw: Tensor,
    samples_nchw: Tensor,
    maps: Sequence[LevelParts],
    options: PyramidKernels,
    box: Callable[[Tensor, int], Tensor] = BoxMean.apply,
    exposure: Tensor | None = None,
) -> Tensor:
    """Filter at every resolution and blend from the coarsest to the finest.

    Parameters
    ----------
    irradiance_nchw : (n, 3, h, w)
        Sizes that are multiples of 2^(levels - 1).
    samples_nchw : (n, 1, h, w)
        Samples that each pixel holds, > 0.
    maps
        Of `level_parts`.
    options
        Kernel sizes.
    box
        How window means are taken.
    exposure : (n, 1, 1, 1)
        What irradiance is multiplied by before bright pixels are told; asked for by `filter_tone`.

    Returns
    -------
    (n, 3, h, w)
    """
    levels = len(maps)
    layouts = [level_layout(level, levels, options) for level in range(levels)]
    light, held = [irradiance_nchw], [samples_nchw]
    for parts in maps[:-1]:
        importance = parts.pool.exp()
        weight = importance * held[-1]
        pooled = F.avg_pool2d(torch.cat([weight * light[-1], weight, importance], 1), 2)
        weighted, total_weight, total = pooled.split((3, 1, 1), 1)
        light.append(weighted / total_weight)
        held.append(total_weight / total)
    result: Tensor | None = None
    for level in reversed(range(levels)):
        own = light[level]
        blend = maps[level].blend
        if result is not None:  # a sample that weighs less than one counts as little
            sample_weight = held[level].clamp(max=1).log()
            blend = torch.cat([blend[:, :1] + sample_weight, blend[:, 1:]], 1)
        zero = torch.zeros_like(blend[:, :1])
        logit = torch.cat([zero, blend, maps[level].around], 1)
        first, *others = logit.softmax(1).split(1, 1)
        if result is None:
            total = first * own
        else:
            itself, *others = others
            total = itself * own + first * doubled(result, maps[level + 1].double)
        weights = (maps[level].importance.exp() * held[level]).unbind(1)
        # none where the finest level has no kernels; shares of neighbours follow
        for size, plane, share in zip(options.kernel_sizes, weights, others, strict=False):
            weight = plane[:, None]
            sums, normal = box(torch.cat([weight * own, weight], 1), size).split((3, 1), 1)
            total = total + share * (sums / normal)
        if maps[level].around.shape[1]:
            moved = [each for far in layouts[level].distances for each in shifted(own, far)]
            neighbours = zip(moved, others[-len(moved) :], strict=True)
            total = total + sum(share * neighbour for neighbour, share in neighbours)
        result = total
    assert result is not None
    finest = maps[0]
    logits = finest.filters
    if options.filter_tone:
        assert exposure is not None
        logits = logits + share_of_bright(result.detach(), exposure, options.filter_tone).log()
    pairs = zip(layouts[0].filter_distances, logits.split(2, 1), strict=False)
    for distance, pair in pairs:
        weight, own = pair.exp().split(1, 1)
        result = gaussian(result, finest.features, weight, own, distance)
    return result


def shifted(planes_nchw: Tensor, distance: int = 1) -> list[Tensor]:
    """The eight `NEIGHBOURS` of every pixel at a distance, the border repeated."""
    height, width = planes_nchw.shape[2:]
    padded = F.pad(planes_nchw, [distance] * 4, mode="replicate")
    starts = [(distance * (1 + down), distance * (1 + right)) for down, right in NEIGHBOURS]
    return [padded[..., top : top + height, left : left + width] for top, left in starts]


def doubled(coarser_nchw: Tensor, logits_nchw: Tensor) -> Tensor:
    """A level at twice its resolution, see `stillray.families.pyramid_upsample`.

    Parameters
    ----------
    coarser_nchw : (n, 3, h, w)
    logits_nchw : (n, 8, h, w)
        Bounded.

    Returns
    -------
    (n, 3, 2 h, 2 w)
    """
    height, width = coarser_nchw.shape[2:]
    padded = F.pad(coarser_nchw, (1, 1, 1, 1), mode="replicate")
    left, right = (padded[:, :, 1:-1, at : at + width] for at in (0, 2))
    up, down = (padded[:, :, at : at + height, 1:-1] for at in (0, 2))
    beside, above = F.pixel_shuffle(logits_nchw.exp(), 2).split(1, 1)
    own = F.interpolate(coarser_nchw, scale_factor=2.0, mode="nearest")
    total = 2 * own + beside * _corners(left, right, left, right)
    total = total + above * _corners(up, up, down, down)
    return total / (2 + beside + above)


def _corners(*corners_nchw: Tensor) -> Tensor:
    """Top left, top right, bottom left and bottom right pixels of 2x2 blocks as one image."""
    return F.pixel_shuffle(torch.stack(corners_nchw, 2).flatten(1, 2), 2)


def blended_with_sample(
    irradiance_nchw: Tensor,
    samples_nchw: Tensor,
    new_nchw: Tensor,
    weight_nchw: Tensor,
    logits_nchw: Tensor,
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
    weight_nchw : (n, 1, h, w)
        What its samples weigh, > 0.
    logits_nchw : (n, 1, h, w)
        `LevelParts.sample_blend` of the finest level.

    Returns
    -------
    (n, 3, h, w), (n, 1, h, w)
        Irradiance, and the samples that it holds.
    """
    more = logits_nchw.exp()
    total = samples_nchw + more * weight_nchw
    light = (samples_nchw * irradiance_nchw + more * weight_nchw * new_nchw) / total
    return light, total / (1 + more)


def averaged_albedo(albedo_nchw: Tensor, logits_nchw: Tensor, distances: Sequence[int]) -> Tensor:
    """The albedo that a picture is multiplied by, averaged where the resolve is wide open.

    Parameters
    ----------
    albedo_nchw : (n, 3, h, w)
    logits_nchw : (n, 9, h, w)
        `LevelParts.resolve` of the finest level.
    distances
        Of the neighbours, pixels, one average after the other.

    Returns
    -------
    (n, 3, h, w)
    """
    near = (2 * logits_nchw[:, :-1]).exp()
    total = 1 + near.sum(1, keepdim=True)
    for distance in distances:
        moved = zip(near.split(1, 1), shifted(albedo_nchw, distance), strict=True)
        albedo_nchw = (albedo_nchw + sum(weight * each for weight, each in moved)) / total
    return albedo_nchw


def resolve(
    radiance_nchw: Tensor,
    logits_nchw: Tensor,
    previous_nchw: Tensor,
    valid_nchw: Tensor,
    tone: Tensor | None = None,
) -> Tensor:
    """Average each pixel with its neighbours and with the previous output.

    Parameters
    ----------
    radiance_nchw : (n, 3, h, w)
        Filtered and re-modulated.
    logits_nchw : (n, 9, h, w)
        `LevelParts.resolve` of the finest level.
    previous_nchw : (n, 3, h, w)
        Radiance of the previous output at these pixels.
    valid_nchw : (n, 1, h, w)
        How much of it lay in the frame, [0, 1].
    tone : (n, 1, 1, 1) or None
        What luminance is multiplied by where a brighter neighbour weighs less; None: it does not.

    Returns
    -------
    (n, 3, h, w)
    """
    near, past = logits_nchw.exp().split((logits_nchw.shape[1] - 1, 1), 1)
    if tone is not None:
        near = near * _share_of_brighter(radiance_nchw.detach(), tone)
    past = past * valid_nchw
    total = radiance_nchw + past * previous_nchw
    for weight, moved in zip(near.split(1, 1), shifted(radiance_nchw), strict=True):
        total = total + weight * moved
    return total / (1 + near.sum(1, keepdim=True) + past)


def _share_of_brighter(radiance_nchw: Tensor, tone: Tensor) -> Tensor:
    """(1 + tone L) / (1 + tone L') of the eight neighbours, at most 1."""
    toned = 1 + tone * luminance(radiance_nchw)
    return (toned / torch.cat(shifted(toned), 1)).clamp(max=1)

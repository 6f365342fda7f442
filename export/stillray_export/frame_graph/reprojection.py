"""Where a pixel's surface was, and what was known of it: the twin of `stages.reproject`."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from stillray.model_spec.stages import Temporal
from stillray.stages.reproject import LEAST_BLUR, SMOOTH_DEPTH, SMOOTH_NORMAL
from stillray_export.frame_graph.lookup import (
    linear_taps,
    mean_of,
    pixels_of,
    planes_like,
)
from stillray_export.frame_graph.recall import near_edges, sharpness

_EMPTY_DEPTH = -100.0
_NO_NORMAL = 0.25
_TINY = 1e-12


def guide_planes(normal_nchw: Tensor, depth_nchw: Tensor) -> Tensor:
    """Normal and the logarithm of depth, ``(1, 4, h, w)``, see `stages.reproject.guide_planes`.

    differs from the runtime's: every normal is brought to length 1, also where all are within 2 %
    of it.

    Parameters
    ----------
    normal_nchw : (1, 3, h, w)
        0 where nothing was hit, and everywhere where normals are not given.
    depth_nchw : (1, 1, h, w)
        0 where nothing was hit, and everywhere where depth is not given.
    """
    none = normal_nchw.abs().amax(1, keepdim=True) <= _NO_NORMAL
    length = normal_nchw.square().sum(1, keepdim=True).sqrt()
    normal = normal_nchw / torch.where(none, 1.0, length)
    x, yz = normal[:, :1], normal[:, 1:]
    x, yz = torch.where(none, 1.0, x), torch.where(none, 0.0, yz)
    given = depth_nchw.amax() > 0
    logarithm = depth_nchw.clamp(1e-30, 1e30).log()
    logarithm = torch.where(depth_nchw > 0, logarithm, _EMPTY_DEPTH)
    # without depth, what has no normal is told apart by it
    instead = torch.where(none, _EMPTY_DEPTH, 0.0)
    return torch.cat([x, yz, torch.where(given, logarithm, instead)], 1)


def reproject(
    past_nhwc: Tensor,
    before_nhwc: Tensor,
    now_nchw: Tensor,
    places: Tensor,
    options: Temporal,
    output_nhwc: Tensor,
) -> Tensor:
    """Bring the history to the current pixels, see `stillray.stages.reproject.reproject`.

    Parameters
    ----------
    past_nhwc : (h, w, 4)
        Irradiance and, last, the samples that it holds.
    before_nhwc : (h, w, 4)
        Guides of the previous frame, see `guide_planes`.
    now_nchw : (1, 4, h, w)
        Guides of this one.
    places : (1, 2, h, w)
        Where each pixel was, x and y in pixels.
    output_nhwc : (h, w, 3)
        The last output.

    Returns
    -------
    (1, 4, h, w)
        Zeros where no tap was accepted.
    """
    past, before = past_nhwc.flatten(0, 1), before_nhwc.flatten(0, 1)
    now = pixels_of(now_nchw)
    taps = linear_taps(places, now_nchw)
    guides = [tap.of(before) for tap in taps]
    light = [tap.of(past) for tap in taps]
    weights = [tap.weight * tap.inside for tap in taps]
    # where the four are one smooth surface they share their fate
    span = _of(torch.maximum, guides) - _of(torch.minimum, guides)
    limits = torch.tensor([SMOOTH_NORMAL] * 3 + [SMOOTH_DEPTH], dtype=torch.float32)
    rough = (span - limits).amax(1, keepdim=True)
    inside = _of(torch.minimum, [tap.inside for tap in taps])
    smooth = (rough <= 0) & (inside > 0)
    interpolated = mean_of(taps, before, zeros=False)
    together = _same_surface(interpolated, now, options)
    alone = [
        torch.where(smooth, together, _same_surface(guide, now, options)) * weight
        for guide, weight in zip(guides, weights, strict=True)
    ]
    total = _of(torch.add, [share * pixel for share, pixel in zip(alone, light, strict=True)])
    accepted = _of(torch.add, alone).clamp(min=_TINY)
    samples = total[:, 3:]
    if options.edge_blur:
        most = options.most_blur or math.inf
        near = near_edges(output_nhwc, places, options.sharp_contrast) > 0
        bound = torch.where(near, min(most, options.edge_blur), most)
        samples = torch.minimum(samples, bound / pixels_of(_blur(places)))
    elif options.most_blur:
        samples = torch.minimum(samples, options.most_blur / pixels_of(_blur(places)))
    # shares of a smooth surface add up to 1
    irradiance = total[:, :3] / torch.where(smooth, 1.0, accepted)
    if options.sharp_contrast:
        factor, contrast = sharpness(output_nhwc, places)
        edge = smooth & (contrast > options.sharp_contrast)
        irradiance = irradiance * torch.where(edge, factor, 1.0)
    return planes_like(torch.cat([irradiance, samples], 1), now_nchw)


def _blur(places: Tensor) -> Tensor:
    """Square pixels by which a look at places ``(1, 2, h, w)`` blurs, ``(1, 1, h, w)``."""
    share = places - places.floor()
    return (share * (1 - share)).sum(1, keepdim=True).clamp(min=LEAST_BLUR)


def _same_surface(before: Tensor, now: Tensor, options: Temporal) -> Tensor:
    """1 where pixels of guides ``(n, 4)`` show one surface, ``(n, 1)``."""
    cosine = (before[:, :3] * now[:, :3]).sum(1, keepdim=True)
    apart = (before[:, 3:] - now[:, 3:]).abs()
    same = (apart <= math.log1p(options.depth_ratio)) & (cosine >= options.normal_cosine)
    return same.to(torch.float32)


def _of(pick: Callable[[Tensor, Tensor], Tensor], parts: list[Tensor]) -> Tensor:
    found = parts[0]
    for part in parts[1:]:
        found = pick(found, part)
    return found

"""A filter by feature distances, differentiable: the twin of `stillray.families.gaussian`.

`gaussian` is the definition as operators of a graph. Where a gradient is wanted, `_Gaussian` does
the same with a gradient of its own: each pair of pixels is compared once, sums are made in place.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F

from stillray.families.gaussian import MOST_DISTANCE, MOST_TONED
from stillray.families.pyramid_logits import NEIGHBOURS
from stillray_training.decoders.luminance import luminance


def gaussian(
    values: Tensor, features: Tensor, weight: Tensor, own: Tensor, distance: int = 1
) -> Tensor:
    """Weighted means of 3x3 pixels, see `stillray.families.gaussian.gaussian`.

    Parameters
    ----------
    values : (n, c, h, w)
    features : (n, k, h, w)
    weight : (n, 1, h, w)
        What a pixel weighs to others, above 0; none has any outside.
    own : (n, 1, h, w)
        And to itself.
    distance
        From pixel to pixel.

    Returns
    -------
    (n, c, h, w)
    """
    if torch.is_grad_enabled() and not torch.compiler.is_compiling():
        mean: Tensor = _Gaussian.apply(values, features, weight, own, distance)
        return mean
    height, width = values.shape[2:]
    channels = values.shape[1]
    padded = F.pad(torch.cat([values, weight, features], 1), [distance] * 4)
    # all neighbours at once: a loop would be five times as many operators in a graph
    beside = torch.stack(
        [
            padded[..., top : top + height, left : left + width]
            for top, left in ((distance * (1 + d), distance * (1 + r)) for d, r in NEIGHBOURS)
        ],
        1,
    )
    apart = (features[:, None] - beside[:, :, channels + 1 :]).square().sum(2, keepdim=True)
    share = (-apart.clamp(max=MOST_DISTANCE)).exp() * beside[:, :, channels : channels + 1]
    total = own + share.sum(1)
    return (values * own + (share * beside[:, :, :channels]).sum(1)) / total


def share_of_bright(light_nchw: Tensor, exposure: Tensor, tone: float) -> Tensor:
    """See `stillray.families.gaussian.share_of_bright`; ``(n, 1, h, w)``."""
    return 1 / (tone * exposure * luminance(light_nchw) + 1 - tone).clamp(1.0, float(MOST_TONED))


class _Gaussian(torch.autograd.Function):
    """`gaussian` with its gradient written out."""

    @staticmethod
    def forward(
        ctx: Any, values: Tensor, features: Tensor, weight: Tensor, own: Tensor, distance: int
    ) -> Tensor:
        """See `gaussian`."""
        total, sums = own.clone(), values * own
        likenesses = []
        for here, there in _pairs(values.shape, distance):
            apart = (features[here] - features[there]).square_().sum(1, keepdim=True)
            alike = apart.clamp_(max=MOST_DISTANCE).neg_().exp_()
            for to, of in ((here, there), (there, here)):
                share = alike * weight[of]
                total[to] += share
                sums[to].addcmul_(share, values[of])
            likenesses.append(alike)
        mean = sums.div_(total)
        ctx.distance = distance
        ctx.save_for_backward(values, features, weight, own, total, mean, *likenesses)
        return mean

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:  # type: ignore[override]
        """Of values, features, weight and own."""
        values, features, weight, own, total, mean, *likenesses = ctx.saved_tensors
        of_sums = gradients[0] / total
        of_total = -(of_sums * mean).sum(1, keepdim=True)
        of_values = of_sums * own
        of_own = (of_sums * values).sum(1, keepdim=True).add_(of_total)
        of_features, of_weight = torch.zeros_like(features), torch.zeros_like(weight)
        # where pixels are as far apart as can be, the distance is held and has no gradient
        least = torch.tensor(-MOST_DISTANCE, dtype=values.dtype).exp()
        for (here, there), alike in zip(
            _pairs(values.shape, ctx.distance), likenesses, strict=True
        ):
            of_alike = torch.zeros_like(alike)
            for to, of in ((here, there), (there, here)):
                of_share = (of_sums[to] * values[of]).sum(1, keepdim=True).add_(of_total[to])
                of_values[of].addcmul_(alike * weight[of], of_sums[to])
                of_weight[of].addcmul_(alike, of_share)
                of_alike.addcmul_(weight[of], of_share)
            of_apart = of_alike.mul_(alike).mul_(-2 * (alike > least))
            change = (features[here] - features[there]).mul_(of_apart)
            of_features[here] += change
            of_features[there] -= change
        return of_values, of_features, of_weight, of_own, None


def _pairs(shape: torch.Size, distance: int) -> Iterator[tuple[Any, Any]]:
    """Each pair of neighbours once, as indices of where one and where the other of all is."""
    height, width = shape[2:]
    for down, right in NEIGHBOURS:
        down, right = distance * down, distance * right
        if (down, right) < (0, 0) or down >= height or abs(right) >= width:
            continue
        left = max(-right, 0)
        across = width - abs(right)
        here = (..., slice(0, height - down), slice(left, left + across))
        there = (..., slice(down, height), slice(left + right, left + right + across))
        yield here, there

"""A filter by feature distances, differentiable: the twin of `stillray.families.gaussian`."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from stillray.families.gaussian import MOST_DISTANCE
from stillray.families.pyramid_logits import NEIGHBOURS


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

"""The filter of Choi et al. 2024 as torch sees it; the runtime's is
`stillray.families.cross_bilateral`."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from stillray.families.cross_bilateral import EPSILON, WINDOW, taps

_REACH = WINDOW // 2


def neighbours(planes: Tensor, thinned: bool) -> Tensor:
    """What each pixel's window holds: ``(c, h, w)`` to ``(taps, c, h, w)``, zeros outside."""
    height, width = planes.shape[1:]
    padded = F.pad(planes, (_REACH,) * 4)
    return torch.stack(
        [
            padded[:, y + _REACH : y + _REACH + height, x + _REACH : x + _REACH + width]
            for y, x in taps(thinned)
        ]
    )


def cross_bilateral(
    pilots: Tensor, guides: Tensor, inside: Tensor, parameters: Tensor, *, thinned: bool
) -> tuple[Tensor, Tensor]:
    """Both estimates filtered in space, and the sums of their weights (eq. 8, first part; eq. 9).

    Parameters
    ----------
    pilots : (6, h, w)
        Both estimates.
    guides : (6, h, w)
        Albedo, normals.
    inside : (1, h, w)
        1 where there is a frame, 0 beyond.
    parameters : (6, h, w)
        See `stillray.families.cross_bilateral`.

    Returns
    -------
    filtered : (2, 3, h, w)
    weights : (2, h, w)
    """
    height, width = inside.shape[1:]
    around = neighbours(torch.cat([pilots, guides, inside]), thinned)
    count = len(around)
    apart = (around[:, :12] - torch.cat([pilots, guides])) ** 2
    squares = apart.reshape(count, 4, 3, height, width).sum(2)
    places = torch.tensor([(y * y + x * x) / _REACH**2 for y, x in taps(thinned)])
    # split, not sliced: the derivative of a slice is a plane of zeros that is written into
    bands, place, _ = parameters.split([4, 1, 1])
    of_halves, of_guides = (squares / (bands**2 + float(EPSILON))).split([2, 2], 1)
    shared = of_guides.sum(1, keepdim=True)
    shared = shared + places[:, None, None, None] / (place**2 + float(EPSILON))
    weights = torch.exp(-(of_halves + shared)) * around[:, 12:]
    total = weights.sum(0)
    values = around[:, :6].reshape(count, 2, 3, height, width)
    # beyond the frame no window has any weight
    filtered = (values * weights[:, :, None]).sum(0) / total.clamp_min(1e-30)[:, None]
    return filtered, total

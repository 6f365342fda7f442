"""Albedo accumulated over frames: the twin of `stillray.stages.albedo_history`."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from stillray.stages.albedo_history import FROM_TINTS, TINTS
from stillray_export.frame_graph.lookup import linear_taps, mean_of, planes_like
from stillray_export.frame_graph.windows import least_around, most_around

_WHOLE = 1 - 1e-3


def accumulate_albedo(
    divisor: Tensor, past_nhwc: Tensor, places: Tensor, held: Tensor, most: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """What the result is multiplied by, what is remembered, and the frames that it holds.

    Parameters
    ----------
    divisor : (1, 3, h, w)
        Of this frame.
    past_nhwc : (h, w, 3)
        What the last frame has left.
    places : (1, 2, h, w)
        Where the pixels' picture was.
    held
        Frames that the past holds, scalar; 0 for none.
    most
        That it is worth at most, scalar.

    Returns
    -------
    modulator, remembered : (1, 3, h, w)
    frames
        Scalar.
    """
    samples = torch.minimum(held, most)
    share = samples / (samples + 1)
    taps = linear_taps(places, divisor)
    inside = sum(tap.weight * tap.inside for tap in taps)
    assert isinstance(inside, Tensor)
    taken = planes_like(mean_of(taps, past_nhwc.flatten(0, 1), zeros=True), divisor)
    taken = torch.where(planes_like(inside, divisor) < _WHOLE, divisor, taken)
    tints, own = _transformed(divisor, TINTS), _transformed(taken, TINTS)
    taken = taken + _transformed(_limited(own, tints) - own, FROM_TINTS)
    taken = _limited(taken, divisor)
    mean = taken * share + divisor * (1 - share)
    # what has no albedo was divided by 1: beside it, no more than this frame was divided by
    none = (divisor.sum(1, keepdim=True) >= 3).to(torch.float32)
    beside = most_around(none) - least_around(none)
    mixed = torch.where(beside > 0, torch.minimum(mean, divisor), mean)
    return torch.where(held > 0, mixed, divisor), mean, samples + 1


def _transformed(planes: Tensor, matrix: np.ndarray) -> Tensor:
    """Planes ``(1, n, h, w)`` by a matrix of n columns."""
    return torch.nn.functional.conv2d(planes, torch.from_numpy(matrix)[:, :, None, None])


def _limited(planes: Tensor, around: Tensor) -> Tensor:
    """Planes within the range of others' 3x3 pixels around."""
    return torch.minimum(torch.maximum(planes, least_around(around)), most_around(around))

"""One step of learning, as a function of tensors alone (Choi et al. 2024, section 4.3).

It is exported as a graph, which the runtime runs without torch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from stillray.model_spec.network_weights import Shapes
from stillray_training.decoders.cross_bilateral import cross_bilateral
from stillray_training.networks.filter_parameters import (
    Differentiable,
    filter_parameters,
    split,
)

#: Of Adam (Kingma and Ba 2015): decays of both moments, and what keeps 0/0 out. It is that of usual
#: slopes of weights that matter: with 1e-7 a weight whose slope is rounding makes steps as long as
#: any other, and no two processors would learn the same (docs/decisions.md).
BETAS = (0.9, 0.999)
ADAM_EPSILON = 1e-4
LOSS_EPSILON = 1e-2  # of eq. 12 and 13, in squares of pilots


@dataclass(frozen=True, kw_only=True)
class Learning:
    """What a step is of.

    Attributes
    ----------
    layout
        Names and shapes of the weights.
    loss_epsilon
        Of eq. 12 and 13, in squares of pilots.
    thinned
        See `stillray.families.cross_bilateral.taps`.
    """

    layout: Shapes
    loss_epsilon: float
    thinned: bool


def loss(weights: Tensor, features: Tensor, past: Tensor, inside: Tensor, how: Learning) -> Tensor:
    """Eq. 11 to 13: how far each half, filtered, is from what the other says, now and a frame ago.

    differs: the paper measures outputs, which the last output has a share in. Here halves are
    accumulated, so that the last output holds samples of the very pilots that it would be measured
    by: it would win whatever it shows, and the picture would freeze (docs/decisions.md). So halves
    are measured before they are blended with it, and the share is held where it begins.

    Parameters
    ----------
    weights : (n,)
    features : (1, 15, h, w)
        Pilots of both halves, albedo, normals, the last output.
    past : (1, 7, h, w)
        The last frame's pilots at these pixels, and 1 where there are any.
    inside : (1, 1, h, w)
        1 where there is a frame.
    how
        What a step is of.
    """
    planes, valid = features[0], past[0, 6:]
    theta = filter_parameters(split(weights, how.layout), features, Differentiable())[0]
    filtered, _ = cross_bilateral(planes[:6], planes[6:12], inside[0], theta, thinned=how.thinned)
    height, width = inside.shape[2:]
    now = planes[:6].reshape(2, 3, height, width).flip(0)
    before = past[0, :6].reshape(2, 3, height, width).flip(0)

    def distance(wanted: Tensor) -> Tensor:
        square = ((filtered - wanted) ** 2).sum(1)
        return (square / ((wanted**2).sum(1) + how.loss_epsilon)).mean(0)

    both = (distance(now) + valid[0] * distance(before)) / 2 + theta[-1] ** 2
    return (both * inside[0, 0]).sum() / inside.sum()


def train_step(
    weights: Tensor,
    first: Tensor,
    second: Tensor,
    step: Tensor,
    rate: Tensor,
    features: Tensor,
    past: Tensor,
    inside: Tensor,
    how: Learning,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """One step of Adam.

    Parameters
    ----------
    weights, first, second : (1, n)
        Weights, and both moments of their slopes.
    step : (1,)
        How many steps there are with this one, 1 or more.
    rate : (1,)
        Of Adam.
    features, past, inside, how
        As `loss` takes them.

    Returns
    -------
    loss : (1,)
        Before the step.
    weights, first, second : (1, n)
        After it.
    """
    slope, value = torch.func.grad_and_value(loss)(weights[0], features, past, inside, how)
    first = BETAS[0] * first + (1 - BETAS[0]) * slope
    second = BETAS[1] * second + (1 - BETAS[1]) * slope**2
    # beta ** step
    decays = [1 - torch.exp(step * math.log(beta)) for beta in BETAS]
    change = first / decays[0] / (torch.sqrt(second / decays[1]) + ADAM_EPSILON)
    return value[None], weights - rate * change, first, second

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
LOSS_EPSILON = 1e-2  # of eq. 12, in squares of pilots
OWN_SHARE = 1 / 3  # of a half's own samples in the loss


@dataclass(frozen=True, kw_only=True)
class Learning:
    """What a step is of.

    Attributes
    ----------
    layout
        Names and shapes of the weights.
    loss_epsilon
        Of eq. 12, in squares of pilots.
    thinned
        See `stillray.families.cross_bilateral.taps`.
    """

    layout: Shapes
    loss_epsilon: float
    thinned: bool


def loss(
    weights: Tensor, features: Tensor, halves: Tensor, inside: Tensor, how: Learning
) -> Tensor:
    """Eq. 11 and 12: how far each half, filtered, is from what the other says, and from itself.

    differs: the paper measures outputs, which the last output has a share in. Here halves are
    accumulated, so that the last output holds samples of the very pilots that it would be measured
    by: it would win whatever it shows, and the picture would freeze (docs/decisions.md). So halves
    are measured before they are blended with it, and the share is held where it begins.

    differs: the paper's other half of the loss is of the last frame's pilots (eq. 13), which
    accumulated ones hold already. Here it is of what either half has accumulated, before any
    regression: pilots agree on what they blur, and a filter that nothing else tells of it blurs
    more with every step. What explains leaves no noise of its own in a pilot, so that it is not
    learned to be kept.

    Parameters
    ----------
    weights : (n,)
    features : (1, 15, h, w)
        Pilots of both halves, albedo, normals, the last output.
    halves : (1, 6, h, w)
        What both have accumulated, as pilots are.
    inside : (1, 1, h, w)
        1 where there is a frame.
    how
        What a step is of.
    """
    planes = features[0]
    theta = filter_parameters(split(weights, how.layout), features, Differentiable())[0]
    filtered, _ = cross_bilateral(planes[:6], planes[6:12], inside[0], theta, thinned=how.thinned)
    height, width = inside.shape[2:]
    other = planes[:6].reshape(2, 3, height, width).flip(0)
    own = halves[0].reshape(2, 3, height, width)

    def distance(wanted: Tensor) -> Tensor:
        square = ((filtered - wanted) ** 2).sum(1)
        return (square / ((wanted**2).sum(1) + how.loss_epsilon)).mean(0)

    both = torch.lerp(distance(other), distance(own), OWN_SHARE) + theta[-1] ** 2
    return (both * inside[0, 0]).sum() / inside.sum()


def train_step(
    weights: Tensor,
    first: Tensor,
    second: Tensor,
    step: Tensor,
    rate: Tensor,
    features: Tensor,
    halves: Tensor,
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
    features, halves, inside, how
        As `loss` takes them.

    Returns
    -------
    loss : (1,)
        Before the step.
    weights, first, second : (1, n)
        After it.
    """
    slope, value = torch.func.grad_and_value(loss)(weights[0], features, halves, inside, how)
    first = BETAS[0] * first + (1 - BETAS[0]) * slope
    second = BETAS[1] * second + (1 - BETAS[1]) * slope**2
    # beta ** step
    decays = [1 - torch.exp(step * math.log(beta)) for beta in BETAS]
    change = first / decays[0] / (torch.sqrt(second / decays[1]) + ADAM_EPSILON)
    return value[None], weights - rate * change, first, second

"""How a training goes from step to step: its rate of learning, and the mean of its weights."""

from __future__ import annotations

import math

import torch
from torch import nn

from stillray.model_spec import ModelSpec


def learning_rate(step: int, spec: ModelSpec) -> float:
    """A short linear rise, then a cosine decay to one per cent."""
    recipe = spec.training
    rise = min(1.0, (step + 1) / 100)
    return (
        recipe.learning_rate
        * rise
        * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * min(step / recipe.steps, 1.0))))
    )


def follow(average: nn.Module, network: nn.Module, decay: float) -> None:
    """A step of a running mean of weights."""
    with torch.no_grad():
        for mean, weight in zip(average.parameters(), network.parameters(), strict=True):
            mean.lerp_(weight, 1 - decay)

"""How a training goes from step to step: its optimiser, rate of learning, and mean of weights."""

from __future__ import annotations

import math

import torch
from torch import nn

from stillray.model_spec import ModelSpec
from stillray.model_spec.loader import Training
from stillray_training.muon import Muon


def optimiser_of(network: nn.Module, recipe: Training) -> torch.optim.Optimizer:
    """The recipe's optimiser over all weights."""
    of = {"adam": torch.optim.AdamW, "muon": Muon}[recipe.optimiser]
    return of(network.parameters(), lr=recipe.learning_rate, weight_decay=recipe.weight_decay)


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

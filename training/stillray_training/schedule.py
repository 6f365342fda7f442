"""How a training goes from step to step: its optimiser, rate of learning, and mean of weights."""

from __future__ import annotations

import math

import torch
from torch import nn

from stillray.model_spec.training import Training
from stillray_training.muon import Muon


def optimiser_of(network: nn.Module, recipe: Training) -> torch.optim.Optimizer:
    """The recipe's optimiser over all weights."""
    of = {"adam": torch.optim.AdamW, "muon": Muon}[recipe.optimiser]
    return of(network.parameters(), lr=recipe.learning_rate, weight_decay=recipe.weight_decay)


def learning_rate(step: int, done: float, recipe: Training) -> float:
    """A short linear rise over steps, then a cosine decay to one per cent.

    Parameters
    ----------
    step
        From 0 on.
    done
        Part of the training that is done, [0, 1].
    recipe
        The rate to begin with.
    """
    rise = min(1.0, (step + 1) / 100)
    return recipe.learning_rate * rise * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * done)))


def follow(average: nn.Module, network: nn.Module, decay: float) -> None:
    """A step of a running mean of weights."""
    with torch.no_grad():
        torch._foreach_lerp_(list(average.parameters()), list(network.parameters()), 1 - decay)

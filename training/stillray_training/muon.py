"""Muon: steps whose directions all weigh alike (Jordan et al. 2024, https://kellerjordan.github.io/posts/muon).

Convolution kernels are matrices of outputs by everything that an output reads; their momentum is
made orthogonal before it is followed, so that directions of little gradient are learned as fast as
those of much. Everything else (biases, kernels of few channels) follows Adam. ``torch.optim.Muon``
takes matrices only, and multiplies in bfloat16, which is slow where the processor lacks it: a step
of `kpyr-5` took 1.5 s with it where this one takes 1.1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import Tensor, nn

LEAST_SIDE = 8  # channels in and out of kernels that are made orthogonal
_MOMENTUM = 0.95
_BETAS, _EPSILON = (0.9, 0.999), 1e-8  # of Adam
#: Of a polynomial that brings singular values near 1 in five applications (Jordan et al.).
_QUINTIC = (3.4445, -4.7750, 2.0315)
_ITERATIONS = 5
#: Root mean square of a step of Adam, which rates of learning are made for (Liu et al. 2025,
#: "Muon is scalable for LLM training", eq. 4).
_ADAMS_STEP = 0.2


class Muon(torch.optim.Optimizer):
    """Muon for kernels, Adam for everything else.

    Parameters
    ----------
    parameters
        All that learn.
    lr
        As Adam's: steps of kernels are as large as Adam's would be.
    weight_decay
        Of both, decoupled as in `torch.optim.AdamW`.
    """

    def __init__(
        self, parameters: Iterable[nn.Parameter], lr: float, weight_decay: float = 0.0
    ) -> None:
        super().__init__(list(parameters), {"lr": lr, "weight_decay": weight_decay})

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> None:  # type: ignore[override]
        """Follow the gradients that there are; ``closure`` is not taken."""
        assert closure is None
        for group in self.param_groups:
            for weight in group["params"]:
                if weight.grad is None:
                    continue
                if is_kernel(weight):
                    change = _muon_step(weight.grad, self.state[weight])
                else:
                    change = _adam_step(weight.grad, self.state[weight])
                weight.mul_(1 - group["lr"] * group["weight_decay"])
                weight.sub_(change, alpha=group["lr"])


def is_kernel(weight: Tensor) -> bool:
    """Whether a weight is made orthogonal: a kernel of `LEAST_SIDE` channels in and out."""
    return weight.dim() == 4 and min(weight.shape[:2]) >= LEAST_SIDE


def orthogonal(matrix: Tensor) -> Tensor:
    """The nearest matrix whose singular values are near 1 (0.7 to 1.2), ``(n, m)``.

    Zeros stay zeros.
    """
    tall = matrix.shape[0] > matrix.shape[1]
    x = matrix.T if tall else matrix
    x = x / x.norm().clamp(min=1e-7)
    first, third, fifth = _QUINTIC
    for _ in range(_ITERATIONS):
        square = x @ x.T
        x = first * x + (third * square + fifth * square @ square) @ x
    return x.T if tall else x


def _muon_step(gradient: Tensor, state: dict[str, Any]) -> Tensor:
    """Nesterov's momentum, made orthogonal; of the size of a step of Adam."""
    if not state:
        state["momentum"] = torch.zeros_like(gradient)
    momentum = state["momentum"].lerp_(gradient, 1 - _MOMENTUM)
    ahead = gradient.lerp(momentum, _MOMENTUM).flatten(1)
    scale = _ADAMS_STEP * max(ahead.shape) ** 0.5
    return scale * orthogonal(ahead).reshape(gradient.shape)


def _adam_step(gradient: Tensor, state: dict[str, Any]) -> Tensor:
    """Kingma and Ba 2015, algorithm 1."""
    if not state:
        state["step"] = torch.zeros(())
        state["mean"] = torch.zeros_like(gradient)
        state["square"] = torch.zeros_like(gradient)
    state["step"] += 1
    of_mean, of_square = _BETAS
    state["mean"].lerp_(gradient, 1 - of_mean)
    state["square"].lerp_(gradient.square(), 1 - of_square)
    mean = state["mean"] / (1 - of_mean ** state["step"])
    square = state["square"] / (1 - of_square ** state["step"])
    return mean / (square.sqrt() + _EPSILON)

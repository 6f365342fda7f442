"""Muon: steps whose directions all weigh alike (Jordan et al. 2024, https://kellerjordan.github.io/posts/muon).

Convolution kernels are matrices of outputs by everything that an output reads; their momentum is
made orthogonal before it is followed, so that directions of little gradient are learned as fast as
those of much. Everything else (biases, kernels of few channels) follows Adam. ``torch.optim.Muon``
takes matrices only, and multiplies in bfloat16, which is slow where the processor lacks it: a step
of `kpyr-5` took 1.5 s with it where this one takes 1.1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
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
            weights = [weight for weight in group["params"] if weight.grad is not None]
            if not weights:
                continue
            torch._foreach_mul_(weights, 1 - group["lr"] * group["weight_decay"])
            # those of one shape are multiplied at once
            shapes: dict[torch.Size, list[Tensor]] = {}
            others: list[Tensor] = []
            for weight in weights:
                if is_kernel(weight):
                    shapes.setdefault(weight.shape, []).append(weight)
                else:
                    others.append(weight)
            for alike in shapes.values():
                changes = _muon_steps(alike, [self.state[weight] for weight in alike])
                torch._foreach_add_(alike, changes, alpha=-group["lr"])
            if others:
                changes = _adam_steps(others, [self.state[weight] for weight in others])
                torch._foreach_add_(others, changes, alpha=-group["lr"])


def is_kernel(weight: Tensor) -> bool:
    """Whether a weight is made orthogonal: a kernel of `LEAST_SIDE` channels in and out."""
    return weight.dim() == 4 and min(weight.shape[:2]) >= LEAST_SIDE


def orthogonal(matrices: Tensor) -> Tensor:
    """The nearest matrices whose singular values are near 1 (0.7 to 1.2), ``(..., n, m)``.

    Zeros stay zeros.
    """
    tall = matrices.shape[-2] > matrices.shape[-1]
    x = matrices.mT if tall else matrices
    x = x / x.norm(dim=(-2, -1), keepdim=True).clamp(min=1e-7)
    first, third, fifth = _QUINTIC
    for _ in range(_ITERATIONS):
        square = x @ x.mT
        x = first * x + (third * square + fifth * square @ square) @ x
    return x.mT if tall else x


def _muon_steps(alike: Sequence[Tensor], states: Sequence[dict[str, Any]]) -> list[Tensor]:
    """Nesterov's momentum of weights of one shape, made orthogonal; of the size of Adam's steps."""
    gradients = [weight.grad for weight in alike if weight.grad is not None]
    for state, gradient in zip(states, gradients, strict=True):
        if not state:
            state["momentum"] = torch.zeros_like(gradient)
    momenta = [state["momentum"] for state in states]
    torch._foreach_lerp_(momenta, gradients, 1 - _MOMENTUM)
    ahead = torch.stack(torch._foreach_lerp(gradients, momenta, _MOMENTUM)).flatten(2)
    scale = _ADAMS_STEP * max(ahead.shape[1:]) ** 0.5
    return list((scale * orthogonal(ahead)).view(len(alike), *alike[0].shape).unbind())


def _adam_steps(weights: Sequence[Tensor], states: Sequence[dict[str, Any]]) -> list[Tensor]:
    """Kingma and Ba 2015, algorithm 1."""
    gradients = [weight.grad for weight in weights if weight.grad is not None]
    for state, gradient in zip(states, gradients, strict=True):
        if not state:
            state["step"] = torch.zeros(())
            state["mean"] = torch.zeros_like(gradient)
            state["square"] = torch.zeros_like(gradient)
        state["step"] += 1
    means, squares = ([state[name] for state in states] for name in ("mean", "square"))
    of_mean, of_square = _BETAS
    torch._foreach_lerp_(means, gradients, 1 - of_mean)
    torch._foreach_lerp_(squares, torch._foreach_mul(gradients, gradients), 1 - of_square)
    # the counts lie with the processor, whatever the device
    steps = [float(state["step"]) for state in states]
    divisors = torch._foreach_div(squares, [1 - of_square**step for step in steps])
    torch._foreach_sqrt_(divisors)
    torch._foreach_add_(divisors, _EPSILON)
    changes = torch._foreach_div(means, [1 - of_mean**step for step in steps])
    torch._foreach_div_(changes, divisors)
    return list(changes)

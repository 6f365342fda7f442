"""Muon: kernels follow orthogonal directions, everything else Adam."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from stillray_training.muon import LEAST_SIDE, Muon, is_kernel, orthogonal


@settings(deadline=None)
@given(st.integers(1, 24), st.integers(1, 40), st.integers(0, 1000))
def test_singular_values_come_near_one(rows: int, columns: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    least = min(rows, columns)
    # of condition 20: what lies far below the largest needs more iterations than anybody takes
    values = np.exp(rng.uniform(np.log(0.05), 0, least))
    u, _ = np.linalg.qr(rng.standard_normal((rows, least)))
    v, _ = np.linalg.qr(rng.standard_normal((columns, least)))
    found = orthogonal(torch.from_numpy((u * values @ v.T).astype(np.float32))).numpy()
    assert found.shape == (rows, columns)
    ends = np.linalg.svd(found, compute_uv=False)[:least]
    assert ends.min() > 0.6
    assert ends.max() < 1.3
    # the directions stay: it is a function of the singular values alone
    np.testing.assert_allclose(found @ v, u * np.diag(u.T @ found @ v), atol=1e-3)


def test_zeros_stay_zeros() -> None:
    assert not orthogonal(torch.zeros(8, 72)).any()


def test_what_is_no_kernel_follows_adam() -> None:
    torch.manual_seed(0)
    shapes = [(16,), (4, 16, 3, 3), (16, 4, 3, 3), (16, 16)]
    ours = [nn.Parameter(torch.randn(shape)) for shape in shapes]
    theirs = [nn.Parameter(weight.detach().clone()) for weight in ours]
    muon, adam = Muon(ours, 1e-2, 0.1), torch.optim.AdamW(theirs, lr=1e-2, weight_decay=0.1)
    for _ in range(5):
        for mine, other in zip(ours, theirs, strict=True):
            mine.grad = torch.randn_like(mine)
            other.grad = mine.grad.clone()
        muon.step()
        adam.step()
    for mine, other in zip(ours, theirs, strict=True):
        torch.testing.assert_close(mine, other)


@pytest.mark.parametrize("shape", [(16, 8, 3, 3), (8, 32, 1, 1), (48, 8, 1, 1)])
def test_a_kernels_step_is_as_large_as_adams(shape: tuple[int, ...]) -> None:
    torch.manual_seed(0)
    weight = nn.Parameter(torch.zeros(shape))
    assert is_kernel(weight)
    weight.grad = torch.randn(shape) * 1e-4
    Muon([weight], 1.0).step()
    side = min(shape[0], int(np.prod(shape[1:])))
    expected = 0.2 * max(shape[0], np.prod(shape[1:])) ** 0.5 * side**0.5 / weight.numel() ** 0.5
    assert float(weight.detach().square().mean().sqrt()) == pytest.approx(expected, rel=0.2)
    # against the gradient
    assert float((weight.detach() * weight.grad).sum()) < 0


def test_directions_of_little_gradient_learn_as_fast() -> None:
    """Least squares of condition 100: after as many steps Muon is far ahead of plain descent."""
    torch.manual_seed(0)
    side = 2 * LEAST_SIDE
    scales = torch.logspace(0, -2, side)
    wanted = torch.randn(side, side)
    left = {}
    for name, optimiser in (("muon", Muon), ("sgd", torch.optim.SGD)):
        weight = nn.Parameter(torch.zeros(side, side, 1, 1))
        steps = optimiser([weight], lr=0.05)
        for _ in range(400):
            steps.zero_grad()
            error = (weight[:, :, 0, 0] - wanted) * scales
            error.square().sum().backward()
            steps.step()
        left[name] = float((weight[:, :, 0, 0] - wanted).detach()[:, -4:].square().mean())
    assert left["muon"] < 0.1 * left["sgd"]


def test_state_survives_saving() -> None:
    torch.manual_seed(0)
    weights = [nn.Parameter(torch.randn(16, 16, 3, 3)), nn.Parameter(torch.randn(16))]
    copies = [nn.Parameter(weight.detach().clone()) for weight in weights]
    gradients = [[torch.randn_like(weight) for weight in weights] for _ in range(6)]
    through = Muon(weights, 1e-2)
    for step in gradients:
        for weight, gradient in zip(weights, step, strict=True):
            weight.grad = gradient.clone()
        through.step()
    stopped = Muon(copies, 1e-2)
    for number, step in enumerate(gradients):
        if number == 3:
            state = stopped.state_dict()
            stopped = Muon(copies, 1e-2)
            stopped.load_state_dict(state)
        for weight, gradient in zip(copies, step, strict=True):
            weight.grad = gradient.clone()
        stopped.step()
    for weight, copy in zip(weights, copies, strict=True):
        torch.testing.assert_close(copy, weight, rtol=0, atol=0)

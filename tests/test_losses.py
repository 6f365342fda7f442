"""Training losses against their definitions."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity

from stillray.training.losses import displayed_error, dissimilarity, unsteadiness


def _nchw(seed: int) -> torch.Tensor:
    rng = np.random.default_rng(seed)
    return torch.from_numpy(rng.gamma(0.5, 0.3, (1, 3, 19, 23)).astype(np.float32))


def _shown(exposed: torch.Tensor) -> np.ndarray:
    # half a display's white is an exposed radiance of 1/4, see `stillray.display`
    return ((2 * exposed).clamp(0, 1) + 1e-3).numpy() ** (1 / 2.2)


def test_dissimilarity_is_one_minus_the_structural_similarity_of_the_mean_channel():
    a, b = _nchw(1), _nchw(2)
    _, similarity = structural_similarity(
        _shown(a)[0].mean(0).astype(np.float64),
        _shown(b)[0].mean(0).astype(np.float64),
        win_size=7, data_range=1, use_sample_covariance=False, full=True,
    )  # fmt: skip
    wanted = 1 - similarity[3:-3:4, 3:-3:4].mean()
    assert float(dissimilarity(a, b)) == pytest.approx(wanted, abs=1e-5)
    assert float(dissimilarity(a, a)) == pytest.approx(0, abs=1e-6)


def test_unsteadiness_is_the_change_where_the_last_output_was_right():
    reference, valid = _nchw(1), torch.ones(1, 1, 19, 23)
    image = reference * 1.3
    steady = unsteadiness(image, reference, reference, valid)
    assert float(steady) == pytest.approx(float(displayed_error(image, reference)), rel=1e-6)
    assert float(unsteadiness(image, reference, reference, 0 * valid)) == 0
    # a light went on: what was shown before says nothing
    assert float(unsteadiness(image, reference, 0 * reference, valid)) < 0.2 * float(steady)


def test_losses_of_black_pixels_have_finite_gradients():
    image = torch.zeros(1, 3, 9, 9, requires_grad=True)
    black = torch.zeros(1, 3, 9, 9)
    loss = dissimilarity(image, black) + unsteadiness(image, black, black, black[:, :1] + 1)
    loss.backward()
    assert torch.isfinite(image.grad).all()

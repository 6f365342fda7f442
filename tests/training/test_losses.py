"""Training losses against their definitions."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity

from stillray_training.losses import (
    blur_error,
    displayed,
    dissimilarity,
    excess,
    filmic,
    slope_error,
    smape,
    unsteadiness,
)


def _nchw(seed: int) -> torch.Tensor:
    rng = np.random.default_rng(seed)
    return torch.from_numpy(rng.gamma(0.5, 0.3, (1, 3, 19, 23)).astype(np.float32))


def test_smape_is_the_paper_s_equation():
    image = torch.tensor([[1.0, 0.0, 3.0], [0.0, 0.0, 0.0]])
    reference = torch.tensor([[3.0, 0.0, 3.0], [0.0, 0.0, 0.0]])
    wanted = torch.tensor([2.0 / 4.01 / 3, 0.0])  # one value a patch
    torch.testing.assert_close(smape(image, reference, 0.01), wanted)


def test_a_display_clips_and_opens_the_dark():
    shown = displayed(torch.tensor([0.0, 0.1, 0.5, 9.0]))
    # white is an exposed half
    expected = [1e-3 ** (1 / 2.2), (0.2 + 1e-3) ** (1 / 2.2), *[1.001 ** (1 / 2.2)] * 2]
    np.testing.assert_allclose(shown, expected, rtol=1e-6)


def test_the_filmic_curve_is_its_formula_and_stays_below_white():
    exposed = torch.tensor([0.0, 0.001, 0.05, 0.5, 2.0, 1e30], dtype=torch.float32)
    x = np.maximum(2 * exposed.double().numpy() - 0.004, 0)
    x = np.minimum(x, 1e6)
    expected = x * (6.2 * x + 0.5) / (x * (6.2 * x + 1.7) + 0.06)
    np.testing.assert_allclose(filmic(exposed), expected, rtol=1e-5)
    # 0.18, a middle gray, is shown at a half, as displays have it
    assert float(filmic(torch.tensor(0.09))) == pytest.approx(0.508, abs=1e-3)
    assert float(filmic(exposed).max()) <= 1


def test_dissimilarity_is_one_minus_the_structural_similarity_of_the_mean_channel():
    a, b = displayed(_nchw(1)), displayed(_nchw(2))
    _, similarity = structural_similarity(
        a[0].mean(0).double().numpy(), b[0].mean(0).double().numpy(),
        win_size=7, data_range=1, use_sample_covariance=False, full=True,
    )  # fmt: skip
    wanted = 1 - similarity[3:-3:4, 3:-3:4].mean()
    assert float(dissimilarity(a, b)) == pytest.approx(wanted, abs=1e-5)
    assert float(dissimilarity(a, a)) == pytest.approx(0, abs=1e-6)


def test_unsteadiness_is_the_change_where_the_last_output_was_right():
    wanted, valid = displayed(_nchw(1)), torch.ones(1, 1, 19, 23)
    shown = wanted * 0.9
    steady = float(unsteadiness(shown, wanted, wanted, valid))
    assert steady == pytest.approx(float((shown - wanted).abs().mean()), rel=1e-6)
    assert float(unsteadiness(shown, wanted, wanted, 0 * valid)) == 0
    # a light went on: what was shown before says nothing
    assert float(unsteadiness(shown, wanted, 0 * wanted, valid)) < 0.2 * steady


def test_losses_of_black_pixels_have_finite_gradients():
    image = torch.zeros(1, 3, 9, 9, requires_grad=True)
    shown, black = displayed(image), displayed(torch.zeros(1, 3, 9, 9))
    (dissimilarity(shown, black) + unsteadiness(shown, black, black, black[:, :1])).backward()
    assert torch.isfinite(image.grad).all()


def test_a_slope_that_is_wrong_counts_and_noise_of_single_pixels_hardly():
    edge = torch.zeros(1, 3, 16, 16)
    edge[..., 8:] = 0.1
    assert float(slope_error(edge)) == pytest.approx(0.1 / 14, rel=1e-5)
    assert float(slope_error(torch.full((1, 3, 16, 16), 0.3))) == 0
    checks = torch.tensor([0.1, -0.1]).repeat(8)
    assert float(slope_error(checks.expand(1, 3, 16, 16))) == pytest.approx(0, abs=1e-7)


def test_mottling_counts_where_noise_averages_out():
    patch = torch.zeros(1, 3, 32, 32)
    patch[..., :16, :16] = 0.1
    assert float(blur_error(patch)) == pytest.approx(2 * 0.1 / 4, rel=1e-5)
    checks = torch.tensor([0.1, -0.1]).repeat(16)
    assert float(blur_error(checks.expand(1, 3, 32, 32))) == pytest.approx(0, abs=1e-7)


def test_what_is_worse_than_the_input_counts_even_where_the_patch_gains():
    before = torch.full((1, 3, 16, 16), 0.2)
    error = torch.full((1, 3, 16, 16), 0.1)
    assert float(excess(error, before)) == 0
    error[..., :4, :4] = 0.5  # one square of sixteen
    assert float(excess(error, before)) == pytest.approx(0.3 / 16)
    checks = torch.tensor([0.0, 0.4]).repeat(8).expand(1, 3, 16, 16)
    assert float(excess(checks, before)) == pytest.approx(0, abs=1e-7)

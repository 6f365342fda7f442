from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from stillray.model_spec import load  # noqa: E402
from stillray_training.decoders import boxes  # noqa: E402
from stillray_training.decoders.fused_kernels import fused_kernels  # noqa: E402
from tests import oracles  # noqa: E402

DECODER = load("wskp-3s").decoder


@pytest.mark.parametrize("size", [1, 3, 5, 7, 9, 11, 13])
@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (33, 18)])
def test_box_mean_equals_zero_padded_average_pooling(size, shape):
    planes = torch.rand(2, 3, *shape, dtype=torch.float64)
    expected = torch.nn.functional.avg_pool2d(planes, size, 1, size // 2)
    torch.testing.assert_close(boxes.box_mean(planes, size), expected)
    torch.testing.assert_close(boxes.pooled_box_mean(planes, size), expected)


def test_decoder_equals_the_loop_oracle():
    rng = np.random.default_rng(0)
    irradiance = rng.lognormal(0, 2, (11, 14, 3))
    samples = rng.uniform(1e-3, 16, (11, 14))
    logits = rng.normal(size=(12, 11, 14)) * 5
    got = fused_kernels(
        torch.from_numpy(irradiance.transpose(2, 0, 1)[None]),
        torch.from_numpy(samples[None, None]),
        torch.from_numpy(logits[None]),
        DECODER,
    )[0].permute(1, 2, 0)
    expected = oracles.fused_kernels(irradiance, samples, logits, DECODER)
    np.testing.assert_allclose(got.numpy(), expected, rtol=1e-10)


def test_decoder_s_gradient_equals_finite_differences():
    torch.manual_seed(0)
    irradiance = torch.rand(1, 3, 5, 6, dtype=torch.float64)
    samples = torch.rand(1, 1, 5, 6, dtype=torch.float64) + 0.1
    logits = torch.randn(1, 12, 5, 6, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda x: fused_kernels(irradiance, samples, x, DECODER), (logits,)
    )

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from stillray_training.losses import smape  # noqa: E402
from stillray_training.peers.kernel_prediction import (  # noqa: E402
    KernelPrediction,
    KernelPredictionNet,
    filter_rows,
    predicted_kernels,
)

SMALL = KernelPrediction(kernel_size=5)
PAPER = KernelPrediction()


def slow_kernels(irradiance, samples, logits, options):
    """Pixel by pixel: softmax over the window's pixels that lie in the image."""
    height, width = samples.shape
    half = options.kernel_size // 2
    result = np.zeros((height, width, 3))
    for y in range(height):
        for x in range(width):
            total, weights = np.zeros(3), 0.0
            index = 0
            for i in range(y - half, y + half + 1):
                for j in range(x - half, x + half + 1):
                    logit = np.clip(logits[index, y, x], -options.logit_bound, options.logit_bound)
                    index += 1
                    if not (0 <= i < height and 0 <= j < width):
                        continue
                    weight = np.exp(float(logit))
                    if options.weigh_samples:
                        weight *= float(samples[i, j])
                    total += weight * irradiance[i, j].astype(np.float64)
                    weights += weight
            result[y, x] = total / weights
    return result


def inputs(rng, size, options):
    irradiance = rng.lognormal(0, 2, (*size, 3)).astype(np.float32)
    samples = rng.uniform(1e-3, 16, size).astype(np.float32)
    logits = (rng.normal(size=(options.kernel_size**2, *size)) * 5).astype(np.float32)
    return irradiance, samples, logits


@pytest.mark.parametrize("weigh", [True, False])
@pytest.mark.parametrize(
    ("size", "options"), [((1, 1), SMALL), ((3, 5), SMALL), ((11, 14), SMALL), ((9, 7), PAPER)]
)
def test_both_forms_equal_the_loop_oracle(rng, size, options, weigh):
    options = dataclasses.replace(options, weigh_samples=weigh)
    irradiance, samples, logits = inputs(rng, size, options)
    expected = slow_kernels(irradiance, samples, logits, options)
    got = predicted_kernels(
        torch.from_numpy(irradiance.transpose(2, 0, 1)[None]).double(),
        torch.from_numpy(samples[None, None]).double(),
        torch.from_numpy(logits[None]).double(),
        options,
    )[0].permute(1, 2, 0)
    np.testing.assert_allclose(got.numpy(), expected, rtol=1e-6)
    mean = np.dstack([irradiance, samples])
    rows = filter_rows(mean, logits, slice(0, size[0]), options)
    # float32 sums of up to 169 products
    np.testing.assert_allclose(rows, expected, rtol=2e-5)


def test_gradient_equals_finite_differences():
    torch.manual_seed(0)
    options = KernelPrediction(kernel_size=3)
    irradiance = torch.rand(1, 3, 4, 5, dtype=torch.float64, requires_grad=True)
    samples = (torch.rand(1, 1, 4, 5, dtype=torch.float64) + 0.1).requires_grad_()
    logits = torch.randn(1, 9, 4, 5, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda *given: predicted_kernels(*given, options), (irradiance, samples, logits)
    )


def test_strips_equal_the_whole_image(rng):
    irradiance, samples, logits = inputs(rng, (20, 9), SMALL)
    mean = np.dstack([irradiance, samples])
    whole = filter_rows(mean, logits, slice(0, 20), SMALL)
    # rows 7 to 12, with two neighbouring rows on each side
    part = filter_rows(mean[5:14], logits[:, 5:14], slice(2, 7), SMALL)
    np.testing.assert_array_equal(part, whole[7:12])


def test_extreme_input_stays_within_its_window(rng):
    irradiance, samples, logits = inputs(rng, (8, 9), PAPER)
    irradiance[2, 3] = 1e31
    samples[...] = 16
    logits[::3] = 1e30
    logits[1::7] = np.nan
    logits[5] = -np.inf
    result = filter_rows(np.dstack([irradiance, samples]), logits, slice(0, 8), PAPER)
    assert np.isfinite(result).all()
    assert result.min() >= 0
    assert result.max() <= 1e31 * 1.0001


def test_network_has_six_blocks_a_weight_a_channel_and_fuses():
    torch.manual_seed(0)
    network = KernelPredictionNet(12, PAPER).double()
    features = torch.randn(1, 12, 9, 7, dtype=torch.float64)
    logits = network(features)
    assert logits.shape == (1, 169, 9, 7)
    assert (logits < 0).any()
    kernels = [block.fused() for block in network.blocks]
    assert [tuple(weight.shape[2:]) for weight, _ in kernels] == [(5, 5)] * 6
    planes = features
    for index, (weight, bias) in enumerate(kernels):
        planes = torch.nn.functional.conv2d(planes, weight, bias, padding=2)
        planes = planes.relu() if index < 5 else planes
    torch.testing.assert_close(planes, logits)


def test_a_few_steps_lower_the_loss():
    torch.manual_seed(0)
    network = KernelPredictionNet(1, dataclasses.replace(SMALL, widths=(8, 8)))
    optimiser = torch.optim.Adam(network.parameters(), 1e-2)
    truth = torch.ones(2, 3, 16, 16)
    noisy = truth * torch.empty(2, 1, 16, 16).exponential_()
    samples = torch.ones(2, 1, 16, 16)
    losses = []
    for _ in range(30):
        logits = network(noisy[:, :1].sqrt())
        loss = smape(predicted_kernels(noisy, samples, logits, SMALL), truth, 0.01).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    assert losses[-1] < 0.9 * losses[0]

"""Predicted kernels of several sizes, fused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from stillray.arrays.strips import Strips  # noqa: E402
from stillray.model_spec import load  # noqa: E402
from stillray.stages.state import Filterable  # noqa: E402
from stillray_training.peers.fused_prediction import (  # noqa: E402
    FAMILY,
    FusedPredictionModel,
    filter_rows,
    fused_predictions,
)
from stillray_training.peers.kernel_prediction import kernels_of  # noqa: E402
from tests.training.test_peers_kernel_prediction import slow_kernels  # noqa: E402

_OURS = load("wskp-6")
DECODER = _OURS.decoder.with_kernels((3, 5))
SPEC = dataclasses.replace(_OURS, decoder=DECODER)


def draw(rng, height, width, spread=3.0):
    mean = rng.lognormal(0, 2, (height, width, 4)).astype(np.float32)
    return mean, (spread * rng.normal(size=(9 + 25 + 2, height, width))).astype(np.float32)


def slow_fusion(mean, logits, decoder):
    """Each size by itself, then the mean by shares, pixel by pixel, in float64."""
    images, first = [], 0
    for size in decoder.kernel_sizes:
        own = logits[first : first + size**2]
        options = kernels_of(decoder.with_kernels((size,)))
        images.append(slow_kernels(mean[..., :3], mean[..., 3], own, options))
        first += size**2
    result = np.zeros((*mean.shape[:2], 3))
    for y, x in np.ndindex(mean.shape[:2]):
        bounded = [
            float(np.clip(logits[first + index, y, x], -decoder.logit_bound, decoder.logit_bound))
            for index in range(len(images))
        ]
        shares = np.exp(bounded) / np.exp(bounded).sum()
        result[y, x] = sum(share * image[y, x] for share, image in zip(shares, images, strict=True))
    return result


@pytest.mark.parametrize("size", [(1, 1), (3, 7), (9, 8)])
@pytest.mark.parametrize("weigh", [True, False])
def test_both_forms_equal_the_loop_oracle(rng, size, weigh):
    decoder = dataclasses.replace(DECODER, weigh_samples=weigh)
    mean, logits = draw(rng, *size, spread=8.0)  # some beyond the bound
    expected = slow_fusion(mean, logits, decoder)
    planes = torch.from_numpy(mean).double().permute(2, 0, 1)[None]
    given = torch.from_numpy(logits[None]).double()
    got = fused_predictions(planes[:, :3], planes[:, 3:], given, decoder)[0].permute(1, 2, 0)
    np.testing.assert_allclose(got.numpy(), expected, rtol=1e-6)
    rows = filter_rows(mean, logits, slice(0, size[0]), decoder)
    np.testing.assert_allclose(rows, expected, rtol=2e-5)


def test_a_frame_of_several_strips_is_filtered_as_one(rng):
    mean, logits = draw(rng, 132, 44)
    logits[3, 5, 6] = np.nan  # says nothing
    said = np.nan_to_num(logits, nan=0.0)
    albedo = rng.uniform(0.1, 1, (132, 44, 3)).astype(np.float32)
    model = FusedPredictionModel(SPEC)
    light = Filterable(mean=mean, remodulation_albedo=albedo)
    image = model.reconstruct(light, [logits], Strips(3), {})
    whole = filter_rows(mean, said, slice(0, 132), DECODER) * albedo
    np.testing.assert_array_equal(image, whole)


def test_gradient_equals_finite_differences():
    torch.manual_seed(0)
    light = torch.rand(1, 3, 4, 5, dtype=torch.float64)
    samples = torch.rand(1, 1, 4, 5, dtype=torch.float64) + 0.1
    logits = torch.randn(1, 36, 4, 5, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda maps: fused_predictions(light, samples, maps, DECODER), (logits,)
    )


def test_the_network_gives_every_weight_and_share():
    network = FAMILY.network(SPEC)
    logits = network(torch.zeros(1, len(SPEC.network.features), 4, 6))
    assert logits.shape == (1, 9 + 25 + 2, 4, 6)
    batch = {"irradiance": torch.ones(1, 3, 4, 6), "samples": torch.ones(1, 1, 4, 6)}
    image = FAMILY.decode(logits, batch, SPEC, None)
    torch.testing.assert_close(image, batch["irradiance"])

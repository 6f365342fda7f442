from __future__ import annotations

import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from stillray.arrays.strips import Strips  # noqa: E402
from stillray.frame import Frame  # noqa: E402
from stillray.model_spec import load  # noqa: E402
from stillray.stages.state import Filterable  # noqa: E402
from stillray_training.ablation import measure, variants  # noqa: E402
from stillray_training.peers.kernel_prediction import kernels_of  # noqa: E402
from stillray_training.peers.multi_resolution_prediction import (  # noqa: E402
    FAMILY,
    MultiResolutionPredictedModel,
    multi_resolution_predicted_kernels,
)
from tests import oracles  # noqa: E402
from tests.families.test_multi_resolution import ROUNDING  # noqa: E402
from tests.training.test_peers_kernel_prediction import slow_kernels  # noqa: E402

_OURS = load("wskp-mr")
DECODER = dataclasses.replace(_OURS.decoder, kernel_sizes=(3,))
SPEC = dataclasses.replace(_OURS, decoder=DECODER)
LEVELS = 3


def draw(height, width, seed=0, spread=2.0, light=2.0, size=3):
    """Random decoder input: mean, and logits of the padded size."""
    rng = np.random.default_rng(seed)
    padded = [-(-length // 4) * 4 for length in (height, width)]
    mean = np.dstack(
        [rng.lognormal(0, light, (height, width, 3)), rng.uniform(1e-3, 16, (height, width))]
    )
    logits = [
        spread * rng.normal(size=(size**2 + (level < 2), *(side >> level for side in padded)))
        for level in range(LEVELS)
    ]
    return mean.astype(np.float32), [level.astype(np.float32) for level in logits]


def run(mean, logits, decoder=DECODER, threads=1, albedo=None):
    model = MultiResolutionPredictedModel(dataclasses.replace(SPEC, decoder=decoder))
    light = Filterable(mean=mean, remodulation_albedo=albedo)
    return model.reconstruct(light, logits, Strips(threads), {})


def decode(mean, logits, decoder=DECODER):
    planes = mean.permute(2, 0, 1)[None]
    image = multi_resolution_predicted_kernels(planes[:, :3], planes[:, 3:], logits, decoder)
    return image[0].permute(1, 2, 0)


def in_torch(mean, logits):
    return torch.from_numpy(mean).double(), [torch.from_numpy(one[None]).double() for one in logits]


def oracle(mean, logits, decoder=DECODER):
    def filtered(light, samples, maps, options):
        return slow_kernels(light, samples, maps, kernels_of(options))

    return oracles.multi_resolution_kernels(mean, logits, decoder, filtered)


@pytest.mark.parametrize("weigh", [True, False])
@pytest.mark.parametrize("spread", [2.0, 1e4])
@pytest.mark.parametrize(("size", "kernel"), [((12, 8), 3), ((8, 20), 5)])
def test_decoder_equals_the_loop_oracle(size, kernel, spread, weigh):
    mean, logits = draw(*size, spread=spread, size=kernel)
    decoder = dataclasses.replace(DECODER, kernel_sizes=(kernel,), weigh_samples=weigh)
    got = decode(*in_torch(mean, logits), decoder)
    np.testing.assert_allclose(got.numpy(), oracle(mean, logits, decoder), rtol=1e-9)


@pytest.mark.parametrize("weigh", [True, False])
@pytest.mark.parametrize("spread", [2.0, 1e4])
@pytest.mark.parametrize(
    ("size", "kernel"), [((1, 1), 3), ((3, 5), 5), ((9, 14), 3), ((11, 17), 5), ((8, 12), 5)]
)
def test_runtime_frames_of_any_size_equal_the_loop_oracle(size, kernel, spread, weigh):
    mean, logits = draw(*size, spread=spread, size=kernel)
    decoder = dataclasses.replace(DECODER, kernel_sizes=(kernel,), weigh_samples=weigh)
    around = ROUNDING * mean[..., :3].max()
    expected = oracle(mean, logits, decoder)
    np.testing.assert_allclose(run(mean, logits, decoder), expected, rtol=2e-5, atol=around)


def test_what_is_timed_is_what_was_trained():
    # more rows than a strip has
    mean, logits = draw(132, 44, light=0.5, size=5)
    decoder = dataclasses.replace(DECODER, kernel_sizes=(5,))
    albedo = np.random.default_rng(1).uniform(0.1, 1, (132, 44, 3)).astype(np.float32)
    trained = decode(*in_torch(mean, logits), decoder).numpy() * albedo
    one, three = (run(mean, logits, decoder, threads, albedo) for threads in (1, 3))
    np.testing.assert_allclose(one, trained, rtol=2e-5)
    np.testing.assert_array_equal(one, three)


def test_decoder_s_gradient_equals_finite_differences():
    mean, logits = in_torch(*draw(4, 4, light=0.5))
    given = [level.requires_grad_() for level in logits]
    assert torch.autograd.gradcheck(lambda *maps: decode(mean, maps), given)


def test_constant_light_stays_constant_whatever_the_logits():
    mean, logits = draw(21, 18, spread=50)
    mean[..., :3] = 3.7
    np.testing.assert_allclose(run(mean, logits), 3.7, rtol=1e-5)


@pytest.mark.parametrize("extreme", [1e30, np.inf])
def test_extreme_logits_stay_within_the_range_of_what_they_reach(extreme):
    mean, logits = draw(21, 18)
    mean[5, 5, :3] = 1e30
    for level in logits:
        level[::3] = extreme
        level[1::3] = -extreme
        level[2, 1, 1] = np.nan
    got = run(mean, logits)
    assert np.isfinite(got).all()
    light = mean[..., :3].reshape(-1, 3)
    assert (got >= light.min(0) * (1 - 1e-5)).all()
    assert (got <= light.max(0) * (1 + 1e-5)).all()
    # a 3x3 window of cells of four pixels looks seven pixels around
    assert got[13:, 13:].max() <= mean[6:, 6:, :3].max() * (1 + 1e-5)


def test_a_logit_that_is_not_a_number_says_nothing():
    mean, logits = draw(9, 14)
    zero = [level.copy() for level in logits]
    for plane in (2, 9):  # a weight and the blend
        logits[1][plane, 1, 1], zero[1][plane, 1, 1] = np.nan, 0
    np.testing.assert_array_equal(run(mean, logits), run(mean, zero))


def test_a_network_s_kernels_reach_the_user_s_picture(rng, tmp_path):
    # a network that answers with one tap at the finest level, and with no blend: every pixel
    # becomes its neighbour, times its own albedo
    variant = next(one for one in variants.study() if one.name == "MR-KP")
    assert variant.family is FAMILY
    narrow = dataclasses.replace(variant.spec.network, widths=(4, 4, 4))
    variant = dataclasses.replace(variant, spec=dataclasses.replace(variant.spec, network=narrow))
    network = FAMILY.network(variant.spec)
    row, column = 1, 4
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.zero_()
        network.heads[0].bias.fill_(-30)
        network.heads[0].bias[row * 5 + column] = 30
    height, width = 75, 41
    light = rng.uniform(1, 2, (height, width, 1)).astype(np.float32)
    albedo = rng.uniform(0.2, 0.9, (height, width, 3)).astype(np.float32)
    measure.export(variant, network, tmp_path / "network.onnx")
    with measure.open_stream(variant, tmp_path / "network.onnx", temporal=False) as stream:
        image = stream.denoise(Frame(color=light * albedo, albedo=albedo))
        assert {"network", "reconstruct", "remodulate"} <= set(stream.last_timings)
    inner = (slice(2, height - 2), slice(2, width - 2))
    there = np.roll(light, (2 - row, 2 - column), (0, 1))
    # what the other taps and the blend keep: exp(-24) and exp(-12)
    np.testing.assert_allclose(image[inner], (there * albedo)[inner], rtol=2e-5)

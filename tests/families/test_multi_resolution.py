from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from stillray.arrays.strips import Strips
from stillray.families.multi_resolution import MultiResolutionModel, level_planes
from stillray.model_spec import load
from stillray.stages.state import Filterable
from tests import oracles

SPEC = load("wskp-mr")
OPTIONS = SPEC.decoder
LEVELS = 3
# Eq. 7 takes one mean away and adds another: what is left is rounded as the brightest of them is.
ROUNDING = 2e-6


def draw(height, width, seed=0, spread=2.0, light=2.0):
    """Random decoder input: mean, and logits of the padded size."""
    rng = np.random.default_rng(seed)
    padded = [-(-size // 4) * 4 for size in (height, width)]
    mean = np.dstack(
        [rng.lognormal(0, light, (height, width, 3)), rng.uniform(1e-3, 16, (height, width))]
    )
    logits = [
        spread
        * rng.normal(size=(level_planes(level, LEVELS, OPTIONS), *(s >> level for s in padded)))
        for level in range(LEVELS)
    ]
    return mean.astype(np.float32), [level.astype(np.float32) for level in logits]


def run(mean, logits, spec=SPEC, threads=1, albedo=None):
    light = Filterable(mean=mean, remodulation_albedo=albedo)
    model = MultiResolutionModel(spec)
    image = model.reconstruct(light, logits, Strips(threads), {})
    few_rows = Strips(1, pixels=4 * mean.shape[1])
    np.testing.assert_array_equal(model.reconstruct(light, logits, few_rows, {}), image)
    return image


@pytest.mark.parametrize("size", [(1, 1), (3, 5), (9, 14), (16, 8), (23, 17)])
@pytest.mark.parametrize("spread", [2.0, 1e4])
def test_resolutions_equal_the_loop_oracle(size, spread):
    mean, logits = draw(*size, spread=spread)
    expected = oracles.multi_resolution_kernels(mean, logits, OPTIONS)
    around = ROUNDING * mean[..., :3].max()
    np.testing.assert_allclose(run(mean, logits), expected, rtol=5e-6, atol=around)


def test_plain_weights_equal_the_loop_oracle():
    options = dataclasses.replace(OPTIONS, weigh_samples=False)
    mean, logits = draw(9, 14, light=0.5)
    expected = oracles.multi_resolution_kernels(mean, logits, options)
    got = run(mean, logits, dataclasses.replace(SPEC, decoder=options))
    np.testing.assert_allclose(got, expected, rtol=5e-6)
    weighed = oracles.multi_resolution_kernels(mean, logits, OPTIONS)
    assert np.abs(expected / weighed - 1).max() > 0.1


def test_fewer_kernels_are_the_first_ones():
    mean, logits = draw(12, 8, light=0.5)
    options = dataclasses.replace(OPTIONS, kernel_sizes=(3,))
    first = [np.delete(level, [1, 3], axis=0) for level in logits]
    expected = oracles.multi_resolution_kernels(mean, first, options)
    got = run(mean, logits, dataclasses.replace(SPEC, decoder=options))
    np.testing.assert_allclose(got, expected, rtol=5e-6)


@pytest.mark.parametrize("seed", range(5))
def test_no_light_is_invented(seed):
    mean, logits = draw(33, 18, seed, spread=20)
    mean[5, 5, :3] = 1e30
    got = run(mean, logits)
    light = mean[..., :3].reshape(-1, 3)
    assert np.isfinite(got).all()
    assert (got >= light.min(0) * (1 - 1e-5)).all()
    assert (got <= light.max(0) * (1 + 1e-5)).all()


def test_light_goes_as_far_as_the_reach_and_no_further():
    farthest = 0
    for column in range(16, 24):
        mean, logits = draw(4, 48)
        for level in logits:
            level[:] = 0
            if len(level) % 2:
                level[-1] = 100
        mean[..., :3], mean[0, column, :3] = 0, 1
        lit = np.flatnonzero(run(mean, logits)[0, :, 0])
        farthest = max(farthest, int(abs(lit - column).max()))
    assert farthest == MultiResolutionModel(SPEC).looks.reach


def test_constant_light_stays_constant_whatever_the_logits():
    mean, logits = draw(33, 18, spread=50)
    mean[..., :3] = 3.7
    np.testing.assert_allclose(run(mean, logits), 3.7, rtol=1e-5)


@pytest.mark.parametrize("plane", [1, 4])
def test_a_logit_that_is_not_a_number_says_nothing(plane):
    mean, logits = draw(9, 14)
    logits[1][plane, 1, 1] = np.nan
    zero = [level.copy() for level in logits]
    zero[1][plane, 1, 1] = 0
    np.testing.assert_array_equal(run(mean, logits), run(mean, zero))


def test_threads_and_strips_do_not_change_the_picture():
    mean, logits = draw(301, 70)
    albedo = np.random.default_rng(1).uniform(0.1, 1, (301, 70, 3)).astype(np.float32)
    one, three = (run(mean, logits, threads=threads, albedo=albedo) for threads in (1, 3))
    np.testing.assert_array_equal(one, three)
    np.testing.assert_array_equal(one, run(mean, logits) * albedo)


def test_parts_of_the_light_add_up_when_filtered_as_the_whole_was():
    mean, logits = draw(21, 30, spread=4)
    mean[7, 9, :3] = 1e3
    logits[0][0, 3, 3] = np.nan
    whole = run(mean, logits)
    settled = MultiResolutionModel(SPEC).frozen(Filterable(mean=mean), logits, Strips(1))
    np.testing.assert_allclose(run(mean, settled), whole, rtol=1e-5, atol=1e-4)
    rng = np.random.default_rng(2)
    part, rest = mean.copy(), mean.copy()
    part[..., :3] = rng.normal(0, 3, part[..., :3].shape)  # of any sign
    rest[..., :3] -= part[..., :3]
    together = run(part, settled) + run(rest, settled)
    np.testing.assert_allclose(together, whole, rtol=1e-5, atol=1e-4)
    # and the limits were met, or this test would say nothing
    apart = run(part, logits) + run(rest, logits)
    assert np.abs(apart - whole).max() > 0.1

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stillray.families import box_filter as kernels
from stillray.families.fused_kernels import FusedKernelsModel
from stillray.model_spec import load
from tests import oracles
from tests.conftest import ODD_SIZES

DECODER = load("wskp-3s").decoder
# float32 sums of 169 positive products, six kernels: a few hundred roundings of 6e-8
ROUNDING = 2e-5


def _random(size: tuple[int, int], seed: int, spread: float = 3.0):
    rng = np.random.default_rng(seed)
    irradiance = rng.lognormal(0, 2, (*size, 3)).astype(np.float32)
    samples = rng.uniform(1e-3, 16, size).astype(np.float32)
    logits = (rng.normal(size=(12, *size)) * spread).astype(np.float32)
    return irradiance, samples, logits


def _whole(irradiance, samples, logits, decoder=DECODER):
    mean = np.dstack([irradiance, samples])
    return kernels.filter_rows(mean, logits, slice(0, mean.shape[0]), decoder)


@pytest.mark.parametrize("size", ODD_SIZES)
@pytest.mark.parametrize("spread", [0.0, 3.0, 1e4])
def test_filter_equals_the_loop_oracle(size, spread):
    irradiance, samples, logits = _random(size, 1, spread)
    got = _whole(irradiance, samples, logits)
    expected = oracles.fused_kernels(irradiance, samples, logits, DECODER)
    np.testing.assert_allclose(got, expected, rtol=ROUNDING)


def test_filter_without_sample_weights_equals_the_loop_oracle():
    decoder = dataclasses.replace(DECODER, weigh_samples=False)
    irradiance, samples, logits = _random((13, 17), 2)
    got = _whole(irradiance, samples, logits, decoder)
    expected = oracles.fused_kernels(irradiance, samples, logits, decoder)
    np.testing.assert_allclose(got, expected, rtol=ROUNDING)


def test_strips_with_halo_equal_the_whole_image():
    irradiance, samples, logits = _random((61, 23), 3)
    whole = _whole(irradiance, samples, logits)
    halo = FusedKernelsModel(load("wskp-3s")).looks.reach
    for top in range(0, 61, 16):
        low, high = max(top - halo, 0), min(top + 16 + halo, 61)
        inner = slice(top - low, min(top + 16, 61) - low)
        strip = kernels.filter_rows(
            np.dstack([irradiance, samples])[low:high], logits[:, low:high], inner, DECODER
        )
        np.testing.assert_array_equal(strip, whole[top : top + 16])


def test_a_passed_firefly_leaves_no_residue_in_dark_windows():
    # a running sum keeps 1e-16 of 1e8 e^12 and drowns the dark side; a fresh sum does not
    irradiance = np.full((40, 40, 3), 1e-6, np.float32)
    irradiance[10, 10] = 1e8
    logits = np.full((12, 40, 40), -12, np.float32)
    logits[:, :, :12] = 12
    got = _whole(irradiance, np.ones((40, 40), np.float32), logits)
    np.testing.assert_allclose(got[:, 26:], 1e-6, rtol=ROUNDING)


@settings(max_examples=60, deadline=None)
@given(
    height=st.integers(1, 24),
    width=st.integers(1, 24),
    seed=st.integers(0, 2**31),
    spread=st.sampled_from([0.0, 1.0, 30.0, 1e4, np.inf]),
    firefly=st.sampled_from([0.0, 1.0, 1e8, 1e30]),
)
def test_result_stays_within_each_window_for_any_logits(height, width, seed, spread, firefly):
    rng = np.random.default_rng(seed)
    irradiance = rng.random((height, width, 3)).astype(np.float32)
    irradiance[rng.integers(height), rng.integers(width)] = firefly
    samples = rng.uniform(1e-6, 16, (height, width)).astype(np.float32)
    with np.errstate(invalid="ignore"):
        logits = (rng.normal(size=(12, height, width)) * spread).astype(np.float32)
    got = _whole(irradiance, samples, logits)
    assert np.isfinite(got).all()
    for y in range(height):
        for x in range(width):
            window = irradiance[max(y - 6, 0) : y + 7, max(x - 6, 0) : x + 7]
            low, high = window.min((0, 1)), window.max((0, 1))
            assert (got[y, x] >= low * (1 - ROUNDING)).all()
            assert (got[y, x] <= high * (1 + ROUNDING)).all()


def test_nan_logits_do_not_reach_the_image():
    irradiance, samples, logits = _random((9, 11), 4)
    logits[:, 4, 5] = np.nan
    assert np.isfinite(_whole(irradiance, samples, logits)).all()


def test_filter_is_linear_in_colour():
    irradiance, samples, logits = _random((15, 15), 5)
    part = irradiance * np.random.default_rng(0).random(irradiance.shape, np.float32)
    together = _whole(part, samples, logits) + _whole(irradiance - part, samples, logits)
    np.testing.assert_allclose(together, _whole(irradiance, samples, logits), rtol=1e-4)

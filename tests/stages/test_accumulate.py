from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from stillray.arrays.strips import planes_of
from stillray.model_spec import load
from stillray.stages.accumulate import (
    FIRST_SHARE,
    MIN_WEIGHT,
    accumulate,
    bounded,
    clamp_fireflies,
    sample_weight,
)


def _run(frames, options):
    planes = np.zeros((4, *frames[0].shape[:2]), np.float32)
    for frame in frames:
        accumulate(planes_of(frame), np.ones(frame.shape[:2], np.float32), planes, options)
    return planes


def test_mean_of_a_still_scene_is_the_mean_of_its_samples(spec, rng):
    frames = rng.random((5, 4, 6, 3)).astype(np.float32)
    planes = _run(frames, spec.temporal)
    np.testing.assert_allclose(planes[:3].transpose(1, 2, 0), frames.mean(0), rtol=1e-5)
    np.testing.assert_allclose(planes[3], 5)


def test_samples_stop_at_the_maximum_so_that_the_past_fades(spec):
    options = dataclasses.replace(spec.temporal, max_samples=4.0)
    frames = [np.full((1, 1, 3), value, np.float32) for value in [1.0] * 20 + [0.0] * 20]
    planes = _run(frames, options)
    assert planes[3, 0, 0] == 5
    # a share of 4/5 stays a frame
    np.testing.assert_allclose(planes[:3, 0, 0], 0.8**20, rtol=1e-4)


def test_pixels_without_a_past_keep_their_sample(spec):
    planes = np.zeros((4, 2, 2), np.float32)
    planes[:, 0, 0] = [9, 9, 9, 3]
    planes[:, 0, 1] = [1e30, 2, 1e30, 0]  # whatever it says: it holds no sample
    accumulate(np.ones((3, 2, 2), np.float32), np.ones((2, 2), np.float32), planes, spec.temporal)
    np.testing.assert_allclose(planes[:, 1, 1], [1, 1, 1, 1])
    np.testing.assert_allclose(planes[:, 0, 1], [1, 1, 1, 1])
    np.testing.assert_allclose(planes[:, 0, 0], [7, 7, 7, 4])


def _clamped(irradiance, weight):
    return clamp_fireflies(irradiance, weight, np.empty_like(irradiance))


def _weights(light, local, held, options, exposure=1.0):
    held = None if held is None else np.full_like(light, held)
    return sample_weight(light, np.full_like(light, local), held, exposure, options)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_weight_depends_on_relative_brightness_only(scale, spec):
    light = np.float32([[0, 0.1, 1, 1e3, 1e30]])
    base = _weights(light, 0.4, 3, spec.temporal)
    scaled = _weights(light * np.float32(scale), 0.4, 3, spec.temporal, 1 / scale)
    np.testing.assert_allclose(scaled, base, rtol=1e-5)


def test_weight_of_a_firefly_in_a_frame_too_dark_for_float32_is_a_number(spec):
    light = np.float32([[1e31, 1e-30]])
    weight = _weights(light, 0.5, 4, spec.temporal, exposure=1e30)
    assert np.isfinite(weight).all()
    assert weight[0, 0] < 1e-30
    assert weight[0, 1] == pytest.approx(1, abs=1e-2)


@pytest.mark.parametrize("held", [None, 0.0, 1.0, 17.0])
def test_weight_bounds_what_a_firefly_contributes(held, spec):
    light = np.geomspace(1e-3, 1e31, 69, dtype=np.float32)[None]
    weight = _weights(light, 0.5, held, spec.temporal)
    assert (weight > 0).all()
    assert (weight <= 1).all()
    # local luminance 0.5, tone-mapped, is 1; 0.02 is added
    many = 1 + (held or 0)
    usual = FIRST_SHARE * spec.temporal.outlier_ratio * many * 1.02
    assert (weight * light).max() <= usual * (1 + 1e-5)
    relative = light.astype(np.float64) / usual
    expected = 1 / (1 + relative**2 / (1 + relative))
    np.testing.assert_allclose(weight, expected, rtol=1e-5)


def test_one_firefly_moves_a_mean_of_any_age_by_no_more_than_a_first_sample_may(spec):
    options = spec.temporal
    for held in (1.0, 4.0, 16.0):
        planes = np.full((4, 1, 1), 1.0, np.float32)
        planes[3] = held
        light = np.full((1, 1), 1e30, np.float32)
        weight = _weights(light, 0.5, held, options)
        accumulate(planes_of(_clamped(np.dstack([light] * 3), weight)), weight, planes, options)
        # (1 + n) / n of it, and nothing for the weight of the firefly itself
        assert planes[0, 0, 0] <= 1 + FIRST_SHARE * options.outlier_ratio * 1.02 * (1 + held) / held


def test_ordinary_noise_keeps_its_energy(spec, rng):
    # exponential, a third of the samples black: as 1 sample a pixel of a soft light
    shape = (200, 300)
    planes, plain = np.zeros((2, 4, *shape), np.float32)
    local, once = np.full(shape, 0.5, np.float32), np.ones(shape, np.float32)
    kept = []
    for frame in range(50):
        light = (rng.exponential(1.0, shape) * (rng.random(shape) < 0.7) / 0.7).astype(np.float32)
        samples = np.dstack([light] * 3)
        weight = sample_weight(light, local, planes[3], 1.0, spec.temporal)
        accumulate(planes_of(samples), weight, planes, spec.temporal)
        accumulate(planes_of(samples), once, plain, spec.temporal)
        if frame >= 20:
            kept.append(planes[0].mean() / plain[0].mean())
    assert np.mean(kept) == pytest.approx(1, abs=1e-3)


def test_too_low_a_weight_makes_the_sample_darker_instead(rng):
    irradiance = rng.random((3, 4, 3)).astype(np.float32)
    weight = np.full((3, 4), 0.5, np.float32)
    assert _clamped(irradiance, weight) is irradiance
    weight[1, 2] = MIN_WEIGHT / 1000
    before, products = irradiance.copy(), irradiance * weight[..., None]
    bounded = _clamped(irradiance, weight)
    np.testing.assert_array_equal(irradiance, before)
    assert weight.min() == np.float32(MIN_WEIGHT)
    np.testing.assert_allclose(bounded * weight[..., None], products, rtol=1e-6)
    np.testing.assert_array_equal(bounded[0], before[0])


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_what_stands_far_above_its_surroundings_is_bounded_and_noise_is_not(rng, scale):
    spec = load("munet-x2")
    radiance = (scale * rng.exponential(1.0, (40, 50, 1)) * [0.9, 0.6, 0.3]).astype(np.float32)
    fireflies = radiance.copy()
    fireflies[20, 25] = np.float32(scale * 1e30)
    fireflies[5, 40] = scale * 100 * np.float32([0.9, 0.6, 0.3])
    given = fireflies.copy()
    found = bounded(given, 0.5 / scale, spec.transfer, spec.temporal)
    np.testing.assert_array_equal(given, fireflies)
    ordinary = np.ones((40, 50), bool)
    ordinary[20, 25] = ordinary[5, 40] = False
    np.testing.assert_allclose(found[ordinary], radiance[ordinary], rtol=0.01)
    assert 100 * scale < found[20, 25].max() < 300 * scale
    # a highlight stays one, and keeps its color
    assert found[5, 40, 0] > 50 * scale
    np.testing.assert_allclose(found[5, 40] / found[5, 40, 0], [1, 2 / 3, 1 / 3], rtol=1e-5)

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from stillray.accumulate import accumulate, sample_weight


def _run(frames, options):
    planes = np.zeros((4, *frames[0].shape[:2]), np.float32)
    for frame in frames:
        accumulate(frame, np.ones(frame.shape[:2], np.float32), planes, options)
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
    accumulate(np.ones((2, 2, 3), np.float32), np.ones((2, 2), np.float32), planes, spec.temporal)
    np.testing.assert_allclose(planes[:, 1, 1], [1, 1, 1, 1])
    np.testing.assert_allclose(planes[:, 0, 1], [1, 1, 1, 1])
    np.testing.assert_allclose(planes[:, 0, 0], [7, 7, 7, 4])


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_weight_depends_on_relative_brightness_only(scale, spec):
    light = np.float32([[0, 0.1, 1, 1e3, 1e30]])
    local = np.full_like(light, 0.4)
    base = sample_weight(light, local, 1.0, spec.temporal)
    scaled = sample_weight(light * np.float32(scale), local, 1 / scale, spec.temporal)
    np.testing.assert_allclose(scaled, base, rtol=1e-5)


def test_weight_bounds_what_a_firefly_contributes(spec):
    light = np.geomspace(1e-3, 1e30, 50, dtype=np.float32)[None]
    weight = sample_weight(light, np.full_like(light, 0.5), 1.0, spec.temporal)
    assert (weight > 0).all()
    assert (weight <= 1).all()
    below = light < 1e6  # beyond, the smallest weight holds
    bound = spec.temporal.outlier_ratio * (1 + 0.02)
    assert (weight * light)[below].max() <= bound * (1 + 1e-5)

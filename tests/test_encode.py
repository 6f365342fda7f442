from __future__ import annotations

import numpy as np
import pytest

from stillray import encode


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_features_do_not_change_with_the_scene_s_exposure(scale, spec, rng):
    mean = rng.lognormal(0, 1, (33, 18, 4)).astype(np.float32)
    scaled = mean * np.float32([scale, scale, scale, 1])

    def features(accumulated):
        light = encode.luminance(np.ascontiguousarray(accumulated[..., :3]))
        exposure = encode.frame_exposure(light, spec.transfer)
        local = encode.local_luminance(light, exposure, spec.transfer)
        return encode.feature_planes(
            accumulated,
            local,
            exposure,
            spec.temporal,
            albedo=None,
            normal=None,
            depth=None,
            depth_unit=1.0,
        )

    base = features(mean)
    for name, plane in features(scaled).items():
        np.testing.assert_allclose(plane, base[name], rtol=1e-4, err_msg=name)


def test_exposure_ignores_fireflies_and_black_pixels(spec):
    light = np.full((64, 64), 0.5, np.float32)
    calm = encode.frame_exposure(light, spec.transfer)
    light[3, 3] = 1e20
    light[32:40, :40] = 0
    assert encode.frame_exposure(light, spec.transfer) == pytest.approx(calm)


def test_exposure_of_a_black_frame_is_one(spec):
    assert encode.frame_exposure(np.zeros((5, 5), np.float32), spec.transfer) == 1.0


def test_exposure_of_a_sequence_follows_a_change_of_light(spec):
    exposure = None
    for _ in range(60):
        exposure = encode.steady_exposure(100.0, exposure or 1.0, spec.transfer)
    assert 95 < exposure <= 100


def test_tone_map_is_monotonic_and_finite_up_to_infinity():
    values = np.float32([0, 1e-20, 1, 1e20, 3e38, np.inf])
    mapped = encode.tone_map(values, 1e10)
    assert np.isfinite(mapped).all()
    assert (np.diff(mapped) >= 0).all()
    assert mapped[0] == 0
    assert mapped[-1] == 1


def test_depth_feature_is_zero_for_background(spec):
    depth = np.float32([[0, 2, 4]])
    planes = encode.feature_planes(
        np.ones((1, 3, 4), np.float32),
        np.zeros((1, 3), np.float32),
        1.0,
        spec.temporal,
        albedo=None,
        normal=None,
        depth=depth,
        depth_unit=encode.depth_scale(depth),
    )
    np.testing.assert_allclose(planes["depth"], [[0, 2 / 5, 4 / 7]])

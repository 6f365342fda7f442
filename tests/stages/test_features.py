from __future__ import annotations

import numpy as np
import pytest

from stillray.model_spec.planes import FEATURES
from stillray.stages import features as encode


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_features_do_not_change_with_the_scene_s_exposure(scale, spec, rng):
    mean = rng.lognormal(0, 1, (33, 18, 4)).astype(np.float32)
    scaled = mean * np.float32([scale, scale, scale, 1])

    def features(accumulated):
        light = encode.luminance(accumulated)
        exposure = encode.frame_exposure(light, spec.transfer)
        local = encode.local_luminance(encode.tone_map(light, exposure), spec.transfer)
        return _planes(accumulated, local, exposure, spec)

    np.testing.assert_allclose(features(scaled), features(mean), rtol=1e-4)


def _planes(mean, local, exposure, spec, depth=None):
    out = np.zeros((len(FEATURES), *local.shape), np.float32)
    given = encode.FeatureInputs(
        mean=mean, local=local, exposure=exposure, sample=encode.luminance(mean), depth=depth,
        depth_unit=1.0 if depth is None else encode.depth_scale(depth),
    )  # fmt: skip
    encode.feature_planes(given, spec.temporal, FEATURES, out=out)
    return out


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
    mean, local = np.ones((1, 3, 4), np.float32), np.zeros((1, 3), np.float32)
    planes = _planes(mean, local, 1.0, spec, depth)
    np.testing.assert_allclose(planes[FEATURES.index("depth")], [[0, 2 / 5, 4 / 7]])


def test_every_feature_lands_in_the_plane_of_its_name(spec, rng):
    mean = rng.random((4, 5, 4)).astype(np.float32)
    albedo, normal = rng.random((2, 4, 5, 3)).astype(np.float32)
    local = np.full((4, 5), 0.25, np.float32)
    sample = rng.random((4, 5)).astype(np.float32)
    asked = (
        "normal.z", "samples", "albedo.g", "local_luminance", "irradiance.b", "sample.luminance",
        "irradiance.luminance", "albedo.luminance",
    )  # fmt: skip
    out = np.full((len(asked), 4, 5), np.nan, np.float32)
    given = encode.FeatureInputs(
        mean=mean, local=local, exposure=2.0, sample=sample, albedo=albedo, normal=normal
    )
    encode.feature_planes(given, spec.temporal, asked, out=out)

    def shown(light):
        return np.sqrt(2 * light / (1 + 2 * light))

    rec709 = np.array([0.2126, 0.7152, 0.0722])
    samples = mean[..., 3]
    expected = [
        normal[..., 2],
        np.sqrt(samples / (samples + spec.temporal.max_samples / 4)),
        albedo[..., 1],
        np.full((4, 5), 0.5),
        shown(mean[..., 2]),
        shown(sample),
        shown(mean[..., :3] @ rec709),
        albedo @ rec709,
    ]
    np.testing.assert_allclose(out, expected, rtol=1e-5)


@pytest.mark.parametrize(
    ("spread", "told"), [(None, 0), (0.35, 0), (0.275, -0.5), (0.425, 0.5), (0.0, -1), (2.0, 1)]
)
def test_the_pixel_filter_s_plane_is_its_spread_from_the_middle(spread, told, spec):
    mean = np.ones((3, 4, 4), np.float32)
    out = np.full((1, 3, 4), np.nan, np.float32)
    given = encode.FeatureInputs(
        mean=mean, local=mean[..., 0], exposure=1.0, sample=mean[..., 0], filter_spread=spread
    )
    encode.feature_planes(given, spec.temporal, ("pixel_filter",), out=out)
    np.testing.assert_allclose(out, told, atol=1e-6)


def test_the_paper_s_planes_are_displayed_radiance_and_normals_from_0_to_1(spec, rng):
    mean = rng.lognormal(0, 1, (6, 7, 4)).astype(np.float32)
    mean[2, 3, :3] = 1e30  # white
    mean[1, 1, :3] = 0
    by = rng.uniform(0.1, 1, (6, 7, 3)).astype(np.float32)
    normal = rng.uniform(-1, 1, (6, 7, 3)).astype(np.float32)
    asked = ("ldr.b", "scaled_normal.y", "ldr.r")
    out = np.full((3, 6, 7), np.nan, np.float32)
    given = encode.FeatureInputs(
        mean=mean, local=mean[..., 0], exposure=0.3, sample=mean[..., 0], normal=normal,
        demodulation_albedo=by,
    )  # fmt: skip
    encode.feature_planes(given, spec.temporal, asked, out=out)
    # exposed to where a display is: twice what brings irradiance to a quarter
    shown = np.clip(mean[..., :3].astype(np.float64) * by * 0.3 * 2, 0, 1) ** (1 / 2.2)
    expected = [shown[..., 2], (normal[..., 1] + 1) / 2, shown[..., 0]]
    np.testing.assert_allclose(out, expected, rtol=1e-5)
    bare = encode.FeatureInputs(mean=mean, local=mean[..., 0], exposure=0.3, sample=mean[..., 0])
    encode.feature_planes(bare, spec.temporal, asked, out=out)
    shown = np.clip(mean[..., :3].astype(np.float64) * 0.3 * 2, 0, 1) ** (1 / 2.2)
    np.testing.assert_allclose(out[2], shown[..., 0], rtol=1e-5)
    assert (out[1] == 0.5).all()


def test_previous_planes_are_toned_irradiance_of_the_last_output(rng):
    names = ("previous.luminance", "previous.r", "previous.g", "previous.b", "previous.valid")
    previous = rng.lognormal(0, 1, (5, 7, 4)).astype(np.float32)
    albedo = rng.uniform(0.1, 1, (5, 7, 3)).astype(np.float32)
    out = np.full((5, 5, 7), np.nan, np.float32)
    encode.previous_planes(previous, albedo, 0.3, names, out=out)
    rec709 = np.array([0.2126, 0.7152, 0.0722])
    colors = np.moveaxis(previous[..., :3].astype(np.float64) / albedo, -1, 0)
    light = (previous[..., :3] @ rec709) / (albedo @ rec709)
    for plane, value in zip(out, [light, *colors], strict=False):
        np.testing.assert_allclose(plane, np.sqrt(0.3 * value / (1 + 0.3 * value)), rtol=1e-5)
    np.testing.assert_array_equal(out[4], previous[..., 3])
    encode.previous_planes(None, albedo, 0.3, names, out=out)
    assert not out.any()

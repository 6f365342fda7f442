from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from stillray.arrays.strips import Strips
from stillray.stages.features import luminance
from stillray_training.peers.sequence import SequenceOptions, prepare
from stillray_training.peers.svgf import (
    DEPTH_EPSILON,
    LUMINANCE_EPSILON,
    Edges,
    Svgf,
    SvgfOptions,
    estimate_variance,
    find_edges,
    wavelet_pass,
)
from tests.conftest import make_frame

OPTIONS = SvgfOptions()
STRIPS = Strips(1)


def random_edges(rng, height, width):
    """Two tilted surfaces that meet, a little rough; background in a corner."""
    normal = np.zeros((height, width, 3))
    normal[...] = [0.6, 0, 0.8]
    normal[:, width // 2 :] = [0, 0, 1]
    normal += rng.normal(0, 0.03, normal.shape)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    depth = 3 + 0.1 * np.arange(width) + rng.normal(0, 0.05, (height, width))
    depth[: height // 3, : width // 3] = 0
    return Edges(
        normal=normal.astype(np.float32),
        depth=depth.astype(np.float32),
        slope_x=rng.normal(0.1, 0.02, (height, width)).astype(np.float32),
        slope_y=rng.normal(0, 0.02, (height, width)).astype(np.float32),
    )


def geometry_weight(edges, p, q):
    """Eq. 3 and 4 for two pixels (row, column)."""
    z_p, z_q = float(edges.depth[p]), float(edges.depth[q])
    along = edges.slope_x[p] * (p[1] - q[1]) + edges.slope_y[p] * (p[0] - q[0])
    expected = OPTIONS.depth_sigma * abs(float(along)) + DEPTH_EPSILON * z_p + 1e-18
    cosine = float(edges.normal[p].astype(np.float64) @ edges.normal[q].astype(np.float64))
    w_n = min(max(0.0, cosine), 1.0) ** OPTIONS.normal_power
    # a pixel agrees with itself, however its normal was rounded
    return 1.0 if p == q else math.exp(-abs(z_p - z_q) / expected) * w_n


def slow_wavelet_pass(irradiance, variance, edges, step):
    """Eq. 1, 2 and 5, pixel by pixel."""
    height, width = variance.shape
    h = {-2: 1 / 16, -1: 1 / 4, 0: 3 / 8, 1: 1 / 4, 2: 1 / 16}
    gauss = {-1: 1 / 4, 0: 1 / 2, 1: 1 / 4}
    light = irradiance.astype(np.float64) @ [0.2126, 0.7152, 0.0722]
    result, result_variance = np.zeros(irradiance.shape), np.zeros(variance.shape)
    for y in range(height):
        for x in range(width):
            steady = sum(
                gauss[i] * gauss[j]
                * float(variance[np.clip(y + i, 0, height - 1), np.clip(x + j, 0, width - 1)])
                for i in gauss for j in gauss
            )  # fmt: skip
            scale = OPTIONS.luminance_sigma * math.sqrt(steady) + LUMINANCE_EPSILON
            total, weights, squares = np.zeros(3), 0.0, 0.0
            for i in h:
                for j in h:
                    q = (y + i * step, x + j * step)
                    if not (0 <= q[0] < height and 0 <= q[1] < width):
                        continue
                    w_l = math.exp(-abs(light[y, x] - light[q]) / scale)
                    weight = h[i] * h[j] * geometry_weight(edges, (y, x), q) * w_l
                    total += weight * irradiance[q]
                    weights += weight
                    squares += weight**2 * float(variance[q])
            result[y, x] = total / weights
            result_variance[y, x] = squares / weights**2
    return result, result_variance


@pytest.mark.parametrize("step", [1, 2, 8])
def test_wavelet_pass_is_its_definition(rng, step):
    irradiance = rng.exponential(1.0, (11, 17, 3)).astype(np.float32)
    variance = rng.exponential(0.5, (11, 17)).astype(np.float32)
    edges = random_edges(rng, 11, 17)
    result = wavelet_pass(irradiance, variance, edges, step, OPTIONS, STRIPS)
    for got, wanted in zip(
        result, slow_wavelet_pass(irradiance, variance, edges, step), strict=True
    ):
        # float32 rounds differences of depth, which exp and the power of 128 magnify
        np.testing.assert_allclose(got, wanted, rtol=2e-3, atol=1e-6)


def test_strips_and_whole_image_agree(rng):
    # wide enough for several strips of 2^17 pixels
    irradiance = rng.exponential(1.0, (100, 3000, 3)).astype(np.float32)
    variance = rng.exponential(0.5, (100, 3000)).astype(np.float32)
    edges = random_edges(rng, 100, 3000)
    one = wavelet_pass(irradiance, variance, edges, 4, OPTIONS, Strips(1))
    two = wavelet_pass(irradiance, variance, edges, 4, OPTIONS, Strips(3))
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)


def test_variance_of_short_histories_is_spatial_and_of_long_ones_temporal(rng):
    height, width = 12, 15
    moments = rng.exponential(1.0, (height, width, 2)).astype(np.float32)
    moments[..., 1] += moments[..., 0] ** 2
    frames = rng.integers(1, 9, (height, width)).astype(np.float32)
    edges = random_edges(rng, height, width)
    got = estimate_variance(moments, frames, edges, OPTIONS, STRIPS)
    for y in range(height):
        for x in range(width):
            first, second = moments[y, x].astype(np.float64)
            if frames[y, x] < 4:
                weights = {
                    (i, j): geometry_weight(edges, (y, x), (i, j))
                    for i in range(max(y - 3, 0), min(y + 4, height))
                    for j in range(max(x - 3, 0), min(x + 4, width))
                }
                first, second = sum(
                    w * moments[q].astype(np.float64) for q, w in weights.items()
                ) / sum(weights.values())
            assert got[y, x] == pytest.approx(max(second - first**2, 0), rel=2e-3, abs=1e-5)


def test_slope_of_jittered_depth_is_that_of_the_surface(rng):
    column = np.mgrid[:30, :40][1]
    jitter = rng.uniform(-0.5, 0.5, (30, 40))
    depth = 4 + 0.2 * (column + jitter)
    depth[:, 20:] += 3  # a second surface behind
    frame = make_frame(30, 40)
    buffers = prepare(type(frame)(color=frame.color, depth=depth), None, SequenceOptions())
    edges = find_edges(buffers)
    assert np.median(edges.slope_x) == pytest.approx(0.2, abs=0.05)
    assert np.abs(edges.slope_x[:, 15:25]).max() < 1  # the step is not a slope


def test_an_edge_of_geometry_is_not_filtered_across(rng):
    height, width = 16, 20
    irradiance = np.full((height, width, 3), 0.1, np.float32)
    irradiance[:, 10:] = 50
    variance = np.full((height, width), 1e4, np.float32)  # luminance stops nothing
    normal = np.zeros((height, width, 3), np.float32)
    normal[:, :10, 0] = normal[:, 10:, 2] = 1
    zero = np.zeros((height, width), np.float32)
    edges = Edges(normal=normal, depth=zero + 1, slope_x=zero, slope_y=zero)
    result, less = wavelet_pass(irradiance, variance, edges, 1, OPTIONS, STRIPS)
    np.testing.assert_allclose(result, irradiance, rtol=1e-6)
    assert less.max() < 0.4 * variance.max()


def test_the_first_pass_is_what_the_next_frame_remembers():
    stream, frame = Svgf(), make_frame(20, 30)
    stream.denoise(frame)
    buffers = prepare(frame, None, OPTIONS.sequence)
    light = luminance(buffers.irradiance)
    edges = find_edges(buffers)
    ones = np.ones_like(light)
    variance = estimate_variance(np.stack([light, light**2], -1), ones, edges, OPTIONS, STRIPS)
    once, _ = wavelet_pass(buffers.irradiance, variance, edges, 1, OPTIONS, STRIPS)
    np.testing.assert_allclose(stream.history.color[..., :3], once, rtol=1e-6)
    np.testing.assert_allclose(stream.history.moments[..., 1], light**2, rtol=1e-6)


def test_smooth_light_of_a_static_noiseless_scene_comes_back():
    # the first frames are blurred, for variance in space cannot tell shading from noise; then
    # variance over time says that there is none
    frame = make_frame(40, 48)
    light = 0.5 + 0.4 * np.sin(np.mgrid[:40, :48][0] / 9)[..., None]
    frame = dataclasses.replace(frame, color=frame.albedo * light)
    stream = Svgf()
    errors = [np.abs(stream.denoise(frame) / frame.color - 1).max() for _ in range(40)]
    assert errors[0] > 0.05
    assert errors[-1] < 0.01


def test_moments_are_accumulated_over_frames():
    stream = Svgf()
    lights = []
    for seed in range(2):
        frame = make_frame(20, 30, seed)
        stream.denoise(frame)
        lights.append(luminance(prepare(frame, None, OPTIONS.sequence).irradiance))
    moments = stream.history.moments
    np.testing.assert_allclose(moments[..., 0], np.mean(lights, axis=0), rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(moments[..., 1], np.mean(np.square(lights), axis=0), rtol=1e-5)


def test_the_first_frame_goes_through_passes_of_doubling_steps():
    frame = make_frame(40, 70)
    buffers = prepare(frame, None, OPTIONS.sequence)
    edges = find_edges(buffers)
    light = luminance(buffers.irradiance)
    ones = np.ones_like(light)
    moments = np.stack([light, light**2], -1)
    mean = buffers.irradiance
    variance = estimate_variance(moments, ones, edges, OPTIONS, STRIPS)
    for step in (1, 2, 4, 8, 16):
        mean, variance = wavelet_pass(mean, variance, edges, step, OPTIONS, STRIPS)
    np.testing.assert_allclose(
        Svgf().denoise(frame), mean * buffers.demodulation_albedo, rtol=1e-4, atol=1e-6
    )

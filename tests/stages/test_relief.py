"""Relief that was filtered away: against loops, and what must and must not come back."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from stillray.arrays.strips import Strips
from stillray.arrays.workspace import Workspace
from stillray.stages import relief
from tests import oracles

WINDOW = 12.0


def frame(height, width, rng, *, noise=0.5, slope=(0.8, -0.4, 0.2), bumps=0.3):
    """A bumpy wall: what was filtered (even), a sample of it as noisy as asked for, its truth."""
    rows, columns = np.mgrid[:height, :width]
    normal = np.zeros((height, width, 3))
    for axis in range(3):
        a, b = rng.uniform(0.5, 1.0, 2)
        normal[..., axis] = bumps * np.sin(a * columns + rng.uniform(0, 6)) * np.cos(b * rows)
    truth = 1 + normal @ np.array(slope)
    grain = rng.lognormal(-(noise**2) / 2, noise, (height, width))
    albedo = np.full((height, width, 3), (0.8, 0.5, 0.3), np.float32)
    image = albedo.copy()
    prepared = SimpleNamespace(
        normal=normal.astype(np.float32),
        depth=(2 + 0.001 * columns + 0.002 * rows).astype(np.float32),
        luminance=(truth * grain).astype(np.float32),
        remodulation_albedo=albedo,
        history=SimpleNamespace(exposure=0.4),
    )
    return image, prepared, truth


def shaded(image, prepared, threads=1, pixels=None):
    image = image.copy()
    strips = Strips(threads) if pixels is None else Strips(threads, pixels=pixels)
    gain = relief.shade(image, prepared, WINDOW, strips, Workspace())
    return image, gain


@pytest.mark.parametrize(("height", "width"), [(1, 1), (5, 7), (8, 16), (41, 50), (96, 70)])
@pytest.mark.parametrize("depth", [True, False])
def test_the_gain_equals_the_loop_oracle(height, width, depth, rng):
    image, prepared, _ = frame(height, width, rng)
    image *= rng.uniform(0.5, 2, (height, width, 1)).astype(np.float32)
    if not depth:
        prepared.depth = None
    else:
        prepared.depth[rng.random((height, width)) < 0.1] = 0
    found, gain = shaded(image, prepared)
    expected = oracles.relief(image, prepared, WINDOW)
    np.testing.assert_allclose(gain, expected, rtol=2e-5)
    np.testing.assert_allclose(found, image * expected[..., None], rtol=3e-5)


@pytest.mark.parametrize("threads", [1, 3])
def test_strips_do_not_show(threads, rng):
    image, prepared, _ = frame(141, 90, rng)
    whole, _ = shaded(image, prepared)
    cut, _ = shaded(image, prepared, threads, pixels=9 * 90)
    np.testing.assert_array_equal(cut, whole)


def test_relief_that_was_filtered_away_comes_back(rng):
    image, prepared, truth = frame(120, 160, rng, noise=0.7)
    found, _ = shaded(image, prepared)
    before = np.square(image[..., 0] / 0.8 - truth).mean()
    after = np.square(found[..., 0] / 0.8 - truth).mean()
    assert after < 0.25 * before


@pytest.mark.parametrize("noise", [0.5, 2.0])
def test_noise_is_not_taken_for_relief(noise, rng):
    image, prepared, _ = frame(120, 160, rng, noise=noise, slope=(0, 0, 0))
    _, gain = shaded(image, prepared)
    assert np.square(gain - 1).mean() ** 0.5 < 0.02


def test_what_is_there_already_is_not_added_again(rng):
    image, prepared, truth = frame(120, 160, rng)
    image *= truth[..., None].astype(np.float32)
    found, _ = shaded(image, prepared)
    assert np.abs(found / image - 1).mean() < 0.02


def test_even_normals_leave_the_picture_as_it_is(rng):
    image, prepared, _ = frame(40, 50, rng, bumps=0.0)
    found, gain = shaded(image, prepared)
    np.testing.assert_array_equal(gain, 1)
    np.testing.assert_array_equal(found, image)


def test_edges_between_surfaces_keep_the_light_of_each(rng):
    """A dark wall meets a bright one: their normals differ as their light does."""
    image, prepared, _ = frame(64, 64, rng, bumps=0.0, noise=0.3)
    prepared.normal[:, :32], prepared.normal[:, 32:] = (1, 0, 0), (0, 1, 0)
    prepared.luminance[:, :32] *= 0.2
    image[:, :32] *= 0.2
    _, gain = shaded(image, prepared)
    assert np.abs(gain - 1).max() < 0.1


@pytest.mark.parametrize("brightness", [1e-30, 1e-6, 1e6, 1e30])
def test_the_gain_does_not_depend_on_brightness(brightness, rng):
    image, prepared, _ = frame(40, 50, rng)
    _, expected = shaded(image, prepared)
    prepared.luminance *= np.float32(brightness)
    prepared.history.exposure /= brightness
    _, gain = shaded(image * np.float32(brightness), prepared)
    np.testing.assert_allclose(gain, expected, rtol=1e-3)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("broken", ["black", "bright", "no normals", "nothing hit"])
def test_degenerate_frames_stay_finite(broken, rng):
    image, prepared, _ = frame(40, 50, rng)
    if broken == "black":
        image[:], prepared.luminance[:] = 0, 0
    elif broken == "bright":
        prepared.luminance[::7] = 3.4e38
        prepared.remodulation_albedo[:] = 1.15
        prepared.depth[::5] = 1e-30
    elif broken == "no normals":
        prepared.normal[:] = 0
    else:
        prepared.depth[:] = 0
    found, gain = shaded(image, prepared)
    assert np.isfinite(found).all()
    assert gain.min() >= relief.LEAST_GAIN
    assert gain.max() <= relief.MOST_GAIN
    if broken in ("no normals", "nothing hit"):
        np.testing.assert_array_equal(gain, 1)


def test_normals_that_share_their_noise_with_the_light_are_no_relief(rng):
    """Bumps finer than pixels: of a sample normal and light, of many samples neither."""
    image, prepared, _ = frame(120, 160, rng, bumps=0.0, noise=0.0)
    prepared.normal += rng.normal(0, 0.2, prepared.normal.shape).astype(np.float32)
    prepared.luminance *= 1 + prepared.normal @ np.float32([0.8, -0.4, 0.2])
    _, gain = shaded(image, prepared)
    assert np.square(gain - 1).mean() ** 0.5 < 0.005


def test_a_firefly_does_not_draw_relief(rng):
    image, prepared, _ = frame(96, 96, rng, noise=0.2, slope=(0, 0, 0))
    prepared.luminance[40, 40] = 1e8
    _, gain = shaded(image, prepared)
    assert np.abs(gain - 1).max() < 0.1

"""Texture that was filtered away: against loops, and what must and must not come back."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import stillray
from stillray.arrays.strips import Strips
from stillray.arrays.workspace import Workspace
from stillray.model_spec import load
from stillray.stages import relief, texture
from tests.texture_oracle import texture_gain

SPEC = load("kpyr-5")
BLACK, WINDOW = SPEC.demodulate.black, SPEC.texture.window
SUM = 0.25  # of an albedo and this light was divided by


def cloth(height, width, rng, *, noise=0.5, samples=4.0, varnish=0.0):
    """A dark pattern in even light: filtered without it, the light that was accumulated, its truth.

    Without varnish all of the texture is in the light, as far as dividing did not take it out.
    """
    rows, columns = np.mgrid[:height, :width]
    pattern = np.sin(0.9 * columns) * np.cos(0.7 * rows)
    albedo = (0.16 + 0.14 * pattern)[..., None] * np.array([1.0, 0.8, 0.6])
    by = (albedo + SUM).astype(np.float32)
    truth = albedo + varnish
    grain = rng.lognormal(-(noise**2) / 2, noise, (height, width, 1))
    mean = np.ones((height, width, 4), np.float32)
    mean[..., :3] = truth / by * grain
    around = cv2.blur(truth / by, (25, 25), borderType=cv2.BORDER_REPLICATE)
    prepared = SimpleNamespace(
        normal=None,
        depth=(2 + 0.001 * columns + 0.002 * rows).astype(np.float32),
        albedo=albedo.astype(np.float32),
        remodulation_albedo=by,
        mean=mean,
        counts=SimpleNamespace(mean=samples),
        history=SimpleNamespace(exposure=0.4),
    )
    return (around * by).astype(np.float32), prepared, truth


def textured(image, prepared, *, threads=1, pixels=None, weights=None):
    image = image.copy()
    strips = Strips(threads) if pixels is None else Strips(threads, pixels=pixels)
    return image, texture.put_back(image, prepared, SPEC, weights, strips, Workspace())


@pytest.mark.parametrize(("height", "width"), [(1, 1), (5, 7), (8, 16), (41, 50), (64, 47)])
@pytest.mark.parametrize("samples", [2.0, 64.0])
def test_the_gain_equals_the_loop_oracle(height, width, samples, rng):
    image, prepared, _ = cloth(height, width, rng, samples=samples)
    image *= rng.uniform(0.5, 2, (height, width, 1)).astype(np.float32)
    prepared.depth[rng.random((height, width)) < 0.05] = 0
    prepared.albedo[rng.random((height, width)) < 0.004] = 0
    found, gain = textured(image, prepared)
    expected = texture_gain(image, prepared, BLACK, WINDOW)
    np.testing.assert_allclose(gain, expected, rtol=3e-5)
    np.testing.assert_allclose(found, image * expected[..., None], rtol=4e-5)


def test_where_relief_has_found_surfaces_they_are_not_found_again(rng):
    image, prepared, _ = cloth(41, 50, rng)
    prepared.normal = rng.normal(0, 0.4, (41, 50, 3)).astype(np.float32)
    prepared.luminance = prepared.mean[..., 0].copy()
    weights = np.empty((41, 50), np.float32)
    relief.shade(image.copy(), prepared, WINDOW, Strips(1), Workspace(), weights)
    _, gain = textured(image, prepared, weights=weights)
    np.testing.assert_allclose(gain, texture_gain(image, prepared, BLACK, WINDOW), rtol=3e-5)


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("samples", [2.0, 64.0])
def test_strips_do_not_show(threads, samples, rng):
    image, prepared, _ = cloth(141, 90, rng, samples=samples)
    prepared.albedo[70] = 0
    whole, _ = textured(image, prepared)
    cut, _ = textured(image, prepared, threads=threads, pixels=9 * 90)
    np.testing.assert_array_equal(cut, whole)


@pytest.mark.parametrize(("varnish", "left"), [(0.0, 0.25), (1.0, 0.5)])
def test_texture_that_was_filtered_away_comes_back(varnish, left, rng):
    """Too little of it where there is no varnish, too much where there is more than was added."""
    image, prepared, truth = cloth(120, 160, rng, noise=0.7, samples=64, varnish=varnish)
    found, _ = textured(image, prepared)
    before, after = (np.square(each - truth).mean() for each in (image, found))
    assert after < left * before


@pytest.mark.parametrize("noise", [0.5, 2.0])
def test_noise_is_not_taken_for_texture(noise, rng):
    image, prepared, _ = cloth(120, 160, rng, noise=noise, varnish=SUM)
    _, gain = textured(image, prepared)
    assert np.square(gain - 1).mean() ** 0.5 < 0.02


def test_what_is_there_already_is_not_added_again(rng):
    _, prepared, truth = cloth(120, 160, rng, samples=64)
    found, _ = textured(truth.astype(np.float32), prepared)
    assert np.abs(found / truth - 1).mean() < 0.02


def test_an_even_albedo_leaves_the_picture_as_it_is(rng):
    image, prepared, _ = cloth(40, 50, rng)
    prepared.remodulation_albedo[:] = 0.5
    found, gain = textured(image, prepared)
    np.testing.assert_array_equal(gain, 1)
    np.testing.assert_array_equal(found, image)


def test_beside_an_albedo_that_says_nothing_all_stays_as_it_is(rng):
    """A window in dark cloth: it was divided by white, and a pixel of both by their mean."""
    image, prepared, _ = cloth(64, 64, rng, noise=0.2)
    prepared.albedo[20:40, 20:40] = 0
    prepared.remodulation_albedo[20:40, 20:40] = 1.25
    prepared.remodulation_albedo[20:40, [19, 40]] = 0.8
    _, gain = textured(image, prepared)
    np.testing.assert_array_equal(gain[18:42, 18:42], 1)
    assert np.abs(gain - 1).max() > 0.1


def test_an_albedo_of_noise_is_no_texture(rng):
    """Detail finer than pixels: of few samples an albedo shares its noise with nobody around."""
    image, prepared, _ = cloth(120, 160, rng, noise=0.0)
    noisy = 0.4 + 0.1 * rng.standard_normal((120, 160, 1)).astype(np.float32)
    prepared.remodulation_albedo = np.clip(np.repeat(noisy, 3, 2), 0.26, 1)
    prepared.mean[..., :3] = 1 / prepared.remodulation_albedo
    prepared.counts.mean = 1000.0
    image[:] = 1
    _, gain = textured(image, prepared)
    assert np.square(gain - 1).mean() ** 0.5 < 0.005


@pytest.mark.parametrize("brightness", [1e-30, 1e-6, 1e6, 1e30])
def test_the_gain_does_not_depend_on_brightness(brightness, rng):
    image, prepared, _ = cloth(40, 50, rng)
    _, expected = textured(image, prepared)
    prepared.mean[..., :3] *= np.float32(brightness)
    prepared.history.exposure /= brightness
    _, gain = textured(image * np.float32(brightness), prepared)
    np.testing.assert_allclose(gain, expected, rtol=1e-3)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("broken", ["black", "bright", "no albedo", "nothing hit"])
def test_degenerate_frames_stay_finite(broken, rng):
    image, prepared, _ = cloth(40, 50, rng)
    if broken == "black":
        image[:], prepared.mean[..., :3] = 0, 0
    elif broken == "bright":
        prepared.mean[::7, :, :3] = 3.4e38
        prepared.depth[::5] = 1e-30
    elif broken == "no albedo":
        prepared.albedo[:] = 0
    else:
        prepared.depth[:] = 0
    found, gain = textured(image, prepared)
    assert np.isfinite(found).all()
    assert gain.min() >= texture.LEAST_GAIN
    assert gain.max() <= texture.MOST_GAIN
    if broken in ("no albedo", "nothing hit"):
        np.testing.assert_array_equal(gain, 1)


def test_what_is_taken_back_is_what_was_before(rng):
    image, prepared, _ = cloth(141, 90, rng)
    found, gain = textured(image, prepared)
    output = np.dstack([found, np.full(found.shape[:2], 0.75, np.float32)])
    texture.take_back(output, gain, Strips(2))
    np.testing.assert_allclose(output[..., :3], image, rtol=1e-6)
    np.testing.assert_array_equal(output[..., 3], np.float32(0.75))


@pytest.mark.parametrize(
    ("samples", "runs"), [(None, False), (1, False), (2, True), ("map", True), ("few", False)]
)
def test_texture_is_put_back_where_samples_are_told(samples, runs, rng):
    _, prepared, _ = cloth(48, 64, rng)
    told = {
        "map": np.full((48, 64), 3, np.float32), "few": np.full((48, 64), 1.5, np.float32),
    }.get(samples, samples)  # fmt: skip
    frame = stillray.Frame(
        color=prepared.mean[..., :3] * prepared.remodulation_albedo,
        albedo=prepared.albedo,
        depth=prepared.depth,
        samples=told,
    )
    with stillray.Denoiser("kpyr-5s") as denoiser:
        stages = {stage.name: stage for stage in denoiser.stages(frame)}
        assert stages["texture"].runs == runs
        denoiser.denoise(frame)
        again = {stage.name: stage for stage in denoiser.stages(replace(frame, samples=None))}
        assert again["texture"].runs == runs  # as many as the frame before had


def test_pictures_have_it_and_the_next_frame_does_not_see_it(rng):
    _, prepared, _ = cloth(96, 128, rng, noise=1.0)
    frame = stillray.Frame(
        color=(prepared.mean[..., :3] * prepared.remodulation_albedo).astype(np.float32),
        albedo=prepared.albedo,
        depth=prepared.depth,
        motion=np.zeros((96, 128, 2), np.float32),
        samples=64,
    )
    with stillray.Denoiser("kpyr-5s") as denoiser:
        shown = denoiser.denoise(frame)
        state = denoiser.state.temporal
        gain = shown[..., 1] / state.output[..., 1]
        assert gain.std() > 1e-3
        np.testing.assert_allclose(gain, shown[..., 0] / state.output[..., 0], rtol=1e-4)

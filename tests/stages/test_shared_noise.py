"""Whether neighbouring pixels share their noise."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import stillray
from stillray.stages.shared_noise import SHARED_SPREAD, shared_spread
from tests.conftest import make_frame


def picture(rng, *, samples, size=(90, 120), textured=False):
    """Light that varies slowly, albedo, and the light of so many samples a pixel."""
    rows, columns = np.mgrid[: size[0], : size[1]]
    light = 1 + 0.8 * np.sin(rows / 17) * np.cos(columns / 23)
    albedo = np.full((*size, 3), 0.6, np.float32)
    if textured:
        albedo *= 0.3 + 0.7 * ((rows // 3 + columns // 5) % 2)[..., None].astype(np.float32)
    grain = rng.gamma(samples / 4, 4 / samples, size)
    color = (albedo * (light * grain)[..., None]).astype(np.float32)
    return color, albedo


def through(image, deviation):
    return cv2.GaussianBlur(image, (7, 7), deviation, borderType=cv2.BORDER_REPLICATE)


@pytest.mark.parametrize("samples", [1, 4, 64, 1024])
@pytest.mark.parametrize("textured", [False, True])
def test_pixels_with_noise_of_their_own_have_no_shared_filter(samples, textured, rng):
    color, albedo = picture(rng, samples=samples, textured=textured)
    assert shared_spread(color, albedo) is None


@pytest.mark.parametrize("samples", [1, 4, 64])
@pytest.mark.parametrize("deviation", [0.6, 0.8])
def test_samples_that_count_in_several_pixels_are_found(samples, deviation, rng):
    color, albedo = (through(each, deviation) for each in picture(rng, samples=samples))
    assert shared_spread(color, albedo) == SHARED_SPREAD
    assert shared_spread(color, None) == SHARED_SPREAD


@pytest.mark.parametrize("brightness", [1e-30, 1e30])
def test_brightness_does_not_count(brightness, rng):
    color, albedo = picture(rng, samples=4)
    assert shared_spread(color * np.float32(brightness), albedo) is None
    assert shared_spread(through(color, 0.6) * np.float32(brightness), albedo) == SHARED_SPREAD


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [(1, 1), (1, 50), (15, 90), (16, 16), (17, 900)])
def test_black_even_and_small_frames_tell_nothing(size):
    for value in (0.0, 1.0, 3e38):
        assert shared_spread(np.full((*size, 3), value, np.float32), None) is None


@pytest.mark.parametrize("model", ["kpyr-5-still", "kpyr-5s-still"])
def test_what_nobody_says_is_found_and_what_is_told_is_believed(model, rng):
    given = make_frame(60, 80)
    soft = {n: through(getattr(given, n), 0.6) for n in ("color", "albedo", "normal")}
    rest = {"depth": given.depth}
    with stillray.Denoiser(model, temporal=False) as denoiser:
        found = denoiser.denoise(stillray.Frame(**soft, **rest))
        told = denoiser.denoise(stillray.Frame(**soft, **rest, filter_spread=SHARED_SPREAD))
        np.testing.assert_array_equal(found, told)
        box = denoiser.denoise(stillray.Frame(**soft, **rest, filter_spread=0.29))
        assert np.any(box != told)
        stage = {stage.name: stage for stage in denoiser.stages(stillray.Frame(**soft, **rest))}
        assert stage["find_filter"].runs
        frame = stillray.Frame(**soft, **rest, filter_spread=0.29)
        stage = {stage.name: stage for stage in denoiser.stages(frame)}
        assert not stage["find_filter"].runs


def test_models_that_do_not_ask_do_not_look():
    with stillray.Denoiser("kpyr-5s") as denoiser:
        assert "find_filter" not in {stage.name for stage in denoiser.stages(make_frame(20, 30))}

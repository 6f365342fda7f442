"""Small lamps that were filtered away: against loops, and what must and must not come back."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from stillray.arrays.strips import Strips
from stillray.arrays.workspace import Workspace
from stillray.stages import lamps
from tests import oracles

_LAMP = slice(10, 13), slice(20, 24)


def frame(height, width, rng, *, noise=1.0):
    """A wall of light 1, filtered well, and its samples as noisy as asked for."""
    grain = np.ones((height, width))
    if noise:
        grain = rng.gamma(1 / noise**2, noise**2, (height, width))
    albedo = np.full((height, width, 3), (0.8, 0.5, 0.3), np.float32)
    mean = np.ones((height, width, 4), np.float32)
    mean[..., :3] *= grain[..., None].astype(np.float32)
    history = SimpleNamespace(mean=mean, exposure=0.4)
    return albedo.copy(), SimpleNamespace(history=history, sample=None, remodulation_albedo=albedo)


def restored(image, prepared, threads=1, pixels=None):
    image = image.copy()
    strips = Strips(threads) if pixels is None else Strips(threads, pixels=pixels)
    found, before = lamps.restore(image, prepared, strips, Workspace())
    return image, found, before


@pytest.mark.parametrize(("height", "width"), [(1, 1), (2, 3), (5, 7), (31, 40), (60, 33)])
@pytest.mark.parametrize("albedo", [True, False])
def test_the_picture_equals_the_loop_oracle(height, width, albedo, rng):
    image, prepared = frame(height, width, rng)
    image *= rng.uniform(0.3, 2, (height, width, 1)).astype(np.float32)
    mean = prepared.history.mean
    for _ in range(height * width // 150 + 1):  # lamps of all sizes, some where many are
        y, x = (int(rng.integers(size)) for size in (height, width))
        place = slice(y, y + int(rng.integers(1, 5))), slice(x, x + int(rng.integers(1, 5)))
        mean[place][..., :3] = rng.uniform(2, 300) * rng.uniform(
            0.7, 1, (*mean[place].shape[:2], 1)
        )
    if not albedo:
        image /= prepared.remodulation_albedo
        prepared.remodulation_albedo = None
    found, *_ = restored(image, prepared)
    expected = oracles.restored_lamps(image, prepared)
    np.testing.assert_allclose(found, expected, rtol=2e-5, atol=1e-6)
    if height > 5:
        assert np.any(found > 2 * image)


def test_beside_a_past_the_frames_own_samples_tell(rng):
    """What was accumulated has spread a firefly over pixels; the lamp is new in this frame."""
    image, prepared = frame(40, 50, rng)
    prepared.sample = prepared.history.mean.transpose(2, 0, 1).copy()
    prepared.sample[:3, 10:13, 20:24] = 20
    prepared.history.mean[25:30, 5:9, :3] = 20
    found, *_ = restored(image, prepared)
    expected = image.copy()
    expected[_LAMP] = 20 * image[_LAMP]
    np.testing.assert_allclose(found, expected, rtol=1e-5)


@pytest.mark.parametrize("threads", [1, 3])
def test_strips_do_not_show(threads, rng):
    image, prepared = frame(141, 90, rng)
    mean = prepared.history.mean
    for _ in range(60):
        y, x = int(rng.integers(140)), int(rng.integers(88))
        mean[y : y + 3, x : x + 3, :3] = rng.uniform(2, 100)
    whole, *_ = restored(image, prepared)
    assert np.any(whole > 2 * image)
    cut, found, _ = restored(image, prepared, threads, pixels=9 * 90)
    np.testing.assert_array_equal(cut, whole)
    changed = np.zeros(image.shape[:2], bool)
    changed[found.rows, found.columns] = True
    np.testing.assert_array_equal(changed, np.any(whole != image, -1))


@pytest.mark.parametrize("noise", [0.0, 0.25, 0.5, 1.0])
def test_a_lamp_that_was_filtered_away_comes_back(noise, rng):
    image, prepared = frame(40, 50, rng, noise=noise)
    lamp = np.float32([20, 16, 9])
    prepared.history.mean[_LAMP][..., :3] = lamp
    found, *_ = restored(image, prepared)
    expected = np.broadcast_to(lamp * image[0, 0], found[_LAMP].shape)
    np.testing.assert_allclose(found[_LAMP], expected, rtol=1e-5)
    found[_LAMP] = image[_LAMP]
    np.testing.assert_array_equal(found, image)


def test_a_lamp_of_two_rows_comes_back_from_a_clean_wall(rng):
    image, prepared = frame(40, 50, rng, noise=0.2)
    prepared.history.mean[10:12, 20:25, :3] = 30
    found, *_ = restored(image, prepared)
    np.testing.assert_allclose(found[10:12, 20:25], 30 * image[10:12, 20:25], rtol=1e-5)


def test_what_the_picture_has_kept_is_left_alone(rng):
    image, prepared = frame(40, 50, rng)
    prepared.history.mean[_LAMP][..., :3] = 20
    image[_LAMP] *= 17
    found, *_ = restored(image, prepared)
    np.testing.assert_array_equal(found, image)


@pytest.mark.parametrize("size", [(1, 1), (2, 2), (1, 40), (2, 1)])
def test_fireflies_stay_away(size, rng):
    """Single ones, those between four pixels, and thin lines."""
    image, prepared = frame(40, 50, rng, noise=0.3)
    prepared.history.mean[10 : 10 + size[0], 3 : 3 + size[1], :3] = 1e6
    found, *_ = restored(image, prepared)
    np.testing.assert_array_equal(found, image)


@pytest.mark.parametrize("spread", [0.3, 0.5, 0.6])
@pytest.mark.parametrize("place", [(20.0, 25.0), (20.5, 25.0), (20.5, 25.5), (20.2, 25.4)])
def test_a_firefly_that_the_pixel_filter_spreads_stays_away(spread, place, rng):
    image, prepared = frame(40, 50, rng, noise=0.3)
    rows, columns = np.mgrid[:40, :50]
    far = (rows - place[0]) ** 2 + (columns - place[1]) ** 2
    light = 1e4 * np.exp(-far / (2 * spread**2)) * (far < 6)
    prepared.history.mean[..., :3] += light[..., None].astype(np.float32)
    found, *_ = restored(image, prepared)
    np.testing.assert_array_equal(found, image)


@pytest.mark.parametrize("tail", [1.0, 2.0])
def test_noise_is_not_taken_for_lamps(tail, rng):
    """Exponential noise, and such to a power: hardly anything is changed of a million pixels."""
    image, prepared = frame(1000, 1000, rng)
    grain = rng.exponential(1, (1000, 1000)) ** tail
    prepared.history.mean[..., :3] = (grain / grain.mean())[..., None]
    found, *_ = restored(image, prepared)
    assert np.any(found != image, -1).sum() < 100


def test_light_that_falls_into_pixels_by_chance_is_not_taken_for_lamps(rng):
    """One sample in six sees the sky, always as bright: blocks of it are chance."""
    image, prepared = frame(400, 400, rng)
    seen = rng.random((400, 400, 1)) < 1 / 6
    prepared.history.mean[..., :3] = 6 * seen
    found, *_ = restored(image, prepared)
    assert np.any(found != image, -1).mean() < 2e-4


def test_blocks_of_fireflies_are_bounded(rng):
    image, prepared = frame(40, 50, rng, noise=0.2)
    prepared.history.mean[_LAMP][..., :3] = 1e30
    found, *_ = restored(image, prepared)
    assert found.max() <= 1.1 * lamps.MOST


@pytest.mark.parametrize("brightness", [1e-30, 1e-6, 1e6, 1e30])
def test_what_comes_back_does_not_depend_on_brightness(brightness, rng):
    image, prepared = frame(40, 50, rng)
    prepared.history.mean[_LAMP][..., :3] = 20
    expected, *_ = restored(image, prepared)
    assert np.any(expected > 2 * image)
    prepared.history.mean *= np.float32(brightness)
    prepared.history.exposure /= brightness
    found, *_ = restored(image * np.float32(brightness), prepared)
    np.testing.assert_allclose(found / np.float32(brightness), expected, rtol=1e-4)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("broken", ["black", "black picture", "bright"])
def test_degenerate_frames_stay_finite(broken, rng):
    image, prepared = frame(40, 50, rng)
    if broken == "bright":
        prepared.history.mean[::7] = 3.4e38
        prepared.remodulation_albedo[:] = 0.9
    else:
        image[:] = 0
        if broken == "black":
            prepared.history.mean[:] = 0
    found, *_ = restored(image, prepared)
    assert np.isfinite(found).all()


def test_layers_get_their_part(rng):
    """What is put back into layers adds up to what is put back into the picture."""
    image, prepared = frame(40, 50, rng)
    prepared.history.mean[_LAMP][..., :3] = 20
    whole, found, _ = restored(image, prepared)
    shares = rng.random((40, 50, 1)).astype(np.float32)
    total = np.zeros_like(image)
    for share in (shares, 1 - shares):
        layer = image * 0.5
        found.put_back(layer, prepared.history.mean * share, prepared.remodulation_albedo)
        total += layer
    np.testing.assert_allclose(total, whole, rtol=1e-5)


def test_what_is_remembered_is_the_picture_as_it_was_filtered(rng):
    image, prepared = frame(40, 50, rng)
    prepared.history.mean[_LAMP][..., :3] = 20
    whole, found, before = restored(image, prepared)
    assert np.any(whole != image)
    found.take_back(whole, before)
    np.testing.assert_array_equal(whole, image)


def test_a_larger_picture_gets_the_light_at_all_its_pixels(rng):
    image, prepared = frame(40, 50, rng)
    prepared.history.mean[_LAMP][..., :3] = 20
    whole, found, _ = restored(image, prepared)
    large, wanted = (each.repeat(2, 0).repeat(2, 1) for each in (image, whole))
    kept = large.copy()
    before = found.put_back(large, prepared.history.mean, prepared.remodulation_albedo, 2)
    np.testing.assert_array_equal(large, wanted)
    found.take_back(large, before, 2)
    np.testing.assert_array_equal(large, kept)

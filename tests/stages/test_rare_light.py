"""Light of rare samples: against loops, and what must and must not come back."""

from __future__ import annotations

import numpy as np
import pytest

from stillray.arrays.strips import Strips
from stillray.arrays.workspace import Workspace
from stillray.stages import rare_light
from tests import rare_light_oracle

WALL = np.float32([0.8, 0.5, 0.3])
LIGHT = float(WALL @ np.float32([0.2126, 0.7152, 0.0722]))


def restored(image, color, strips=None, zoom=1):
    image = image.copy()
    gain = rare_light.restore(image, color, 0.4, strips or Strips(1), Workspace(), zoom)
    return image, gain


def samples(shape, often, brightness, rng):
    """A wall with noise, and with rare samples above it whose mean it is without."""
    color = np.empty((*shape, 3), np.float32)
    color[...] = WALL * rng.gamma(4, 1 / 4, (*shape, 1))
    rare = rng.random(shape) < often
    color[rare] += brightness * WALL
    return color


@pytest.mark.parametrize(("height", "width"), [(1, 1), (9, 40), (33, 50), (70, 61)])
@pytest.mark.parametrize("often", [0.0, 0.01, 0.2])
@pytest.mark.parametrize("zoom", [1, 2])
def test_the_gain_equals_the_loop_oracle(height, width, often, zoom, rng, monkeypatch):
    """Of a picture that may be larger than the frame, too."""
    monkeypatch.setattr(rare_light, "WINDOWS", (7, 3))
    image = WALL * rng.uniform(0.2, 3, (zoom * height, zoom * width, 1)).astype(np.float32)
    color = image[::zoom, ::zoom] * rng.exponential(1, (height, width, 1)).astype(np.float32)
    for bright in (30, 300, 3e4, 1e9):
        color[rng.random((height, width)) < often] *= np.float32(bright)
    found, gain = restored(image, color, zoom=zoom)
    expected = rare_light_oracle.gain_of(image, color, 0.4, zoom)
    if gain is not None:
        np.testing.assert_allclose(gain, expected, rtol=2e-4)
    np.testing.assert_allclose(found, image * expected[..., None], rtol=2e-4)
    if often == 0.2 and height > 9:
        assert expected.max() > 1.2


@pytest.mark.parametrize("brightness", [40.0, 1000.0])
def test_what_many_samples_carry_is_put_back(brightness, rng):
    """A third of the light is theirs, and the filter has taken all of it for fireflies."""
    color = samples((200, 300), 0.5 / brightness, brightness, rng)
    image = np.broadcast_to(WALL, color.shape).astype(np.float32)
    found, _ = restored(image, color)
    np.testing.assert_allclose(found.mean((0, 1)), 1.5 * WALL, rtol=0.1)
    assert np.all(found >= image)


def test_light_comes_back_where_it_was(rng):
    """Left half of a wide frame."""
    color = samples((200, 640), 0.0, 0.0, rng)
    color[:, :320] = samples((200, 320), 0.02, 50, rng)
    found, _ = restored(np.broadcast_to(WALL, color.shape).astype(np.float32), color)
    gain = found[..., 0] / WALL[0]
    assert gain[:, 40:240].mean() == pytest.approx(2, rel=0.15)
    assert gain[:, 400:].mean() < 1.05


def lamps(shape, count, rng):
    """A dim wall with lamps of 4x4 pixels, as filtered, and its samples: their rims catch light."""
    picture = np.broadcast_to(0.02 * WALL, (*shape, 3)).astype(np.float32)
    color = picture.copy()
    for corner in rng.integers(8, np.array(shape) - 12, (count, 2)):
        y, x = corner
        picture[y : y + 4, x : x + 4] = 500
        color[y - 1 : y + 5, x - 1 : x + 5] = 500  # samples of neighbours that met them
    return picture, color


def test_rims_of_lamps_make_nothing_around_them_brighter(rng):
    """In a street at night: the sky above it was 14 % too bright."""
    picture, color = lamps((200, 300), 30, rng)
    found, _ = restored(picture, color)
    np.testing.assert_array_equal(found, picture)


def test_rare_samples_between_lamps_are_put_back(rng):
    picture, color = lamps((200, 300), 6, rng)
    dim = color[..., 0] < 1
    rare = (rng.random(dim.shape) < 0.004) & dim
    color[rare] += 250 * 0.02 * WALL
    found, _ = restored(picture, color)
    assert 1.25 < (found / picture)[dim].mean() < 2


@pytest.mark.parametrize("side", [2, 3, 5])
@pytest.mark.parametrize("brightness", [1e3, 1e8])
def test_a_sample_that_many_pixels_share_is_one(side, brightness, rng):
    """Wide pixel filters spread a firefly; where it lies across blocks makes no difference."""
    color = samples((200, 300), 0.0, 0.0, rng)
    for corner in (40, 60, 91):
        color[corner : corner + side, 2 * corner : 2 * corner + side] = brightness
    image = np.broadcast_to(WALL, color.shape).astype(np.float32)
    found, _ = restored(image, color)
    np.testing.assert_array_equal(found, image)


@pytest.mark.parametrize("count", [1, 3, 6])
def test_a_few_fireflies_stay_away(count, rng):
    color = samples((200, 300), 0.0, 0.0, rng)
    for _ in range(count):
        color[rng.integers(200), rng.integers(300)] = 1e5
    image = np.broadcast_to(WALL, color.shape).astype(np.float32)
    found, gain = restored(image, color)
    assert gain is None
    np.testing.assert_array_equal(found, image)


def test_one_firefly_does_not_hide_what_others_carry(rng):
    color = samples((200, 300), 0.02, 50, rng)
    image = np.broadcast_to(WALL, color.shape).astype(np.float32)
    without, _ = restored(image, color)
    color[100, 150] = 1e30
    found, _ = restored(image, color)
    np.testing.assert_allclose(found, without, rtol=0.01)


def test_a_picture_that_has_the_light_is_left_alone(rng):
    color = samples((200, 300), 0.01, 50, rng)
    image = np.broadcast_to(1.55 * WALL, color.shape).astype(np.float32)
    found, _ = restored(image, color)
    np.testing.assert_allclose(found, image, rtol=0.02)


@pytest.mark.parametrize("shape", [0.25, 1.0, 4.0])
def test_ordinary_noise_changes_nothing_to_speak_of(shape, rng):
    """Gamma noise, down to a quarter of a sample: its rare samples are in the mean."""
    color = np.empty((360, 640, 3), np.float32)
    color[...] = WALL * rng.gamma(shape, 1 / shape, (360, 640, 1))
    image = np.broadcast_to(WALL, color.shape).astype(np.float32)
    found, _ = restored(image, color)
    assert found.mean() == pytest.approx(image.mean(), rel=0.01)
    assert found.max() < 1.1 * WALL.max()


def test_strips_do_not_show(rng):
    color = samples((141, 190), 0.05, 50, rng)
    image = (WALL * rng.uniform(0.5, 1, (141, 190, 1))).astype(np.float32)
    whole, gain = restored(image, color)
    assert gain is not None
    for strips in (Strips(3, pixels=9 * 190), Strips(1, pixels=190)):
        np.testing.assert_array_equal(restored(image, color, strips)[0], whole)


@pytest.mark.parametrize("scale", [1e-30, 1e-12, 1e12, 1e25])
def test_units_of_radiance_do_not_matter(scale, rng):
    color = samples((90, 80), 0.05, 50, rng)
    image = np.broadcast_to(WALL, color.shape).astype(np.float32)
    scaled = image * np.float32(scale)
    gain = rare_light.restore(
        scaled, color * np.float32(scale), 0.4 / scale, Strips(1), Workspace()
    )
    np.testing.assert_allclose(gain, restored(image, color)[1], rtol=1e-4)


def test_black_pictures_stay_black(rng):
    color = np.zeros((60, 60, 3), np.float32)
    found, _ = restored(color, color)
    assert not found.any()

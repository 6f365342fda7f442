"""Frames as a wider pixel filter would have made them."""

import numpy as np
import pytest
from scipy.integrate import quad

from stillray.frame import Frame
from stillray_training.film import film_variance, film_weights, frame_through_film, through_film


@pytest.mark.parametrize("deviation", [0.3, 0.5, 0.6])
def test_a_pixel_gives_what_its_samples_lie_under_the_filter(deviation):
    # a sample anywhere in pixel 0, the filter a normalised Gaussian around each pixel's centre
    def share(pixel):
        def density(place):
            return np.exp(-((place - pixel) ** 2) / (2 * deviation**2))

        return quad(density, -0.5, 0.5)[0]

    wanted = np.array([share(pixel) for pixel in range(-2, 3)])
    np.testing.assert_allclose(film_weights(deviation), wanted / wanted.sum(), atol=1e-7)


def test_noise_becomes_less_and_alike_in_neighbours_and_light_stays():
    noise = np.random.default_rng(1).normal(1, 0.3, (64, 80, 3)).astype(np.float32)
    wide = through_film(noise, 0.5)
    assert abs(wide.mean() - noise.mean()) < 2e-3
    assert wide.std() < 0.6 * noise.std()
    centred = wide - wide.mean()
    alike = (centred[:, 1:] * centred[:, :-1]).mean() / centred.var()
    assert 0.35 < alike < 0.5  # of the weights' own products: 0.43


def test_light_and_surfaces_go_through_the_filter_and_places_do_not():
    shape = (9, 11)
    step = np.zeros((*shape, 3), np.float32)
    step[:, 5:] = 1
    color = step.copy()
    color[4, 4] = np.nan
    depth = np.linspace(1, 2, 99, dtype=np.float32).reshape(shape)
    motion = np.ones((*shape, 2), np.float32)
    frame = Frame(color=color, albedo=step, normal=step, depth=depth, motion=motion)
    wide = frame_through_film(frame, 0.5)
    edge = film_weights(0.5)[3:].sum()
    for image in (wide.color, wide.albedo, wide.normal):
        np.testing.assert_allclose(image[0, 4], edge, rtol=1e-5)
        assert np.isfinite(image).all()
    assert wide.depth is frame.depth
    assert wide.motion is frame.motion


@pytest.mark.parametrize("deviation", [0.3, 0.5, 0.6])
def test_a_film_adds_its_variance_to_that_of_the_render(deviation):
    image = np.zeros((11, 11, 1), np.float32)
    image[5, 5] = 1
    row = through_film(image, deviation).reshape(11, 11).sum(0)
    places = np.arange(11) - 5
    assert film_variance(deviation) == pytest.approx((row * places**2).sum(), rel=1e-5)

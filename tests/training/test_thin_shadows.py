"""Thin shadows painted into the light of frames that are learned from."""

from __future__ import annotations

import numpy as np

from stillray import Frame
from stillray_training.thin_shadows import draw_shadow, in_shadow, reference_in_shadow

_SHAPE = (96, 120)
_SEEDS = range(24)


def _drawn(seed: int, spread: float | None = None) -> np.ndarray:
    return draw_shadow(_SHAPE, spread, np.random.default_rng(seed))


def test_some_light_is_left_and_some_of_the_picture_is_lit():
    darkest = []
    for seed in _SEEDS:
        light = _drawn(seed)
        assert light.shape == _SHAPE
        assert light.dtype == np.float32
        assert light.max() <= 1.0001
        assert light.max() > 0.9
        darkest.append(light.min())
    assert min(darkest) >= 0.0199
    assert min(darkest) < 0.2
    # most pictures have a shadow; one may fall beside it
    assert np.mean(np.array(darkest) < 0.95) > 0.7


def test_shadows_are_thin():
    """What a window of 41 pixels evens out: hardly a large patch is dark as a whole."""
    thin = 0
    for seed in _SEEDS:
        dark = _drawn(seed) < 0.9
        if not dark.any():
            continue
        far = [np.roll(dark, (down, right), (0, 1)) for down in (-20, 20) for right in (-20, 20)]
        thin += bool(np.mean(np.all(far, axis=0) & dark) < 0.5 * dark.mean())
    assert thin > len(_SEEDS) / 2


def test_noise_scales_with_the_light():
    rng = np.random.default_rng(1)
    clean = rng.uniform(0.2, 0.4, (*_SHAPE, 3)).astype(np.float32)
    noisy = clean * rng.exponential(1, clean.shape).astype(np.float32)
    depth = np.full(_SHAPE, 3, np.float32)
    light = _drawn(2)
    seen = in_shadow(Frame(color=noisy, depth=depth), light)
    wanted = reference_in_shadow(clean, light, depth)
    np.testing.assert_allclose(seen.color / wanted, noisy / clean, rtol=1e-5)
    np.testing.assert_allclose(wanted, clean * light[..., None], rtol=1e-6)
    assert seen.depth is depth


def test_the_sky_is_not_shaded():
    depth = np.full(_SHAPE, 3, np.float32)
    depth[:40] = 0
    color = np.ones((*_SHAPE, 3), np.float32)
    shaded = 0
    for seed in _SEEDS:
        light = _drawn(seed)
        for image in (
            in_shadow(Frame(color=color, depth=depth), light).color,
            reference_in_shadow(color, light, depth),
        ):
            assert (image[:40] == 1).all()
        shaded += bool((light[:40] < 0.9).any())
    assert shaded > 3


def test_a_wider_pixel_filter_makes_edges_softer():
    def steepest(spread: float | None) -> float:
        lights = [_drawn(seed, spread) for seed in _SEEDS]
        return float(np.mean([np.abs(np.diff(light, axis=1)).max() for light in lights]))

    assert steepest(1.2) < 0.8 * steepest(None)


def test_the_same_draws_give_the_same_shadow():
    np.testing.assert_array_equal(_drawn(3), _drawn(3))
    assert not np.array_equal(_drawn(3), _drawn(4))

"""Mixed materials: noise of samples, of which the mean of many is what is to be learned."""

from __future__ import annotations

import numpy as np
import pytest

from stillray.frame import Frame
from stillray_training.mixed_materials import Mixture, draw_mixtures, mixed_frame, mixed_reference

SHAPE = (40, 56)


def _albedo():
    return np.random.default_rng(5).uniform(0.2, 0.8, (*SHAPE, 3)).astype(np.float32)


@pytest.mark.parametrize("seed", range(16))
def test_things_are_drawn_in_the_picture(seed):
    mixtures = draw_mixtures(_albedo(), 0.42, np.random.default_rng(seed))
    again = draw_mixtures(_albedo(), 0.42, np.random.default_rng(seed))
    for one, other in zip(mixtures, again, strict=True):
        np.testing.assert_array_equal(one.share, other.share)
        assert one.share.shape == SHAPE
        assert one.share.min() >= 0
        assert one.share.max() <= 1 + 1e-6
        assert one.albedo.shape == (*SHAPE, 3)
        assert one.albedo.min() >= 0


@pytest.mark.parametrize("seed", range(6))
def test_many_samples_become_the_reference(seed):
    """The target is unbiased: the mean of so many draws that no bound of albedos matters."""
    albedo, rng = _albedo(), np.random.default_rng(seed)
    mixtures = draw_mixtures(albedo, None, rng)
    frame = mixed_frame(Frame(color=albedo), mixtures, 1 << 20, rng)
    np.testing.assert_allclose(frame.color, mixed_reference(albedo, mixtures), atol=0.02)


def test_noise_is_that_of_so_many_samples():
    albedo = np.full((64, 64, 3), 0.2, np.float32)
    share, other = np.full((64, 64), 0.25, np.float32), np.full((64, 64, 3), 0.8, np.float32)
    mixture = Mixture(share=share, albedo=other)
    for samples in (1, 4, 16):
        frame = mixed_frame(Frame(color=albedo), [mixture], samples, np.random.default_rng(0))
        expected = 0.6 * np.sqrt(0.25 * 0.75 / samples)
        assert frame.color[..., 0].std() == pytest.approx(expected, rel=0.05)
        np.testing.assert_array_equal(frame.color[..., 0], frame.color[..., 1])


def test_a_thing_of_no_other_material_is_as_it_was():
    albedo = _albedo()
    mixture = Mixture(share=np.zeros(SHAPE, np.float32), albedo=np.ones((*SHAPE, 3), np.float32))
    frame = mixed_frame(Frame(color=albedo), [mixture], 4, np.random.default_rng(0))
    np.testing.assert_array_equal(frame.color, albedo)
    np.testing.assert_array_equal(mixed_reference(albedo, [mixture]), albedo)


def test_what_shines_ends_at_white():
    albedo = _albedo()
    mixture = Mixture(share=np.full(SHAPE, 0.5), albedo=np.full((*SHAPE, 3), 20.0, np.float32))
    frame = mixed_frame(Frame(color=albedo), [mixture], 4, np.random.default_rng(0))
    assert frame.color.max() == 1
    assert (mixed_reference(albedo, [mixture]) == 1).all()

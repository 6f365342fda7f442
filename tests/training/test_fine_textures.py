"""Fine textures: regular, of the contrast that they are drawn with, and no light of their own."""

from __future__ import annotations

import numpy as np
import pytest

from stillray_training.fine_textures import draw_texture

SHAPE = (48, 64)


@pytest.mark.parametrize("seed", range(24))
def test_a_texture_is_a_factor_of_albedos(seed):
    texture = draw_texture(SHAPE, None, np.random.default_rng(seed))
    assert texture.shape == (*SHAPE, 3)
    assert texture.dtype == np.float32
    assert 0 < texture.min() < texture.max() <= 1
    again = draw_texture(SHAPE, None, np.random.default_rng(seed))
    np.testing.assert_array_equal(texture, again)


def test_textures_are_fine_and_differ():
    finest = []
    for seed in range(60):
        texture = draw_texture(SHAPE, None, np.random.default_rng(seed)).mean(-1)
        texture -= texture.mean()
        finest.append(np.abs(np.diff(texture, axis=1)).mean() / max(texture.std(), 1e-6))
    # from weaves of a pixel or two to tiles and letters
    assert min(finest) < 0.3
    assert max(finest) > 1.2


def test_a_wider_pixel_filter_shows_less_of_a_texture():
    sharp, soft = (
        np.mean([draw_texture(SHAPE, s, np.random.default_rng(i)).std() for i in range(20)])
        for s in (None, 0.8)
    )
    assert soft < 0.85 * sharp

"""The past of a picture is let go where its light has changed, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from stillray.arrays.strips import Strips
from stillray.families.feature_reconstruction import Accumulated, Past
from stillray.families.past_agreement import Shown, reject_history
from stillray.families.target_grid import Grid

JITTER = (0.3, -0.4)
SIZES = [(40, 161), (33, 148)]  # a change is noticed over windows of 96 pixels, too


def past_of(light, grid, samples=16.0):
    """A past at the pixels of a picture whose frame had this light, ``(h, w)``."""
    color = np.repeat(grid.take(light, slice(0, grid.full[0]))[..., None], 4, axis=2)
    color = np.ascontiguousarray(color, np.float32)
    color[..., 3] = samples
    rest = np.full((*grid.full, 4), 0.5, np.float32)
    return Past(Accumulated(color, rest.copy(), rest.copy()), rest.copy())


def let_go(past, light, grid, strips=None, broken=None, albedo=None, jitter=JITTER):
    color = np.repeat(np.float32(light)[..., None], 3, axis=2)
    motion = np.zeros((*light.shape, 2), np.float32)
    shown = Shown(color, broken, 0.5, (None, None, albedo), jitter)
    return reject_history(past, shown, grid, motion, None, strips or Strips(1))


def noisy(rng, light, samples):
    return light * rng.gamma(samples, 1 / samples, light.shape)


@pytest.fixture(params=[(scale, size) for scale in (1, 2) for size in SIZES])
def grid(request):
    scale, size = request.param
    return Grid.of(size, scale, 8, np.array(JITTER))


def frame_size(grid):
    return grid.shape[0] // grid.scale, grid.shape[1] // grid.scale


def columns(grid, first, last):
    """Columns of the picture that show those of a frame."""
    return (grid.columns >= first) & (grid.columns < last)


def test_a_shadow_begins_anew_and_the_rest_stays(rng, grid):
    light = np.ones(frame_size(grid))
    past = past_of(light, grid)
    shaded = light.copy()
    shaded[:, 10:26] = 0.6
    let_go(past, noisy(rng, shaded, 64), grid)
    samples = past.accumulated.light[..., 3]
    assert samples[:, columns(grid, 12, 24)].max() == 0
    assert samples[:, columns(grid, 110, 999)].min() > 15.9
    # what has no samples of its own goes with it
    for image in (past.accumulated.albedo, past.accumulated.specular, past.output):
        np.testing.assert_array_equal(image[..., 3] == 0, samples == 0)


def test_noise_alone_takes_nothing(rng, grid):
    light = 0.2 + rng.random(frame_size(grid))
    for samples in (1, 4, 64):
        past = past_of(light, grid)
        before = past.accumulated.light.copy()
        let_go(past, noisy(rng, light, samples), grid)
        np.testing.assert_array_equal(past.accumulated.light, before)


def test_what_was_filled_in_says_nothing(rng, grid):
    light = np.ones(frame_size(grid))
    shaded = light.copy()
    shaded[:, 10:26] = 0.1
    past = past_of(light, grid)
    let_go(past, noisy(rng, shaded, 64), grid, broken=shaded < 0.5)
    assert past.accumulated.light[..., 3].min() == 16


def test_outlines_say_nothing(rng, grid):
    """All samples lie to the right of their pixels' middle, and so see more of what is there."""
    light = np.ones(frame_size(grid))
    lines = np.zeros(light.shape, bool)
    lines[:, 24::16] = True
    seen = light.copy()
    seen[lines] = 3.0
    striped = np.where(lines[..., None], np.float32([0.9, 0.5, 0.5]), np.float32(0.5))
    for given, all_held in ((striped, True), (None, False)):
        past = past_of(light, grid)
        let_go(past, noisy(rng, seen, 64), grid, albedo=given)
        assert (past.accumulated.light[..., 3].min() == 16) == all_held


def test_an_edge_is_looked_up_where_samples_lie():
    """Pixels that an edge halves: a jitter of a quarter of a pixel sees one side of it alone."""
    grid = Grid.of((40, 160), 2, 8, np.array([0.25, 0.0]))
    picture = np.ones((80, 320), np.float32)
    picture[:, 33::16] = 5.0  # every eighth pixel of the frame has 1 on the left, 5 on the right
    shown = np.ones((40, 160))
    shown[:, 16::8] = 5.0
    past = past_of(np.ones((40, 160)), grid)
    past.accumulated.light[..., :3] = picture[..., None]
    let_go(past, shown, grid, jitter=(0.25, 0.0))
    assert past.accumulated.light[..., 3].min() == 16
    let_go(past, shown, grid, jitter=(0.0, 0.0))
    assert past.accumulated.light[..., 3].min() == 0


def test_a_past_of_which_nothing_is_known_stays_unknown(rng, grid):
    light = np.ones(frame_size(grid))
    past = past_of(light, grid)
    past.accumulated.light[:, columns(grid, 20, 999)] = 0
    let_go(past, noisy(rng, 0.3 * light, 64), grid)
    assert past.accumulated.light[..., 3].max() == 0
    assert np.isfinite(past.accumulated.light).all()


def test_several_strips_are_one(rng, grid):
    light = np.ones(frame_size(grid))
    shown = noisy(rng, np.where(np.arange(light.shape[1]) < 20, 0.7, 1.0) * light, 64)
    pasts = [past_of(light, grid) for _ in range(2)]
    for past, strips in zip(pasts, (Strips(1), Strips(2, pixels=150)), strict=True):
        let_go(past, shown, grid, strips)
    whole, parts = (past.accumulated.light for past in pasts)
    assert 0 < (whole[..., 3] < 16).mean() < 1
    np.testing.assert_array_equal(whole, parts)

"""Light that changes where surfaces stay."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import pytest

from stillray_training.shade import moving_shade, switched


@pytest.mark.parametrize("seed", range(8))
def test_a_shade_moves_and_leaves_a_part_of_the_light_and_of_the_picture(seed):
    shades = moving_shade((71, 93), 4, np.random.default_rng(seed))
    assert len(shades) == 4
    for shade in shades:
        assert shade.shape == (71, 93, 1)
        assert shade.dtype == np.float32
        assert 0.099 < shade.min() <= shade.max() < 10.1
        untouched = np.isclose(shade, 1, atol=1e-6).mean()
        assert 0.05 < untouched < 0.98
        # darker inside or brighter, not both
        assert shade.max() < 1 + 1e-6 or shade.min() > 1 - 1e-6
    moved = _moved(shades)
    # once it moves it goes on
    assert moved[-1] > 0
    assert (np.diff(moved > 0) >= 0).all()


def _moved(shades: list[np.ndarray]) -> np.ndarray:
    return np.array([np.abs(np.log(a / b)).max() for a, b in pairwise(shades)])


def test_shades_move_at_once_or_wait_for_one_of_the_last_eight_frames():
    drawn = [moving_shade((40, 40), 30, np.random.default_rng(seed)) for seed in range(40)]
    still = np.array([np.flatnonzero(_moved(shades) > 0)[0] for shades in drawn])
    assert 10 < (still == 0).sum() < 30
    assert set(still[still > 0]) <= set(range(21, 29))
    assert len(set(still)) > 5


def test_speeds_are_of_frames_on_a_larger_picture_too():
    """What a shade of the same draw changes, frame by frame, is that of the smaller picture."""
    one, two = (
        moving_shade((64 * scale,) * 2, 3, np.random.default_rng(5), scale=scale)
        for scale in (1, 2)
    )
    for small, large in zip(one, two, strict=True):
        shrunk = cv2.resize(large[..., 0], (64, 64), interpolation=cv2.INTER_AREA)
        assert np.abs(shrunk - small[..., 0]).mean() < 0.02


def test_shades_differ_in_strength_and_edge():
    drawn = [moving_shade((64, 64), 1, np.random.default_rng(seed))[0] for seed in range(60)]
    stops = np.array([np.log(shade).ravel()[np.abs(np.log(shade)).argmax()] for shade in drawn])
    assert stops.min() < -1.5
    assert stops.max() > 1
    assert np.abs(stops).min() < 0.3
    between = [np.mean((s != s.min()) & (s != s.max())) for s in drawn]
    assert min(between) < 0.02
    assert max(between) > 0.2


@pytest.mark.parametrize("seed", range(8))
def test_a_switch_changes_all_light_once(seed):
    factors = np.stack(switched((5, 7), 6, np.random.default_rng(seed)))
    assert factors.shape == (6, 5, 7, 1)
    assert (factors[0] == 1).all()
    assert len(np.unique(factors.reshape(6, -1), axis=0)) == 2
    assert 0.099 < factors.min() <= factors.max() < 10.1

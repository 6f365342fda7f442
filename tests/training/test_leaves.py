"""Textures of dead leaves: detail of every size, of which a few samples see a part."""

from __future__ import annotations

import numpy as np
import pytest

from stillray_training.leaves import draw_leaves

SHAPE = (48, 64)


@pytest.mark.parametrize("spread", [None, 0.6])
@pytest.mark.parametrize("seed", range(6))
def test_samples_mean_what_is_seen_of_the_texture(seed, spread):
    leaves = draw_leaves(SHAPE, spread, np.random.default_rng(seed))
    mean = leaves.mean
    assert mean.shape == (*SHAPE, 3)
    assert mean.dtype == np.float32
    assert 0 < mean.min() < mean.max() <= 1
    rng = np.random.default_rng(1)
    inside = np.s_[4:-4, 4:-4]  # a soft filter sees what lies beyond the border
    few, many = (leaves.met(samples, rng) for samples in (4, 400))
    assert few.dtype == np.float32
    off_few, off_many = (np.abs(each - mean)[inside].mean() for each in (few, many))
    assert off_many < 0.25 * off_few + 2e-3
    assert np.abs((many - mean)[inside].mean()) < 2e-3


def test_the_same_texture_is_met_otherwise_every_time():
    leaves = draw_leaves(SHAPE, None, np.random.default_rng(3))
    again = draw_leaves(SHAPE, None, np.random.default_rng(3))
    np.testing.assert_array_equal(leaves.fine, again.fine)
    rng = np.random.default_rng(0)
    assert (leaves.met(1, rng) != leaves.met(1, rng)).any()


def test_detail_has_every_size_and_most_of_it_is_no_noise():
    """Slopes of natural pictures: a Haar difference of twice the size is nearly as large."""
    ratios, noise = [], []
    for seed in range(40):
        leaves = draw_leaves((64, 64), None, np.random.default_rng(seed))
        mean = leaves.mean.mean(-1)
        if mean.std() < 1e-3:
            continue
        half = mean.reshape(32, 2, 32, 2).mean((1, 3))
        ratios.append(np.abs(np.diff(half)).mean() / np.abs(np.diff(mean)).mean())
        met = leaves.met(4, np.random.default_rng(seed)).mean(-1)
        noise.append((met - mean).std() / mean.std())
    # of noise of pixels half as large, of a slope twice
    assert 0.7 < np.median(ratios) < 1.8
    assert np.median(noise) < 0.5
    assert max(noise) > 0.15

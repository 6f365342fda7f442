"""Pages of print, of whose letters a few samples meet a part."""

from __future__ import annotations

import numpy as np
import pytest

from stillray_training.pages import draw_page

SHAPE = (48, 64)


def pages(count):
    """Those that lie in the picture, at least in part."""
    found = (draw_page(SHAPE, None, np.random.default_rng(seed)) for seed in range(count))
    return [page for page in found if page.mean.min() < 0.98]


@pytest.mark.parametrize("spread", [None, 0.6])
def test_samples_mean_what_is_seen_of_the_page(spread):
    seen = 0
    for seed in range(8):
        page = draw_page(SHAPE, spread, np.random.default_rng(seed))
        mean = page.mean
        assert mean.shape == (*SHAPE, 3)
        assert 0 < mean.min() <= mean.max() <= 1
        rng = np.random.default_rng(1)
        inside = np.s_[4:-4, 4:-4]  # a soft filter sees what lies beyond the border
        few, many = (page.met(samples, rng) for samples in (4, 400))
        off_few, off_many = (np.abs(each - mean)[inside].mean() for each in (few, many))
        assert off_many < 0.25 * off_few + 2e-3
        seen += off_few > 1e-3
    assert seen >= 4


def test_pages_lie_in_most_pictures_and_fill_few():
    covered = [
        np.mean(draw_page(SHAPE, None, np.random.default_rng(seed)).mean.min(-1) < 0.999)
        for seed in range(40)
    ]
    assert np.mean(np.array(covered) > 0) > 0.7
    assert 0.2 < np.mean(covered) < 0.95


def test_letters_are_not_like_their_neighbours():
    """Along a line ink and paper alternate: stripes would have the same all along one axis."""
    least = []
    for page in pages(40):
        ink = page.mean.mean(-1)
        along, across = (np.abs(np.diff(ink, axis=axis)).mean() for axis in (0, 1))
        least.append(min(along, across) / max(along, across))
    assert np.median(least) > 0.4


def test_few_samples_meet_a_part_of_a_letter():
    noise = [
        (page.met(4, np.random.default_rng(0)) - page.mean).std() / page.mean.std()
        for page in pages(20)
    ]
    assert 0.1 < np.median(noise) < 0.7

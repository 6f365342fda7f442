"""Samples thinned out: noisier frames with the same mean, and what shines in view stays."""

from __future__ import annotations

import numpy as np
import pytest

from stillray.frame import Frame
from stillray_training.thinned import draw_kept, thinned

SHAPE = (60, 80)


@pytest.mark.parametrize(("samples", "share"), [(1, 0.1), (1, 0.6), (16, 0.05)])
def test_the_mean_stays_and_the_noise_is_that_of_roulette(samples, share):
    rng = np.random.default_rng(3)
    frame = Frame(color=np.full((*SHAPE, 3), 0.5, np.float32))
    kept = np.full(SHAPE, share, np.float32)
    color = np.stack([thinned(frame, kept, samples, rng).color for _ in range(40)])
    assert color.mean() == pytest.approx(0.5, rel=0.02)
    wanted = 0.5 * np.sqrt((1 - share) / (samples * share))
    assert color.std() == pytest.approx(wanted, rel=0.03)
    # a sample stays in all channels or in none
    np.testing.assert_array_equal(color[..., 0], color[..., 2])


def test_what_shines_in_view_stays_as_it_is():
    reference = np.full((*SHAPE, 3), 0.2, np.float32)
    reference[10:20, 30:50] = 30
    for seed in range(20):
        rng = np.random.default_rng(seed)
        kept = draw_kept(reference, rng)
        assert kept.min() > 0
        frame = thinned(Frame(color=reference), kept, 2, rng)
        np.testing.assert_array_equal(frame.color[10:20, 30:50], reference[10:20, 30:50])
        assert np.any(frame.color[30:] != reference[30:])

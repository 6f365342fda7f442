"""Rare bright samples: as often and as bright as is said, with their mean in the reference."""

from __future__ import annotations

import numpy as np
import pytest

from stillray.frame import Frame
from stillray_training.heavy_tail import Tail, draw_tail, frame_with, reference_with

SHAPE = (60, 80)


def tail(often: float, most: float) -> Tail:
    light = np.broadcast_to(np.float32([0.6, 0.3, 0.15]), (*SHAPE, 3))
    return Tail(np.full(SHAPE, often, np.float32), light, most)


def painted(samples: float, given: Tail, seed: int = 1) -> np.ndarray:
    frame = Frame(color=np.zeros((*SHAPE, 3), np.float32))
    return frame_with(frame, given, samples, np.random.default_rng(seed)).color


@pytest.mark.parametrize("samples", [1, 4, 32])
def test_the_reference_has_the_mean_of_what_frames_are_given(samples):
    given = tail(0.05, 30)  # so short a tail that means settle
    frames = np.mean([painted(samples, given, seed) for seed in range(200)], axis=0)
    # pixels are alike here, so that their mean says more than each
    wanted = reference_with(np.zeros((*SHAPE, 3), np.float32), given)
    np.testing.assert_allclose(frames.mean(axis=(0, 1)), wanted.mean(axis=(0, 1)), rtol=0.03)


@pytest.mark.parametrize("times", [5, 50, 500])
def test_ten_times_as_bright_is_ten_times_as_rare(times):
    given = tail(0.3, 1e5)
    frames = np.stack([painted(1, given, seed)[..., 0] for seed in range(40)])
    share = np.mean(frames > times * 0.6)
    assert share == pytest.approx(0.3 / times, rel=0.25)
    assert frames.max() <= 2e5 * 0.6  # two in one pixel at most, as good as never


def test_samples_of_a_pixel_share_its_light():
    one, many = painted(1, tail(0.05, 1e4)), painted(64, tail(0.05, 1e4))
    assert np.mean(many > 0) > 10 * np.mean(one > 0)
    # the dimmest of 64 samples is a 64th as bright
    assert many[many > 0].min() == pytest.approx(3 * 0.15 / 64, rel=0.3)
    assert one[one > 0].min() >= 3 * 0.15 * 0.999


def test_tails_take_the_picture_s_colors_and_keep_within_it():
    reference = np.full((*SHAPE, 3), 0.4, np.float32)
    reference[:, 40:] = [0.8, 0.4, 0.2]
    for seed in range(20):
        drawn = draw_tail(reference, np.random.default_rng(seed))
        lit = reference_with(reference, drawn)
        assert np.all(lit >= reference)
        assert 0 < drawn.often.min() <= drawn.often.max() <= 0.2
        added = (lit - reference)[:, 45][drawn.often[:, 45] > 1e-3]  # below, rounding shows
        np.testing.assert_allclose(added[:, 0], 4 * added[:, 2], rtol=0.02)

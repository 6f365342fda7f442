"""Soft patterns over light: positive, of mean 1, of the sizes that are told, faint and strong."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from stillray.model_spec import load
from stillray_training.rendered import read_rendered
from stillray_training.ripples import draw_ripples
from tests.training.one_frame import write_one_frame

SHAPE = (96, 128)


def drawn(number, shape=SHAPE):
    return [draw_ripples(shape, np.random.default_rng(seed)) for seed in range(number)]


@pytest.mark.parametrize("shape", [SHAPE, (32, 33), (129, 40)])
def test_light_stays_positive_and_as_much(shape):
    for pattern in drawn(12, shape):
        assert pattern.shape == (*shape, 3)
        assert pattern.dtype == np.float32
        assert 0 < pattern.min() <= pattern.max() < 20
    # each half is as bright as the whole but for chance
    assert np.mean([p.mean() for p in drawn(60)]) == pytest.approx(1, abs=0.02)


def test_the_same_seed_draws_the_same():
    np.testing.assert_array_equal(drawn(3)[2], drawn(3)[2])


def test_contrasts_reach_from_faint_to_strong_and_some_leave_a_part_as_it_was():
    contrasts = [pattern.std() for pattern in drawn(80)]
    assert np.quantile(contrasts, 0.1) < 0.1
    assert np.quantile(contrasts, 0.9) > 0.4
    untouched = [np.mean(pattern == 1) for pattern in drawn(80)]
    assert 0.2 < np.mean([share > 0.1 for share in untouched]) < 0.5


def test_patterns_are_soft_and_have_many_sizes():
    """Of neighbours' differences little is left in the large ones, much in the small."""
    ratios = []
    for pattern in drawn(60):
        grey = pattern.mean(-1)
        ratios.append(np.abs(np.diff(grey)).mean() / max(grey.std(), 1e-6))
    assert np.quantile(ratios, 0.1) < 0.25
    assert np.quantile(ratios, 0.9) > 0.6
    assert max(ratios) < 1.2  # white noise has 1.1


def test_frames_and_reference_have_the_same_pattern(tmp_path):
    write_one_frame(tmp_path, SHAPE)
    recipe = load("wskp-3s").training
    plain = read_rendered(tmp_path, recipe)
    rippled = read_rendered(tmp_path, dataclasses.replace(recipe, ripple_share=1.0))
    lit = plain.reference.min(-1) > 0.01
    pattern = rippled.reference[lit] / plain.reference[lit]
    assert pattern.std() > 0.01
    noisy = plain.frames[-1].color[lit] * pattern
    np.testing.assert_allclose(rippled.frames[-1].color[lit], noisy, rtol=1e-3, atol=1e-4)
    np.testing.assert_array_equal(rippled.frames[-1].albedo, plain.frames[-1].albedo)

from __future__ import annotations

import numpy as np
import pytest

from stillray.frame import Frame
from stillray.stages.repair import (
    MAX_MOTION,
    MAX_RADIANCE,
    Buffers,
    repair_feature,
    repair_motion,
    repair_radiance,
)


def test_clean_radiance_is_passed_on_without_a_copy(rng):
    color = rng.random((5, 7, 3)).astype(np.float32)
    repaired, broken = repair_radiance(color)
    assert repaired is color
    assert broken is None


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_broken_pixels_are_filled_from_finite_neighbours(bad):
    color = np.full((9, 9, 3), 2.0, np.float32)
    color[4, 4, 1] = bad
    repaired, broken = repair_radiance(color)
    np.testing.assert_allclose(repaired, 2.0, rtol=1e-6)
    assert broken[4, 4]
    assert broken.sum() == 1
    assert not np.isfinite(color[4, 4, 1])  # the caller's array is untouched


def test_pixels_without_samples_are_filled_whatever_they_show(rng):
    color = np.full((9, 9, 3), 2.0, np.float32)
    color[4, 4] = 7
    samples = np.ones((9, 9))
    samples[4, 4] = 0
    buffers = Buffers.of(Frame(color=color, samples=samples))
    assert buffers.in_range(slice(0, 4))
    assert not buffers.in_range(slice(0, 9))
    repaired = buffers.repaired()
    np.testing.assert_allclose(repaired.color, 2.0, rtol=1e-6)
    np.testing.assert_array_equal(repaired.broken, samples == 0)


def test_a_large_hole_is_filled_to_its_middle():
    color = np.ones((64, 80, 3), np.float32)
    color[5:60, 6:70] = np.nan
    repaired, _ = repair_radiance(color)
    np.testing.assert_allclose(repaired, 1, rtol=1e-5)


def test_a_frame_with_nothing_finite_becomes_black():
    repaired, broken = repair_radiance(np.full((3, 4, 3), np.nan, np.float32))
    assert (repaired == 0).all()
    assert broken.all()


def test_negatives_become_zero_and_still_count():
    repaired, broken = repair_radiance(np.float32([[[-1, 0.5, 2]]]))
    np.testing.assert_array_equal(repaired, [[[0, 0.5, 2]]])
    assert broken is None


def test_huge_radiance_is_clamped():
    repaired, _ = repair_radiance(np.full((1, 1, 3), 3e38, np.float32))
    assert (repaired == np.float32(MAX_RADIANCE)).all()


def test_features_are_clipped_and_broken_ones_say_nothing_was_hit():
    feature = np.float32([[-3, 0.5, np.nan], [np.inf, 7, 1]])
    np.testing.assert_array_equal(repair_feature(feature, 0, 1), [[0, 0.5, 0], [0, 1, 1]])


def test_motion_from_nowhere_comes_from_far_outside():
    motion = np.float32([[[np.nan, 1], [-np.inf, np.inf], [3, -1e9]]])
    far = np.float32(MAX_MOTION)
    np.testing.assert_array_equal(repair_motion(motion), [[[far, 1], [far, far], [3, far]]])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("color", -1), ("color", np.nan), ("color", 2e30), ("albedo", 1.5), ("albedo", np.nan),
        ("normal", -1.01), ("depth", np.inf), ("depth", -1), ("motion", np.nan), ("motion", 2e6),
    ],
)  # fmt: skip
def test_one_value_out_of_range_calls_for_repair(name, value):
    arrays = {"color": np.ones((6, 5, 3)), "albedo": np.ones((6, 5, 3)), "depth": np.ones((6, 5))}
    arrays |= {"normal": np.zeros((6, 5, 3)), "motion": np.zeros((6, 5, 2))}
    arrays[name][4, 1] = value
    buffers = Buffers.of(Frame(**arrays))
    assert buffers.in_range(slice(0, 4))
    assert not buffers.in_range(slice(3, 6))
    assert buffers.repaired().in_range(slice(0, 6))

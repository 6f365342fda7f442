"""Outlines by features: of depth, normals and albedo, and not of patterns."""

from __future__ import annotations

import numpy as np
import pytest

from stillray.arrays.strips import Strips
from stillray.families.outlines import outlines

SIZE = (41, 57)


def surfaces():
    """Depth, normal and albedo of a wall."""
    normal = np.broadcast_to(np.float32([0, 0, 1]), (*SIZE, 3)).copy()
    return np.full(SIZE, 4.0, np.float32), normal, np.full((*SIZE, 3), 0.5, np.float32)


def by_loops(depth, normal, albedo):
    found = np.zeros(SIZE, bool)
    for y in range(SIZE[0]):
        for x in range(SIZE[1]):
            near = np.s_[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
            far = np.where(depth[near] > 0, depth[near], 1e9)
            apart = far.max() > 1.1 * far.min()
            for image, limit in ((normal, 0.4), (albedo, 0.2)):
                spread = image[near].max((0, 1)) - image[near].min((0, 1))
                apart |= bool((spread > limit).any())
            found[y, x] = apart
    return found


@pytest.mark.parametrize("strips", [Strips(1), Strips(2, pixels=150)])
def test_each_feature_tells_and_strips_do_not_show(strips):
    depth, normal, albedo = surfaces()
    depth[8:, 10] = 5.0
    depth[30:34, 40:44] = 0  # nothing was hit
    normal[20, 20:30] = [0, 0.6, 0.8]
    albedo[36, 5:9, 1] = 0.9
    found = outlines(depth, normal, albedo, strips)
    np.testing.assert_array_equal(found, by_loops(depth, normal, albedo))
    assert 0.05 < found.mean() < 0.4


def test_a_slope_and_a_faint_stain_are_no_outlines():
    depth, normal, albedo = surfaces()
    depth *= np.linspace(1, 2, SIZE[1], dtype=np.float32)
    albedo[20:24, 20:24] += 0.15
    assert not outlines(depth, normal, albedo, Strips(1)).any()


def test_a_pattern_is_no_outline():
    depth, normal, albedo = surfaces()
    albedo[:, ::2] = 0.1
    assert not outlines(depth, normal, albedo, Strips(1)).any()


def test_without_features_there_is_none():
    assert outlines(None, None, None, Strips(1)) is None
    depth, *_ = surfaces()
    assert not outlines(depth, None, None, Strips(1)).any()

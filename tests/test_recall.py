from __future__ import annotations

import numpy as np
import pytest

from stillray import recall
from stillray.strips import Strips


def ramp(height, width):
    """An output whose value tells where it lies; bilinear interpolation of it is exact."""
    row, column = np.mgrid[0:height, 0:width].astype(np.float32)
    return recall.remember(np.dstack([column, row, np.ones_like(row)]))


def test_what_is_remembered_is_a_copy_that_is_valid_everywhere(rng):
    image = rng.random((5, 7, 3)).astype(np.float32)
    output = recall.remember(image)
    expected = image.copy()
    image[...] = -1
    np.testing.assert_array_equal(output[..., :3], expected)
    np.testing.assert_array_equal(output[..., 3], 1)


@pytest.mark.parametrize("threads", [1, 3])
def test_motion_is_followed_to_a_fraction_of_a_pixel(threads):
    height, width = 97, 64
    motion = np.full((height, width, 2), (1.37, -2.81), np.float32)
    past = recall.recall(ramp(height, width), motion, Strips(threads))
    row, column = np.mgrid[3 : height - 3, 3 : width - 3]
    inner = past[3:-3, 3:-3]
    np.testing.assert_allclose(inner[..., 0], column + 1.37, atol=1e-4)
    np.testing.assert_allclose(inner[..., 1], row - 2.81, atol=1e-4)
    np.testing.assert_allclose(inner[..., 3], 1, atol=1e-6)


def test_what_was_outside_is_not_valid():
    motion = np.zeros((6, 8, 2), np.float32)
    motion[:, 0, 0] = -50
    motion[:, 1, 1] = 1e6
    motion[0, 2, 1] = -0.25  # a quarter outside: the mean of the taps that there are
    past = recall.recall(ramp(6, 8), motion, Strips(1))
    assert not past[:, :2].any()
    np.testing.assert_allclose(past[0, 2], [2, 0, 1, 0.75], atol=1e-5)


def test_nothing_moves_nothing_changes():
    output = ramp(5, 7)
    past = recall.recall(output, np.zeros((5, 7, 2), np.float32), Strips(1))
    np.testing.assert_array_equal(past, output)

"""Frames carried on beyond their borders, whatever strips they are cut to."""

import numpy as np
import pytest

from stillray.arrays.extend import cut, extended, surround
from stillray.arrays.strips import Strips


@pytest.mark.parametrize("pixels", [1, 40, 10_000])
@pytest.mark.parametrize(("reach", "more"), [(0, (0, 0)), (0, (3, 5)), (4, (9, 4)), (11, (11, 13))])
def test_planes_are_surrounded_by_their_outermost_pixels(rng, pixels, reach, more):
    planes = rng.random((2, 3, 7, 5)).astype(np.float32)
    expected = np.pad(planes, [(0, 0), (0, 0), *((reach, end) for end in more)], mode="edge")
    found = np.full_like(expected, np.nan)
    strips = Strips(2, pixels=pixels)
    strips.run(lambda rows: surround(planes, found, reach, rows), *found.shape[2:])
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("shape", [(8, 6), (8, 9), (11, 6), (11, 9)])
def test_what_was_carried_on_is_cut_off_again(rng, shape):
    image = rng.random((8, 6, 4)).astype(np.float32)
    strips = Strips(1, pixels=12)
    whole = extended(image, np.empty((*shape, 4), np.float32), strips)
    found = cut(whole, (8, 6), strips)
    np.testing.assert_array_equal(found, image)
    assert (found is whole) == (shape == (8, 6))

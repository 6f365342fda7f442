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
    strips.run(lambda rows: surround(planes, found[..., rows, :], reach, rows), *found.shape[2:])
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (2, 3), (9, 6)])
def test_beyond_its_border_an_image_is_its_mirror_image(rng, size):
    image = rng.random((*size, 4)).astype(np.float32)
    expected = np.empty((16, 21, 4), np.float32)
    for y, x in np.ndindex(16, 21):  # there and back, the outermost pixel twice
        y_inside, x_inside = (
            at % size if (at // size) % 2 == 0 else size - 1 - at % size
            for at, size in ((y, size[0]), (x, size[1]))
        )
        expected[y, x] = image[y_inside, x_inside]
    for pixels in (1, 64, 10_000):
        found = extended(image, np.empty_like(expected), Strips(2, pixels=pixels))
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("shape", [(8, 6), (8, 9), (11, 6), (11, 9)])
def test_what_was_carried_on_is_cut_off_again(rng, shape):
    image = rng.random((8, 6, 4)).astype(np.float32)
    strips = Strips(1, pixels=12)
    whole = extended(image, np.empty((*shape, 4), np.float32), strips)
    found = cut(whole, (8, 6), strips)
    np.testing.assert_array_equal(found, image)
    assert (found is whole) == (shape == (8, 6))

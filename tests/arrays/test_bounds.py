"""Bounds by one number: NumPy's own, bit by bit."""

import numpy as np
import pytest

from stillray.arrays.bounds import at_least, at_most

ODD = [0.0, -0.0, 1e-40, -1e-40, 3.4e38, -3.4e38, np.inf, -np.inf, np.nan, 0.5, -60.0, 7.0]


@pytest.mark.parametrize("bound", [0, 0.5, -60.0, 1e30, np.float32(1e-12)])
def test_bounds_are_those_of_maximum_and_minimum(bound):
    values = np.array(ODD * 5, np.float32)  # a few full registers, and a rest
    for ours, numpys in ((at_least, np.maximum), (at_most, np.minimum)):
        expected = numpys(values, np.float32(bound))
        found = ours(values, bound)
        assert found.dtype == np.float32
        assert np.array_equal(found, expected, equal_nan=True)


def test_a_part_of_an_array_is_bounded_in_place():
    planes = np.arange(24, dtype=np.float32).reshape(2, 3, 4)
    expected = planes.copy()
    expected[..., 3] = np.minimum(expected[..., 3], 9)
    part = planes[..., 3]
    assert at_most(part, 9, out=part) is part
    assert np.array_equal(planes, expected)

"""Products of many small matrices are those of loops, by the graph that export writes."""

import numpy as np
import pytest

pytest.importorskip("onnx")

from stillray.models.products import FILE, products
from stillray_export.products import graph


def test_the_file_is_the_commands():
    assert FILE.read_bytes() == graph()


@pytest.mark.parametrize("shape", [(1, 1, 1, 1), (183, 10, 13, 289), (5, 7, 3, 17)])
def test_they_are_those_of_loops(rng, shape):
    count, rows, columns, summed = shape
    first = rng.normal(size=(count, rows, summed)).astype(np.float32)
    second = rng.normal(size=(count, columns, summed)).astype(np.float32)
    wanted = [a.astype(float) @ b.astype(float).T for a, b in zip(first, second, strict=True)]
    np.testing.assert_allclose(products(first, second), wanted, rtol=1e-4, atol=1e-4)

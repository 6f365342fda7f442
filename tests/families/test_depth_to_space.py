from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stillray.arrays.strips import Strips
from stillray.families.depth_to_space import DepthToSpace
from stillray.families.fused_kernels import FusedKernelsModel
from stillray.model_spec import load
from stillray.stages.state import Filterable
from tests import oracles


def by_blocks(maps):
    """Four planes for one, in a loop."""
    planes, height, width = maps.shape
    blocks = np.zeros((4 * planes, -(-height // 2), -(-width // 2)), maps.dtype)
    for plane, y, x in np.ndindex(*maps.shape):
        blocks[4 * plane + 2 * (y % 2) + x % 2, y // 2, x // 2] = maps[plane, y, x]
    return blocks


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_windows_of_blocks_are_those_of_the_maps(data):
    height, width = (data.draw(st.integers(1, 12)) for _ in range(2))
    maps = np.random.default_rng(0).random((3, height, width), np.float32)
    blocks = DepthToSpace(by_blocks(maps), Strips(1))
    assert blocks.shape[1] - height in (0, 1)
    rows = _some(data, height)
    near = blocks.near(rows, width)
    assert (len(near), near.shape) == (3, (3, rows.stop - rows.start, width))
    inner = _some(data, rows.stop - rows.start)
    planes = _some(data, 3)
    np.testing.assert_array_equal(near[planes, inner], maps[planes, rows][:, inner])
    plane = data.draw(st.integers(0, 2))
    np.testing.assert_array_equal(near[plane, inner], maps[plane, rows][inner])


def _some(data, count):
    start = data.draw(st.integers(0, count - 1))
    return slice(start, data.draw(st.integers(start + 1, count)))


@pytest.mark.parametrize("size", [(1, 1), (3, 5), (70, 33)])
@pytest.mark.parametrize("fill", [None, np.nan])
def test_kernels_from_blocks_equal_the_loop_oracle(size, fill):
    spec = load("wskp-3s")
    rng = np.random.default_rng(1)
    logits = rng.normal(size=(12, *size)).astype(np.float32)
    if fill is not None:
        logits[:, size[0] // 2, size[1] // 2] = fill
    mean = np.dstack([rng.lognormal(0, 2, (*size, 3)), rng.uniform(0.1, 16, size)])
    mean = mean.astype(np.float32)
    got = FusedKernelsModel(spec).reconstruct(
        Filterable(mean=mean), [by_blocks(logits)], Strips(3), {}
    )
    expected = oracles.fused_kernels(
        mean[..., :3], mean[..., 3], np.nan_to_num(logits), spec.decoder
    )
    np.testing.assert_allclose(got, expected, rtol=2e-5)

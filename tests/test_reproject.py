from __future__ import annotations

import numpy as np
import pytest

from stillray.reproject import Guides, reproject
from tests import oracles
from tests.conftest import ODD_SIZES


def _scene(size, seed):
    rng = np.random.default_rng(seed)
    history = rng.random((*size, 4)).astype(np.float32) * 8
    history[rng.random(size) < 0.1] = 0  # pixels without samples
    faces = np.array([[0, 0, 1], [1, 0, 0], [0, 0, 0]], np.float32)  # two walls, background
    kind_before, kind = rng.integers(0, 3, size), rng.integers(0, 3, size)
    depths = np.array([2.0, 5.0, 0.0], np.float32)
    motion = rng.normal(size=(*size, 2)).astype(np.float32) * 2
    return history, faces[kind_before], depths[kind_before], faces[kind], depths[kind], motion


@pytest.mark.parametrize("size", ODD_SIZES)
def test_taps_are_accepted_one_by_one_like_the_loop_oracle(size, spec):
    history, normal_before, depth_before, normal, depth, motion = _scene(size, 3)
    got = reproject(
        history,
        Guides(normal=normal_before, depth=depth_before),
        Guides(normal=normal, depth=depth),
        motion,
        slice(0, size[0]),
        spec.temporal,
    )
    expected = oracles.reproject(
        history, normal_before, depth_before, normal, depth, motion, spec.temporal
    )
    # positions are float32: a tap share is off by 1e-5 at column 100, values go up to 8
    np.testing.assert_allclose(got, expected, rtol=1e-4, atol=1e-4)


def test_a_whole_pixel_move_returns_the_history_shifted(spec, rng):
    history = rng.random((12, 9, 4)).astype(np.float32) + 0.1
    motion = np.broadcast_to(np.float32([2, -3]), (12, 9, 2)).copy()
    guides = Guides(normal=None, depth=None)
    got = reproject(history, guides, guides, motion, slice(0, 12), spec.temporal)
    # previous = current + motion: row 3, column 0 was at row 0, column 2
    np.testing.assert_allclose(got[3:, :7], history[:9, 2:], rtol=1e-6)
    assert (got[:3] == 0).all()
    assert (got[:, 7:] == 0).all()


def test_rows_of_a_strip_equal_those_of_the_whole(spec):
    history, normal_before, depth_before, normal, depth, motion = _scene((33, 18), 5)
    before = Guides(normal=normal_before, depth=depth_before)
    now = Guides(normal=normal, depth=depth)
    whole = reproject(history, before, now, motion, slice(0, 33), spec.temporal)
    rows = slice(11, 26)
    strip = reproject(history, before, now.rows(rows), motion[rows], rows, spec.temporal)
    np.testing.assert_array_equal(strip, whole[rows])


def test_no_motion_checks_the_surface_all_the_same(spec):
    history = np.ones((2, 2, 4), np.float32)
    before = Guides(normal=None, depth=np.float32([[1, 1], [1, 1]]))
    now = Guides(normal=None, depth=np.float32([[1, 9], [1.05, 0]]))
    got = reproject(history, before, now, None, slice(0, 2), spec.temporal)
    np.testing.assert_array_equal(got[..., 3], [[1, 0], [1, 0]])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e6, -1e6])
def test_motion_out_of_the_frame_brings_no_history(value, spec):
    history = np.ones((5, 6, 4), np.float32)
    motion = np.full((5, 6, 2), value, np.float32)
    none = Guides(normal=None, depth=None)
    got = reproject(history, none, none, motion, slice(0, 5), spec.temporal)
    assert (got == 0).all()

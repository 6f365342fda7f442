from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from stillray.arrays.strips import Strips, planes_of
from stillray.stages import previous_output
from stillray.stages.repair import MAX_MOTION
from stillray.stages.reproject import (
    Edges,
    PreviousFrame,
    mark_discontinuities,
    pack,
    reproject,
)
from tests import oracles
from tests.conftest import ODD_SIZES


def _scene(size, seed):
    rng = np.random.default_rng(seed)
    history = rng.random((*size, 4)).astype(np.float32) * 8
    faces = np.array([[0, 0, 1], [1, 0, 0], [0, 0, 0]], np.float32)  # two walls, background
    kind_before, kind = rng.integers(0, 3, size), rng.integers(0, 3, size)
    depths = np.array([2.0, 5.0, 0.0], np.float32)
    motion = rng.normal(size=(*size, 2)).astype(np.float32) * 2
    return history, faces[kind_before], depths[kind_before], faces[kind], depths[kind], motion


def _guides(normal, depth):
    return None if normal is None and depth is None else pack(normal, depth)


def _run(history, before, now, motion, rows, spec):
    discontinuous = None
    if before is not None:
        discontinuous = np.full((history.shape[0] + 1, history.shape[1] + 1), 7, np.uint8)
        for top in range(0, history.shape[0], 5):
            mark_discontinuities(before, slice(top, min(top + 5, history.shape[0])), discontinuous)
    now = None if now is None else planes_of(now)
    previous = PreviousFrame(history, before, discontinuous)
    return reproject(previous, now, _positions(motion, rows), rows, spec.temporal).copy()


def _positions(motion, rows):
    if motion is None:
        return None
    row, column = np.mgrid[rows, 0 : motion.shape[1]]
    return motion + np.stack([column, row], axis=-1).astype(np.float32)


def _blurring(spec, most):
    return dataclasses.replace(spec, temporal=dataclasses.replace(spec.temporal, most_blur=most))


@pytest.mark.parametrize("size", [*ODD_SIZES, (40, 2)])
@pytest.mark.parametrize("patch", [1, 7])
@pytest.mark.parametrize("most_blur", [0.0, 1.5])
def test_taps_are_accepted_one_by_one_like_the_loop_oracle(size, patch, most_blur, spec):
    spec = _blurring(spec, most_blur)
    # patches of one surface: their inner pixels take the quick way, their edges the other
    history, *guides, motion = _scene(size, 3)
    cells = tuple(np.arange(extent) // patch for extent in size)
    normal_before, depth_before, normal, depth = (part[np.ix_(*cells)] for part in guides)
    before, now = _guides(normal_before, depth_before), _guides(normal, depth)
    got = _run(history, before, now, motion, slice(0, size[0]), spec)
    expected = oracles.reproject(
        history, normal_before, depth_before, normal, depth, motion, spec.temporal
    )
    # positions are float32: a tap share is off by 1e-5 at column 100, values go up to 8
    np.testing.assert_allclose(got, expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("size", [(7, 9), (1, 5), (40, 2)])
@pytest.mark.parametrize("off", [-1.5, -1.0, -0.25, 0.0, 0.25, 0.75, 1.0, 1.5])
def test_borders_are_where_the_frame_ends_also_without_geometry(size, off, spec, rng):
    history = rng.random((*size, 4)).astype(np.float32) * 8
    alike = np.zeros((*size, 3), np.float32), np.ones(size, np.float32)
    for axis in (0, 1):
        motion = np.zeros((*size, 2), np.float32)
        motion[..., axis] = off
        got = _run(history, None, None, motion, slice(0, size[0]), spec)
        expected = oracles.reproject(history, *alike, *alike, motion, spec.temporal)
        np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-5)


def test_a_past_looked_at_between_pixels_counts_as_less(spec):
    """Half a pixel across blurs by a quarter of a square pixel, whole ones not at all."""
    history = np.full((5, 9, 4), 16, np.float32)
    held = []
    for off in (0.5, 1.0, 0.01):
        motion = np.zeros((5, 9, 2), np.float32)
        motion[..., 0] = off
        got = _run(history, None, None, motion, slice(0, 5), _blurring(spec, 1.5))
        np.testing.assert_allclose(got[:, :7, :3], 16, rtol=1e-6)
        held.append(got[2, 3, 3])
    np.testing.assert_allclose(held, [6, 16, 16], rtol=1e-5)


def test_a_slanted_surface_keeps_its_history(spec):
    # depth falls by 3 % a pixel: neighbours are one surface
    depth = np.broadcast_to(5 * 0.97 ** np.arange(24, dtype=np.float32), (9, 24)).copy()
    guides = _guides(None, depth)
    history = np.ones((9, 24, 4), np.float32)
    motion = np.full((9, 24, 2), 0.5, np.float32)
    got = _run(history, guides, guides, motion, slice(0, 9), spec)
    np.testing.assert_allclose(got[:-1, :-1], 1, rtol=1e-5)


def test_a_whole_pixel_move_returns_the_history_shifted(spec, rng):
    history = rng.random((12, 9, 4)).astype(np.float32) + 0.1
    motion = np.broadcast_to(np.float32([2, -3]), (12, 9, 2)).copy()
    guides = _guides(None, None)
    got = _run(history, guides, guides, motion, slice(0, 12), spec)
    # previous = current + motion: row 3, column 0 was at row 0, column 2
    np.testing.assert_allclose(got[3:, :7], history[:9, 2:], rtol=1e-6)
    assert (got[:3] == 0).all()
    assert (got[:, 7:] == 0).all()


def test_rows_of_a_strip_equal_those_of_the_whole(spec):
    history, normal_before, depth_before, normal, depth, motion = _scene((33, 18), 5)
    before, now = _guides(normal_before, depth_before), _guides(normal, depth)
    whole = _run(history, before, now, motion, slice(0, 33), spec)
    rows = slice(11, 26)
    strip = _run(history, before, now[rows], motion[rows], rows, spec)
    np.testing.assert_array_equal(strip, whole[rows])


def test_no_motion_checks_the_surface_all_the_same(spec):
    history = np.ones((2, 2, 4), np.float32)
    before = _guides(None, np.float32([[1, 1], [1, 1]]))
    now = _guides(None, np.float32([[1, 9], [1.05, 0]]))
    got = _run(history, before, now, None, slice(0, 2), spec)
    np.testing.assert_array_equal(got[..., 3], [[1, 0], [1, 0]])


@pytest.mark.parametrize("value", [MAX_MOTION, -MAX_MOTION, 6.0, -6.0])
def test_motion_out_of_the_frame_brings_no_history(value, spec):
    history = np.ones((5, 6, 4), np.float32)
    motion = np.full((5, 6, 2), value, np.float32)
    none = _guides(None, None)
    got = _run(history, none, none, motion, slice(0, 5), spec)
    assert (got == 0).all()


def test_rough_blocks_are_those_with_more_than_one_surface():
    normal = np.zeros((7, 9, 3), np.float32)
    normal[..., 2] = 1
    normal[3, 4] = [1, 0, 0]
    depth = np.full((7, 9), 2, np.float32)
    depth[5, 1] = 3
    discontinuous = np.full((8, 10), 7, np.uint8)
    mark_discontinuities(pack(normal, depth), slice(0, 7), discontinuous)
    expected = np.zeros((8, 10), np.uint8)
    expected[[0, -1]] = expected[:, [0, -1]] = 1  # blocks that stick out
    expected[3:5, 4:6] = 1  # the four blocks that hold row 3, column 4
    expected[5:7, 1:3] = 1
    np.testing.assert_array_equal(discontinuous, expected)


@pytest.mark.parametrize("length", [0.3, 0.5, 0.9, 1.2, 1.7])
def test_the_length_of_a_normal_says_nothing_of_its_surface(length):
    unit = np.zeros((3, 4, 3), np.float32)
    unit[...] = (0.6, 0, 0.8)
    scaled = unit * np.float32(length)
    scaled[1, 2] = 0  # background stays what it is
    depth = np.full((3, 4), 2, np.float32)
    packed, expected = pack(scaled, depth), pack(unit, depth)
    expected[1, 2, :3] = (1, 0, 0)
    # below a quarter in every component a normal points nowhere: all alike, told apart by depth
    expected[..., :3] = (1, 0, 0) if length == 0.3 else expected[..., :3]
    np.testing.assert_allclose(packed, expected, rtol=1e-6)


def _output(luminance):
    return np.dstack([luminance] * 3 + [np.ones_like(luminance)]).astype(np.float32)


def _edges(output, contrast=4.0):
    return Edges.of(output, contrast, Strips(1))


def _look(history, motion, spec, edges):
    rows = slice(0, history.shape[0])
    previous = PreviousFrame(history, None, None, edges)
    return reproject(previous, None, _positions(motion, rows), rows, spec.temporal).copy()


def test_light_is_looked_up_as_sharply_as_the_output_where_that_has_an_edge(spec, rng):
    size = 33, 41
    window = np.zeros(size)
    window[:, 12:14] = window[:, 25:] = 1
    output = _output(0.1 + 60 * window)
    history = rng.lognormal(0, 1, (*size, 4)).astype(np.float32) * (0.1 + 60 * window[..., None])
    history = history.astype(np.float32)
    motion = np.zeros((*size, 2), np.float32)
    motion[..., 0] = 0.3
    motion[..., 1] = -0.2
    spec = _blurring(spec, 0.0)
    plain, sharp = (_look(history, motion, spec, edges) for edges in (None, _edges(output)))
    recalled = [
        previous_output.resample(output, _positions(motion, slice(0, 33)), Strips(1), sharp=found)
        for found in (False, True)
    ]
    inner = slice(2, -2), slice(2, -2)
    factor = (recalled[1] / recalled[0])[..., :1][inner]
    np.testing.assert_allclose(sharp[inner][..., :3], plain[inner][..., :3] * factor, rtol=1e-4)
    np.testing.assert_array_equal(sharp[..., 3], plain[..., 3])
    assert factor.min() < 0.95
    assert (factor == 1).mean() > 0.5  # away from edges


@pytest.mark.parametrize("most_blur", [0.0, 4.0])
@pytest.mark.parametrize("size", [*ODD_SIZES, (23, 31)])
def test_a_past_beside_an_edge_is_worth_no_more_than_looks_have_blurred(spec, rng, size, most_blur):
    height, width = size
    light = np.full(size, 0.1)
    light[height // 3 :, width // 2] = 60
    history = rng.lognormal(0, 1, (*size, 4)).astype(np.float32)
    history[..., 3] = 16
    motion = rng.uniform(-2, 2, (*size, 2)).astype(np.float32)
    spec = _blurring(spec, most_blur)
    edges = _edges(_output(light))
    plain = _look(history, motion, spec, edges)
    temporal = dataclasses.replace(spec.temporal, sharp_contrast=4.0, edge_blur=0.5)
    found = _look(history, motion, dataclasses.replace(spec, temporal=temporal), edges)
    expected = plain.copy()
    for y, x in np.ndindex(size):
        at = _positions(motion, slice(0, height))[y, x].astype(float)
        column, row = np.floor(at).astype(int)
        if not (0 <= row < height and 0 <= column < width):
            continue
        # the 2x2 blocks that begin at this one's corner or a pixel beside it
        corners = [
            light[max(top, 0) : top + 2, max(left, 0) : left + 2]
            for top in range(max(row - 1, 0), min(row + 2, height))
            for left in range(max(column - 1, 0), min(column + 2, width))
        ]
        if any(block.max() > 4 * block.min() for block in corners):
            share = at - [column, row]
            blur = max((share * (1 - share)).sum(), 1e-6)
            expected[y, x, 3] = min(expected[y, x, 3], 0.5 / blur)
    np.testing.assert_allclose(found, expected, rtol=1e-4)
    if min(size) > 20:
        assert 0.005 < (found != plain).mean() < 0.2


def test_noise_alone_sharpens_nothing(spec, rng):
    size = 24, 31
    history = rng.lognormal(0, 2, (*size, 4)).astype(np.float32)
    motion = rng.normal(size=(*size, 2)).astype(np.float32)
    even = _output(rng.uniform(1, 3.9, size))
    found = _look(history, motion, spec, _edges(even))
    np.testing.assert_array_equal(found, _look(history, motion, spec, None))


def test_pixels_with_a_tap_of_another_surface_or_outside_are_left_as_they_are(spec, rng):
    size = 20, 26
    history, *guides, _ = _scene(size, 3)
    motion = rng.normal(size=(*size, 2)).astype(np.float32) * 3
    before = _guides(*guides[:2])
    mask = np.zeros((21, 27), np.uint8)
    mark_discontinuities(before, slice(0, 20), mask)
    edges = _edges(_output(rng.lognormal(0, 3, size)))
    now, rows = planes_of(_guides(*guides[2:])), slice(0, 20)
    found = []
    for each in (None, edges):
        previous = PreviousFrame(history, before, mask, each)
        at = _positions(motion, rows)
        found.append(reproject(previous, now, at, rows, spec.temporal).copy())
    corner = np.floor(_positions(motion, rows)).astype(int) + 1
    inside = ((corner >= 0) & (corner <= [26, 20])).all(axis=-1)
    apart = ~inside
    apart[inside] = mask[corner[inside][:, 1], corner[inside][:, 0]] > 0
    np.testing.assert_array_equal(found[1][apart], found[0][apart])
    assert (found[1] != found[0]).any()


@pytest.mark.parametrize("contrast", [0.0, 4.0])
def test_edges_are_asked_for_by_models_with_an_output(contrast):
    assert (_edges(_output(np.ones((3, 4))), contrast) is None) == (contrast == 0)
    assert _edges(None) is None


@pytest.mark.filterwarnings("error")
def test_the_brightest_outputs_and_black_ones_are_no_edges_of_their_own(spec, rng):
    size = 9, 11
    history = rng.random((*size, 4)).astype(np.float32)
    motion = np.full((*size, 2), 0.4, np.float32)
    plain = _look(history, motion, spec, None)
    for level in (0.0, 1e-40, 3e38):
        output = _output(np.full(size, level))
        found = _look(history, motion, spec, _edges(output))
        np.testing.assert_array_equal(found, plain)

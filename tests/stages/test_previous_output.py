from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from stillray.arrays.strips import Strips
from stillray.stages import features as encode
from stillray.stages import previous_output
from stillray.stages.reproject import positions_of
from tests import oracles


def ramp(height, width):
    """An output whose value tells where it lies; bilinear interpolation of it is exact."""
    row, column = np.mgrid[0:height, 0:width].astype(np.float32)
    return previous_output.keep(np.dstack([column, row, np.ones_like(row)]), Strips(1))


def moved(motion):
    """Where each pixel of a frame was."""
    return positions_of(motion, slice(0, motion.shape[0]))


def test_what_is_remembered_is_a_copy_that_is_valid_everywhere(rng):
    image = rng.random((5, 7, 3)).astype(np.float32)
    output = previous_output.keep(image, Strips(1))
    expected = image.copy()
    image[...] = -1
    np.testing.assert_array_equal(output[..., :3], expected)
    np.testing.assert_array_equal(output[..., 3], 1)


@pytest.mark.parametrize("threads", [1, 3])
def test_motion_is_followed_to_a_fraction_of_a_pixel(threads):
    height, width = 97, 64
    motion = np.full((height, width, 2), (1.37, -2.81), np.float32)
    past = previous_output.resample(
        ramp(height, width), moved(motion), Strips(threads, pixels=width)
    )
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
    past = previous_output.resample(ramp(6, 8), moved(motion), Strips(1))
    assert not past[:, :2].any()
    np.testing.assert_allclose(past[0, 2], [2, 0, 1, 0.75], atol=1e-5)


def test_nothing_moves_nothing_changes():
    output = ramp(5, 7)
    past = previous_output.resample(output, moved(np.zeros((5, 7, 2), np.float32)), Strips(1))
    np.testing.assert_array_equal(past, output)
    past = previous_output.resample(output, None, Strips(1))
    np.testing.assert_array_equal(past, output)


def thirty_seconds(rng, shape, far):
    """Motion in steps of 1/32 pixel, which cubic interpolation rounds to."""
    return (rng.integers(-32 * far, 32 * far, (*shape, 2)) / 32).astype(np.float32)


@pytest.mark.parametrize("threads", [1, 3])
def test_sharp_resampling_equals_the_loop_oracle(rng, threads):
    output = previous_output.keep(rng.lognormal(0, 3, (23, 18, 3)).astype(np.float32), Strips(1))
    positions = moved(thirty_seconds(rng, (23, 18), far=5))
    past = previous_output.resample(output, positions, Strips(threads, pixels=40), sharp=True)
    expected, brightest = oracles.sharp_resample(output, positions)
    assert (expected[..., 3] > 0.999).mean() > 0.3
    assert ((expected[..., 3] > 0) & (expected[..., 3] < 1)).any()
    error = np.abs(past - expected).max(-1)
    assert (error <= 2e-6 * np.maximum(brightest, 1)).all()


def test_sharp_resampling_invents_no_light(rng):
    image = rng.lognormal(0, 2, (40, 33, 3)).astype(np.float32)
    image[11, 7] = 1e30
    image[25:, 20:] = 0
    motion = (rng.random((40, 33, 2)) * 9 - 4.5).astype(np.float32)
    past = previous_output.resample(
        previous_output.keep(image, Strips(1)), moved(motion), Strips(1), sharp=True
    )
    assert np.isfinite(past).all()
    assert past.min() >= 0
    column, row = (np.arange(size, dtype=np.float32) for size in (33, 40))
    x, y = column + motion[..., 0], row[:, None] + motion[..., 1]
    inside = (x >= 0) & (x < 32) & (y >= 0) & (y < 39)
    light, shown = encode.luminance(image), encode.luminance(past)
    corners = [
        light[
            np.clip(np.floor(y).astype(int) + a, 0, 39), np.clip(np.floor(x).astype(int) + b, 0, 32)
        ]
        for a in (0, 1)
        for b in (0, 1)
    ]
    assert (shown <= np.max(corners, 0) * np.float32(1 + 1e-5))[inside].all()
    assert (shown >= np.min(corners, 0) * np.float32(1 - 1e-5))[inside].all()
    np.testing.assert_allclose(past[..., 3][inside], 1, rtol=1e-6)


def test_an_edge_that_moves_half_a_pixel_a_frame_stays_sharp():
    widths = {}
    for sharp in (False, True):
        output = previous_output.keep(
            np.where(np.arange(64) < 20, 0.0, 1.0)[None, :, None]
            .repeat(8, 0)
            .repeat(3, 2)
            .astype(np.float32),
            Strips(1),
        )
        motion = np.full((8, 64, 2), (-0.5, 0), np.float32)
        for _ in range(16):
            output = previous_output.resample(output, moved(motion), Strips(1), sharp=sharp).copy()
        line = output[4, 10:, 0]
        widths[sharp] = int(((line > 0.05) & (line < 0.95)).sum())
    assert widths[True] <= widths[False] / 2


def test_layers_are_recalled_as_the_beauty_was(rng):
    beauty = rng.lognormal(0, 2, (31, 22, 3)).astype(np.float32)
    share = rng.random(beauty.shape).astype(np.float32)
    parts = [beauty * share - 1, beauty * (1 - share) + 1]  # one of them has negative values
    motion = (rng.random((31, 22, 2)) * 6 - 3).astype(np.float32)
    whole = previous_output.keep(beauty, Strips(1))
    positions = moved(motion)
    follow = previous_output.layer_resampler(whole, positions, Strips(1), sharp=True)
    added = sum(
        follow(previous_output.keep(part, Strips(1))).astype(np.float64)[..., :3] for part in parts
    )
    expected = previous_output.resample(whole, positions, Strips(1), sharp=True)
    valid = expected[..., 3] > 0.01  # below, light fades
    np.testing.assert_allclose(added[valid], expected[..., :3][valid], rtol=1e-5, atol=2e-5)


def test_a_frame_that_comes_from_outside_altogether_is_recalled_as_nothing():
    # more pixels in a strip than OpenCV takes rows
    motion = np.full((300, 400, 2), 1e6, np.float32)
    past = previous_output.resample(ramp(300, 400), moved(motion), Strips(1), sharp=True)
    assert not past.any()


def test_what_was_just_uncovered_has_no_past_but_thin_lines_keep_theirs(rng):
    output = rng.uniform(1, 2, (20, 24, 4)).astype(np.float32)
    disoccluded = np.zeros((20, 24), np.uint8)
    disoccluded[2:6, 3:8] = 1  # a surface that was behind another
    disoccluded[10:12, 1:20] = 1  # an edge two pixels thick
    disoccluded[16, 20] = 1
    disoccluded[2, 3] = 0  # a corner: no three pixels wide there
    expected = output.copy()
    for row, column in np.ndindex(18, 22):
        window = slice(row, row + 3), slice(column, column + 3)
        if disoccluded[window].all():
            expected[window] = 0
    assert (expected == 0).any()
    disoccluded[8:12, 21:24] = 1  # wide where it meets the border
    expected[8:12, 21:24] = 0
    given = output.copy()
    past = previous_output.forget_uncovered(
        given,
        given,
        SimpleNamespace(disoccluded=disoccluded, history_confidence=None),
        Strips(2, pixels=24 * 3),
    )
    np.testing.assert_array_equal(past, expected)
    np.testing.assert_array_equal(given, output)  # which belongs to the history


@pytest.mark.parametrize("in_place", [False, True])
def test_where_light_is_less_sure_the_past_is_less_valid_until_it_is_none(rng, in_place):
    output = rng.uniform(1, 2, (9, 11, 4)).astype(np.float32)
    confidence = rng.choice(np.float32([0, 0.25, 0.5, 0.6, 0.75, 0.9, 1]), (9, 11))
    expected = output.copy()
    for row, column in np.ndindex(9, 11):
        valid = max(2 * float(confidence[row, column]) - 1, 0)  # 1 at 1, 0 from a half on
        expected[row, column, 3] *= valid
        if valid == 0:
            expected[row, column] = 0
    past = output.copy()
    given = past if not in_place else output
    result = previous_output.forget_uncovered(
        past,
        given,
        SimpleNamespace(disoccluded=None, history_confidence=confidence),
        Strips(2, pixels=11 * 2),
    )
    np.testing.assert_allclose(result, expected, rtol=1e-6)

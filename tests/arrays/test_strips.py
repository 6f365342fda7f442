from __future__ import annotations

import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillray.arrays.strips import (
    LARGE_STRIP_PIXELS,
    STRIP_PIXELS,
    Strips,
    interleave,
    planes_of,
    strips_of,
    with_halo,
)


@given(
    height=st.integers(1, 3000), width=st.integers(1, 5000), pixels=st.integers(1, 1 << 18)
)  # fmt: skip
def test_strips_are_every_row_once_and_no_larger_than_asked(height, width, pixels):
    strips = strips_of(height, width, pixels)
    rows = [row for strip in strips for row in range(strip.start, strip.stop)]
    assert rows == list(range(height))
    assert max(strip.stop - strip.start for strip in strips) <= max(pixels // width, 1)


@pytest.mark.parametrize(("size", "count"), [((720, 1280), 4), ((180, 320), 1), ((2160, 3840), 32)])
def test_large_strips_are_half_as_many(size, count):
    large = strips_of(*size, LARGE_STRIP_PIXELS)
    assert len(large) == count
    assert len(strips_of(*size)) in (count, 2 * count)


@pytest.mark.parametrize("pixels", [STRIP_PIXELS, LARGE_STRIP_PIXELS])
@pytest.mark.parametrize("size", [(720, 1280), (721, 1279), (97, 86), (1, 1), (3, 400000)])
def test_strips_of_whole_blocks_begin_at_even_rows(size, pixels):
    strips, seen = Strips(1), []
    strips.run_even(seen.append, *size, pixels=pixels)
    assert all(rows.start % 2 == 0 for rows in seen)
    assert [row for rows in seen for row in range(rows.start, rows.stop)] == list(range(size[0]))
    rows = max(rows.stop - rows.start for rows in seen)
    assert rows == 2 or rows * size[1] <= pixels or size[0] == 1


@pytest.mark.parametrize("threads", [1, 3])
def test_results_come_in_order_and_errors_come_out(threads):
    strips = Strips(threads)
    tops = strips.run(lambda rows: rows.start, 300, 900)
    assert tops == [strip.start for strip in strips_of(300, 900)]
    assert len(tops) > 1

    def fail(rows):
        if rows.start:
            raise ValueError("here")

    with pytest.raises(ValueError, match="here"):
        strips.run(fail, 300, 900)
    strips.close()


def test_each_thread_has_scratch_of_its_own():
    strips, barrier = Strips(2), threading.Barrier(2, timeout=300)

    def work(rows):
        mine = strips.workspace.array("x", (4,))
        mine.fill(rows.start)
        barrier.wait()  # both threads hold theirs now
        return mine.copy()

    results = strips.run(work, 2, 1, pixels=1)
    np.testing.assert_array_equal(results, [[0] * 4, [1] * 4])
    strips.close()


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("size", [(1, 1), (1, 4), (4, 1), (2, 4), (33, 18)])
def test_planes_are_the_channels_and_come_together_again(size, channels, rng):
    frame = rng.random((size[0] + 2, size[1], channels)).astype(np.float32)
    whole = np.zeros((channels, *frame.shape[:2]), np.float32)
    rows = slice(1, 1 + size[0])
    planes = planes_of(frame[rows], out=whole[:, rows])  # parts of frames, as strips are
    np.testing.assert_array_equal(planes, frame[rows].transpose(2, 0, 1))
    np.testing.assert_array_equal(whole[:, rows], planes)
    assert not whole[:, [0, -1]].any()
    back = np.zeros_like(frame)
    interleave(planes, out=back[rows])
    np.testing.assert_array_equal(back[rows], frame[rows])
    assert not back[[0, -1]].any()


def test_a_halo_ends_at_the_frame_and_knows_its_inner_rows():
    assert with_halo(slice(0, 5), 3, 20) == (slice(0, 8), slice(0, 5))
    assert with_halo(slice(10, 15), 3, 20) == (slice(7, 18), slice(3, 8))
    assert with_halo(slice(18, 20), 3, 20) == (slice(15, 20), slice(3, 5))

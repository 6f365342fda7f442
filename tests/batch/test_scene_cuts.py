"""Cuts are found, and nothing else is taken for one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stillray.batch.scene_cuts import Agreement, CutDetector
from stillray.frame import Frame
from stillray.io.exr.read import read_exr

ROOM = Path(__file__).parents[1] / "data" / "room"
BUFFERS = ("color", "albedo", "normal", "depth")


@pytest.fixture(scope="module")
def room():
    return [read_exr(path) for path in sorted(ROOM.glob("frame_*.exr"))]


@pytest.fixture
def compare(spec):
    def compare(before, now):
        detector = CutDetector(spec)
        assert detector.compare(before) is None  # there is nothing to compare the first with
        return detector.compare(now)

    return compare


def changed(frame, **how):
    """The frame with its buffers turned over, without some of them, or with others."""
    mirrored = {n: np.ascontiguousarray(getattr(frame, n)[:, ::-1]) for n in BUFFERS}
    return replace(frame, **mirrored, **how)


def without_geometry(frame):
    return replace(frame, normal=None, depth=None)


def test_no_cut_within_a_moving_shot(room, spec):
    detector = CutDetector(spec)
    agreements = [detector.compare(frame) for frame in room][1:]
    assert not any(agreement.is_cut for agreement in agreements)
    assert all(agreement.same_surface > 0.9 for agreement in agreements)


def test_cut_to_another_view_is_found_with_and_without_geometry(room, compare):
    agreement = compare(room[3], changed(room[4]))
    assert agreement.is_cut
    assert "%" in str(agreement)
    assert compare(without_geometry(room[3]), without_geometry(changed(room[4]))).is_cut


def test_cut_is_found_once(room, spec):
    detector = CutDetector(spec)
    shots = [*room[:3], *(changed(frame) for frame in room[3:5])]
    # motion is mirrored with the picture
    shots[4] = replace(shots[4], motion=room[4].motion[:, ::-1] * np.float32([-1, 1]))
    cuts = [(a := detector.compare(frame)) is not None and a.is_cut for frame in shots]
    assert cuts == [False, False, False, True, False]


def test_pan_five_times_as_fast_is_no_cut(room, compare):
    height, width = room[0].shape
    row, column = np.mgrid[0:height, 0:width].astype(np.float32)
    at_row, at_column = row.copy(), column.copy()
    for frame in room[5:0:-1]:  # follow each pixel back through five frames
        r = np.clip(np.rint(at_row), 0, height - 1).astype(int)
        c = np.clip(np.rint(at_column), 0, width - 1).astype(int)
        step = frame.motion[r, c]
        at_column += step[..., 0]
        at_row += step[..., 1]
    motion = np.stack([at_column - column, at_row - row], axis=-1)
    assert np.abs(motion).mean() > 8
    assert not compare(room[0], replace(room[5], motion=motion)).is_cut


def test_still_camera_under_new_noise_is_no_cut(room, compare):
    noise = np.random.default_rng(3).exponential(1, room[0].color.shape).astype(np.float32)
    still = replace(room[0], motion=np.zeros_like(room[0].motion))
    assert not compare(still, replace(still, color=still.color * noise)).is_cut


def test_light_that_is_switched_on_is_no_cut(room, compare):
    lit = replace(room[4], color=np.ascontiguousarray(room[4].color[::-1]) * 8)
    agreement = compare(room[3], lit)
    assert agreement.alike < 0.85  # the picture alone would say so
    assert not agreement.is_cut


def test_noisy_normals_are_no_cut(room, compare):
    rng = np.random.default_rng(0)
    noisy = [replace(f, normal=rng.normal(size=f.normal.shape)) for f in room[3:5]]
    agreement = compare(*noisy)
    assert agreement.same_surface < 0.5
    assert not agreement.is_cut


@pytest.mark.parametrize("value", [0.0, 0.5])
def test_flat_pictures_are_no_cut(compare, value):
    flat = Frame(
        color=np.full((97, 129, 3), value),
        motion=np.zeros((97, 129, 2)),
    )
    assert not compare(flat, flat).is_cut
    noise = np.random.default_rng(1).exponential(1, flat.color.shape)
    assert not compare(flat, replace(flat, color=flat.color * noise)).is_cut


def test_nothing_is_compared_without_motion_or_size_or_past(room, spec):
    detector = CutDetector(spec)
    detector.compare(room[0])
    assert detector.compare(replace(room[1], motion=None)) is None
    small = Frame(color=np.ones((5, 3, 3)), motion=np.zeros((5, 3, 2)))
    assert detector.compare(small) is None
    assert not detector.compare(small).is_cut
    detector.reset()
    assert detector.compare(small) is None


def test_what_cannot_be_seen_is_not_compared(room, compare):
    gone = replace(room[4], motion=np.full_like(room[4].motion, np.nan))
    agreement = compare(room[3], gone)
    assert (agreement.same_surface, agreement.alike) == (None, None)
    assert not agreement.is_cut


def test_broken_pixels_are_neither_a_cut_nor_an_error(room, compare):
    rng = np.random.default_rng(2)
    broken = rng.random(room[4].shape) < 0.01
    values = rng.choice([np.nan, np.inf, -np.inf, -1.0], broken.sum())
    buffers = {}
    for name in (*BUFFERS, "motion"):
        buffers[name] = getattr(room[4], name).copy()
        buffers[name][broken] = values if name == "depth" else values[:, None]
    agreement = compare(room[3], replace(room[4], **buffers))
    assert not agreement.is_cut
    assert agreement.same_surface > 0.9


def test_agreement_needs_all_that_can_be_compared_to_disagree():
    unlike = {"alike": 0.2, "apart": 0.2}
    assert Agreement(same_surface=0.1, **unlike).is_cut
    assert Agreement(same_surface=None, **unlike).is_cut
    assert not Agreement(same_surface=0.9, **unlike).is_cut
    assert not Agreement(same_surface=0.1, alike=0.99, apart=0.2).is_cut
    assert not Agreement(same_surface=0.1, alike=0.2, apart=0.01).is_cut
    assert not Agreement(same_surface=0.1, alike=None, apart=0.2).is_cut

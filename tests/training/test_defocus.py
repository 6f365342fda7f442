"""A lens in front of rendered frames: means stay those of discs, and what is sharp stays sharp."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillray.frame import Frame
from stillray_training.defocus import (
    Lens,
    Opening,
    draw_opening,
    frame_through_lens,
    lens_before,
    reference_through_lens,
    sample_through_lens,
)

SHAPE = (40, 50)


def lens_of(own, depth=1.0):
    own = np.broadcast_to(np.float32(own), SHAPE)
    return Lens(own=own, reach=own, depth=np.broadcast_to(np.float32(depth), SHAPE))


def halves():
    """A bright half beside a dark one."""
    reference = np.full((*SHAPE, 3), 0.2, np.float32)
    reference[:, 25:] = 4
    return reference


@pytest.mark.parametrize("samples", [1, 2, 8])
@pytest.mark.parametrize("lit", [1.0, 0.1])
def test_frames_have_the_mean_that_the_reference_says(samples, lit):
    """Of samples that all carry light, and of those of which one in ten does."""
    rng = np.random.default_rng(5)
    reference, lens = halves(), lens_of(6)
    total = np.zeros_like(reference)
    for _ in range(400):
        counts = rng.binomial(samples, lit, SHAPE)[..., None] / (samples * lit)
        frame = Frame(color=(reference * counts).astype(np.float32))
        total += frame_through_lens(frame, reference, lens, samples, rng).color
    wanted = reference_through_lens(reference, lens, rng)
    columns = (total / 400).mean((0, 2))
    np.testing.assert_allclose(columns, wanted.mean((0, 2)), rtol=0.06)
    # half of a disc is the other side's, and none of it further off than it is large
    assert columns[24] == pytest.approx(2.1, rel=0.15)
    np.testing.assert_allclose(wanted[:, :18], 0.2, rtol=1e-5)


def test_a_sample_is_that_of_one_point_with_its_motion():
    rng = np.random.default_rng(4)
    reference = halves()
    plane = (reference[..., 0] > 1).astype(np.float32)
    frame = Frame(color=reference, depth=1 + plane, motion=np.dstack([3 * plane, -plane]))
    total = np.zeros_like(reference)
    for _ in range(300):
        seen = sample_through_lens(frame, lens_of(6), rng)
        assert seen.motion is not None
        np.testing.assert_array_equal(seen.color[..., 0] > 1, seen.motion[..., 0] == 3)
        np.testing.assert_array_equal(seen.color[..., 0] > 1, seen.depth == 2)
        total += seen.color
    wanted = reference_through_lens(reference, lens_of(6), rng)
    np.testing.assert_allclose((total / 300).mean((0, 2)), wanted.mean((0, 2)), rtol=0.05)


def test_noise_stays_as_large_as_it_is_in_even_light():
    rng = np.random.default_rng(6)
    reference = np.full((*SHAPE, 3), 0.5, np.float32)
    frame = Frame(color=reference * rng.gamma(4, 1 / 4, (*SHAPE, 1)).astype(np.float32))
    seen = frame_through_lens(frame, reference, lens_of(5), 4, rng)
    assert seen.color.std() == pytest.approx(frame.color.std(), rel=0.1)


def test_features_are_noise_that_goes_with_samples():
    rng = np.random.default_rng(7)
    reference = halves()
    plane = (reference[..., 0] > 1).astype(np.float32)
    frame = Frame(
        color=reference,
        albedo=np.repeat(plane[..., None], 3, 2),
        normal=np.dstack([plane, 0 * plane, 1 - plane]),
        depth=1 + plane,
    )
    lens = lens_of(8)
    spread = []
    for samples in (1, 16):
        seen = frame_through_lens(frame, reference, lens, samples, rng)
        # a sample has the color, albedo and normal of one point
        lightness = (seen.color[..., 0] - 0.2) / 3.8
        np.testing.assert_allclose(seen.albedo[..., 0], lightness, atol=1e-5)
        np.testing.assert_allclose(seen.normal[..., 0], lightness, atol=1e-5)
        assert set(np.unique(seen.depth)) == {1, 2}
        spread.append(seen.albedo[:, 24].std())
    assert spread[0] == pytest.approx(4 * spread[1], rel=0.35)


def test_what_is_in_focus_stays_as_it_is():
    rng = np.random.default_rng(8)
    frame = Frame(color=rng.random((*SHAPE, 3), dtype=np.float32))
    reference = halves()
    seen = frame_through_lens(frame, reference, lens_of(0), 4, rng)
    np.testing.assert_allclose(seen.color, frame.color, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(
        reference_through_lens(reference, lens_of(0), rng), reference, rtol=1e-6
    )


@pytest.mark.parametrize("sharp_is_nearer", [True, False])
def test_only_what_is_nearer_spreads_over_what_is_sharp(sharp_is_nearer):
    """The left half is in focus; the right one is bright, before it or behind it."""
    own = np.zeros(SHAPE, np.float32)
    own[:, 25:] = 8
    depth = np.full(SHAPE, 2, np.float32)
    depth[:, 25:] = 4 if sharp_is_nearer else 1
    reach = own.copy()
    reach[:, 17:] = 8
    lens = Lens(own=own, reach=reach, depth=depth)
    found = reference_through_lens(halves(), lens, np.random.default_rng(9))
    np.testing.assert_allclose(found[:, :16], 0.2, rtol=1e-5)
    spread = found[:, 20, 0].mean() > 0.3
    assert spread != sharp_is_nearer
    np.testing.assert_allclose(found[:, 35:], 4, rtol=1e-5)


@pytest.mark.parametrize("samples", [1, 8])
def test_what_moves_is_blurred_along_its_way_alone(samples):
    """A bright square before a dark wall, moved by 8 pixels to the side."""
    rng = np.random.default_rng(3)
    reference, depth = np.full((*SHAPE, 3), 0.2, np.float32), np.full(SHAPE, 4, np.float32)
    reference[10:30, 15:35], depth[10:30, 15:35] = 4, 2
    lens = lens_before(depth, Opening(focus=2, disc=4, way=0.0))
    found = reference_through_lens(reference, lens, rng)[..., 0]
    np.testing.assert_allclose(found[:9], 0.2, rtol=1e-5)
    np.testing.assert_allclose(found[31:], 0.2, rtol=1e-5)
    # outside it covers the wall for less and less of the time; further in it always does
    assert np.all(np.diff(found[12:28, 35:40].mean(0)) < 0)
    assert 1.2 < found[12:28, 35].mean() < 2.2
    np.testing.assert_allclose(found[12:28, 41:], 0.2, rtol=1e-5)
    np.testing.assert_allclose(found[12:28, 20:30], 4, rtol=1e-5)
    total = np.zeros_like(reference)
    for _ in range(300):
        total += frame_through_lens(Frame(color=reference), reference, lens, samples, rng).color
    np.testing.assert_allclose((total / 300)[..., 0], found, atol=0.6)
    np.testing.assert_allclose((total / 300)[12:28].mean((0, 2)), found[12:28].mean(0), atol=0.08)


def test_a_camera_that_turns_blurs_all_along_its_way():
    reference = halves()
    lens = lens_before(np.ones(SHAPE, np.float32), Opening(focus=1, disc=5, way=0.0))
    found = reference_through_lens(reference, lens, np.random.default_rng(1)).mean((0, 2))
    np.testing.assert_allclose(found[:18], 0.2, rtol=1e-5)
    np.testing.assert_allclose(found[18:31], np.interp(
        np.arange(18, 31) + 0.5, [20, 30], [0.2, 4]), atol=0.25)  # fmt: skip


@pytest.mark.parametrize("seed", range(8))
def test_a_lens_is_focused_on_something(seed):
    rng = np.random.default_rng(seed)
    depth = np.ones(SHAPE, np.float32)
    depth[:, 20:40] = 3
    depth[:10] = 0  # the sky
    lens = lens_before(depth, replace(draw_opening(depth, rng), way=None))
    assert lens.own.min() == 0
    assert lens.own.max() > 0
    assert np.all(lens.reach >= lens.own)
    assert np.all(lens.depth > 0)


def test_some_openings_are_a_shutters_and_move_what_is_near_or_all():
    depth = np.ones(SHAPE, np.float32)
    depth[:, 20:40] = 3
    depth[:10] = 0  # the sky
    drawn = [draw_opening(depth, np.random.default_rng(seed)) for seed in range(120)]
    moving = [lens_before(depth, each) for each in drawn if each.way is not None]
    assert 0.1 < len(moving) / len(drawn) < 0.4
    stay = [lens.own == 0 for lens in moving]
    assert any(each.any() for each in stay)
    assert any(not each.any() for each in stay)
    for lens, still in zip(moving, stay, strict=True):
        assert lens.own.max() > 0
        # what stays lies behind all that moves
        assert not still.any() or lens.depth[still].min() > lens.depth[~still].max()

"""What both classical peers owe any sequence, whatever their filter."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

pytest.importorskip("scipy")

from stillray.errors import InputError
from stillray.frame import Frame
from stillray_training.peers import PEERS, find_peer, registry
from stillray_training.peers.bmfr import Bmfr
from stillray_training.peers.sequence import SequenceOptions, bring, prepare, with_frames
from stillray_training.peers.svgf import Svgf
from stillray_training.peers.taa import antialias, to_picture, to_radiance
from tests.conftest import ODD_SIZES, clean_color, make_frame

BOTH = pytest.mark.parametrize("peer", [Svgf, Bmfr])


def noiseless(height=40, width=48):
    """Textured albedo; each surface in its own even light."""
    frame = make_frame(height, width)
    texture = np.random.default_rng(1).uniform(0.2, 1, (height, width, 3))
    light = np.where(frame.depth[..., None] == 2, 0.9, 0.3)
    return dataclasses.replace(frame, color=texture * light, albedo=texture)


@BOTH
def test_a_static_noiseless_scene_is_a_fixed_point(peer):
    frame, stream = noiseless(), peer()
    for _ in range(6):
        clean = stream.denoise(frame)
    # BMFR's noise on the features shrinks a step between two surfaces by up to 0.2 per cent
    np.testing.assert_allclose(clean, frame.color, rtol=4e-3)


@BOTH
@pytest.mark.parametrize("size", ODD_SIZES)
def test_a_constant_image_stays_constant(peer, size):
    stream = peer()
    motion = np.random.default_rng(2).normal(0, 2, (*size, 2))
    for _ in range(4):
        clean = stream.denoise(Frame(color=np.full((*size, 3), 0.7), motion=motion))
        np.testing.assert_allclose(clean, 0.7, rtol=1e-4)


@BOTH
def test_noise_of_a_static_scene_falls_far(peer):
    stream, truth = peer(), clean_color(64, 80)
    for seed in range(8):
        frame = make_frame(64, 80, seed)
        clean = stream.denoise(frame)
    noise = np.sqrt(np.mean((frame.color - truth) ** 2))
    assert np.sqrt(np.mean((clean - truth) ** 2)) < 0.2 * noise


@BOTH
@pytest.mark.parametrize("shift", [(2.0, 0.0), (0.4, -1.3)])
def test_a_moving_textured_plane_keeps_its_history(peer, shift):
    stream = peer()
    height, width = 40, 56
    normal = np.broadcast_to([0.0, 0.0, 1.0], (height, width, 3))
    row, column = np.mgrid[:height, :width].astype(np.float64)
    for index in range(5):
        x, y = column + index * shift[0], row + index * shift[1]
        albedo = 0.5 + 0.4 * np.stack([np.sin(x / 3), np.cos(y / 2), np.sin(x + y)], -1)
        motion = np.broadcast_to(np.array(shift), (height, width, 2))
        stream.denoise(
            Frame(
                color=albedo * 0.5,
                albedo=albedo,
                normal=normal,
                depth=np.full((height, width), 3.0),
                motion=motion,
            )
        )
        assert stream.history is not None
        frames = stream.history.color[..., 3]
        np.testing.assert_allclose(frames[10:-10, 10:-10], index + 1, rtol=1e-5)


@BOTH
def test_what_was_hidden_has_no_history(peer):
    stream, shift = peer(), 6
    stream.denoise(make_frame(40, 60, 0))
    stream.denoise(make_frame(40, 60, 1, shift=0.0))
    moved = make_frame(40, 60, 2, shift=float(shift))
    stream.denoise(moved)
    before = make_frame(40, 60, 0).depth
    uncovered = (before == 2) & (moved.depth == 5)
    assert uncovered.sum() > 50
    frames = stream.history.color[..., 3]
    np.testing.assert_array_equal(frames[uncovered], 1)
    still_wall = (before == 5) & (moved.depth == 5)
    np.testing.assert_array_equal(frames[still_wall], 3)


@BOTH
def test_without_motion_every_frame_is_alone(peer):
    stream = peer()
    for seed in range(3):
        stream.denoise(dataclasses.replace(make_frame(20, 24, seed), motion=None))
    np.testing.assert_array_equal(stream.history.color[..., 3], 1)


@BOTH
def test_another_size_starts_anew(peer):
    stream = peer()
    stream.denoise(make_frame(20, 24))
    small = make_frame(18, 33)
    np.testing.assert_array_equal(stream.denoise(small), peer().denoise(small))


@BOTH
def test_the_same_frames_give_the_same_pictures(peer):
    def last():
        stream = peer()
        return [stream.denoise(make_frame(33, 50, seed)) for seed in range(3)][-1]

    np.testing.assert_array_equal(last(), last())


def spoiled(size, seed):
    """All that a renderer may write where it should not."""
    rng = np.random.default_rng(seed)
    frame = make_frame(*size, seed)
    bad = np.array([np.nan, np.inf, -np.inf, -1.0, 1e30, 3e38, 0.0])

    def spoil(image):
        where = rng.random(image.shape) < 0.2
        return np.where(where, rng.choice(bad, image.shape), image)

    return Frame(
        **{
            name: spoil(getattr(frame, name))
            for name in ("color", "albedo", "normal", "depth", "motion")
        }
    )


@BOTH
@pytest.mark.parametrize("size", ODD_SIZES)
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_spoiled_buffers_give_finite_radiance(peer, size):
    stream = peer()
    for seed in range(4):
        clean = stream.denoise(spoiled(size, seed))
        assert clean.shape == (*size, 3)
        assert np.isfinite(clean).all()
        assert clean.min() >= 0


@BOTH
@pytest.mark.parametrize("kept", [(), ("albedo",), ("normal",), ("depth",), ("depth", "motion")])
@pytest.mark.parametrize("scale", [0.0, 1e-20, 1.0, 1e12])
def test_few_buffers_and_any_scale_give_finite_radiance(peer, kept, scale):
    stream = peer()
    for seed in range(3):
        frame = make_frame(17, 21, seed)
        given = {name: getattr(frame, name) for name in kept}
        clean = stream.denoise(Frame(color=frame.color * np.float32(scale), **given))
        assert np.isfinite(clean).all()
        assert clean.max() <= frame.color.max() * np.float32(scale) * 1.01


@BOTH
def test_black_albedo_keeps_its_light(peer):
    stream = peer()
    frame = Frame(color=np.full((12, 14, 3), 0.6), albedo=np.zeros((12, 14, 3)))
    np.testing.assert_allclose(stream.denoise(frame), 0.6, rtol=1e-4)


def test_history_is_brought_from_where_motion_points():
    options = SequenceOptions()
    frame = make_frame(8, 9)
    column = np.broadcast_to(np.arange(9, dtype=np.float32), (8, 9))
    even = dataclasses.replace(
        frame,
        normal=None,
        depth=np.ones((8, 9)),
        motion=np.broadcast_to([1.5, 0.0], (8, 9, 2)),
    )
    buffers = prepare(even, None, options)
    past = bring(with_frames(column[..., None], np.ones((8, 9))), buffers, buffers, options)
    np.testing.assert_allclose(past[:, :7, 0], column[:, :7] + 1.5)
    np.testing.assert_array_equal(past[:, 8], 0)


def test_antialiasing_clips_ghosts_and_keeps_still_pictures(rng):
    motion = np.zeros((9, 11, 2), np.float32)
    flat = np.full((9, 11, 3), 0.2, np.float32)
    ghost = np.full((9, 11, 3), 0.9, np.float32)
    np.testing.assert_allclose(antialias(flat, ghost, motion, 0.2), 0.2, atol=1e-6)
    picture = rng.random((9, 11, 3)).astype(np.float32)
    still = antialias(picture, picture, motion, 0.2)
    # a pixel may stand above the mean of box and cross; inside of them it is kept
    inner = np.abs(still - picture).max(-1) < 1e-6
    assert inner.mean() > 0.5
    far = np.full_like(motion, 50)
    np.testing.assert_array_equal(antialias(picture, ghost, far, 0.2), picture)


def slow_antialias(picture, before, share):
    """Pixel by pixel, for a picture that stands still."""
    to_ycocg = np.array([[0.25, 0.5, 0.25], [0.5, 0, -0.5], [-0.25, 0.5, -0.25]])
    height, width = picture.shape[:2]
    colors = picture.astype(np.float64) @ to_ycocg.T
    result = np.zeros(picture.shape)
    for y in range(height):
        for x in range(width):
            box = [
                (i, j)
                for i in range(max(y - 1, 0), min(y + 2, height))
                for j in range(max(x - 1, 0), min(x + 2, width))
            ]
            cross = [(i, j) for i, j in box if y == i or x == j]
            least, most = (
                (end([colors[q] for q in box], 0) + end([colors[q] for q in cross], 0)) / 2
                for end in (np.min, np.max)
            )
            past = np.clip(to_ycocg @ before[y, x], least, most)
            past = np.linalg.inv(to_ycocg) @ past
            result[y, x] = np.clip(share * picture[y, x] + (1 - share) * past, 0, 1)
    return result


@pytest.mark.parametrize("size", [(1, 1), (2, 5), (9, 11)])
def test_antialiasing_is_its_definition(rng, size):
    picture, before = rng.random((2, *size, 3)).astype(np.float32)
    got = antialias(picture, before, np.zeros((*size, 2), np.float32), 0.2)
    np.testing.assert_allclose(got, slow_antialias(picture, before, 0.2), atol=1e-6)


def test_antialiasing_blends_what_lies_in_the_box():
    motion = np.zeros((5, 5, 2), np.float32)
    checks = np.indices((5, 5)).sum(0) % 2
    picture = np.repeat(checks[..., None], 3, -1).astype(np.float32)
    before = np.full_like(picture, 0.5)
    expected = 0.25 * picture + 0.75 * 0.5
    np.testing.assert_allclose(antialias(picture, before, motion, 0.25), expected, atol=1e-6)


def test_tone_curve_is_undone(rng):
    radiance = np.exp(rng.uniform(-12, 8, (20, 30, 3))).astype(np.float32)
    again = to_radiance(to_picture(radiance, 0.3), 0.3)
    # the picture is rounded to 6e-8: in the dark that is all, in the light 1 - picture loses digits
    np.testing.assert_allclose(again, radiance, rtol=3e-4, atol=2e-7 / 0.3)
    assert to_radiance(np.ones((1, 1, 3), np.float32), 1.0).max() == pytest.approx(1e6, rel=0.1)


def test_an_unknown_peer_is_refused():
    with pytest.raises(
        InputError, match=r"peer must be one of svgf, svgf-alone, bmfr, nfor, oidn-high, .* got nlm"
    ):
        find_peer("nlm")


def test_a_peer_without_its_package_is_refused(monkeypatch):
    absent = dataclasses.replace(PEERS[0], module="no_such_module", package="no-such-package")
    monkeypatch.setattr(registry, "PEERS", (absent,))
    assert not absent.is_installed
    with pytest.raises(InputError, match="peer svgf needs the package no-such-package"):
        find_peer("svgf")


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.name)
def test_every_peer_denoises_a_frame(peer):
    if not peer.is_installed:
        pytest.skip(f"{peer.package} is not installed")
    frame = make_frame(48, 64, 3)
    if peer.halves:
        frame = dataclasses.replace(frame, color_b=make_frame(48, 64, 4).color)
    clean = peer.make().denoise(frame)
    truth = clean_color(48, 64)
    assert clean.shape == (48, 64, 3)
    assert np.mean((clean - truth) ** 2) < 0.25 * np.mean((frame.color - truth) ** 2)

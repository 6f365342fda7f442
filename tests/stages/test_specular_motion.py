"""Motion of reflections: against projected geometry, and where there is nothing to follow."""

from __future__ import annotations

import numpy as np
import pytest

import stillray
from stillray import Frame
from stillray.arrays.strips import Strips
from stillray.model_spec.stages import Demodulate
from stillray.stages import decide
from stillray.stages.specular_motion import Surfaces, camera_motion, has_mirrors, virtual_motion
from tests.conftest import remembered

FOCAL = 100.0  # pixels
TRAVEL = np.array([0.06, 0.01, 0.03])  # metres a frame
TURN = 0.01  # radians a frame, about the vertical


def project(points):
    return FOCAL * points[..., :2] / points[..., 2:]


def motion_of(depth, rows=None, columns=None, shape=None):
    """Previous minus current position of points at a depth that stand still: float64 geometry."""
    height, width = shape or depth.shape
    if rows is None:
        rows, columns = np.mgrid[:height, :width]
    centre = np.array([width / 2, height / 2])
    place = np.stack([columns, rows], -1) - centre
    points = np.concatenate([place / FOCAL, np.ones((*place.shape[:-1], 1))], -1) * depth[..., None]
    c, s = np.cos(TURN), np.sin(TURN)
    before = points @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T + TRAVEL
    return (project(before) - place).astype(np.float32)


def scene(shape=(61, 83), seed=0):
    """A bumpy scene, and a flat mirror in its middle that shows what is four times as far."""
    rng = np.random.default_rng(seed)
    height, width = shape
    depth = rng.uniform(1.5, 6, (height // 8 + 1, width // 8 + 1))
    depth = np.kron(depth, np.ones((8, 8)))[:height, :width].astype(np.float32)
    mirror = np.zeros(shape, bool)
    mirror[16:46, 20:64] = True
    depth[mirror] = 2.0
    albedo = np.where(mirror[..., None], 0, rng.uniform(0.2, 0.9, (*shape, 3))).astype(np.float32)
    return depth, mirror, albedo


def pictures(depth, mirror, factor, seed=1):
    """What was seen and what is seen: a pattern on the points that the mirror shows."""
    motion = motion_of(np.where(mirror, depth * np.float32(factor), depth))
    rows, columns = np.mgrid[: depth.shape[0], : depth.shape[1]]
    rng = np.random.default_rng(seed)
    waves = rng.uniform(-0.9, 0.9, (12, 2))
    phases = rng.uniform(0, 6, 12)

    def pattern(x, y):
        sines = np.sin(x[..., None] * waves[:, 0] + y[..., None] * waves[:, 1] + phases)
        return (1.2 + sines.mean(-1) * 3).clip(0.05).astype(np.float32)

    past = pattern(columns.astype(float), rows.astype(float))
    now = pattern(columns + motion[..., 0], rows + motion[..., 1])
    return np.dstack([past] * 3 + [np.ones_like(past)]), now, motion


def follow(depth, albedo, past, now, motion=None, exposure=0.3):
    motion = motion_of(depth) if motion is None else motion
    surfaces, options = Surfaces(motion, depth, albedo), Demodulate(floor=0.1, black=1e-3)
    return virtual_motion(surfaces, now, past, exposure, options, Strips(2, pixels=500)), motion


@pytest.mark.parametrize("shape", [(61, 83), (64, 40)])
def test_the_camera_s_motion_is_that_of_projected_points_at_any_depth(shape):
    depth, _, _ = scene(shape)
    camera = camera_motion(motion_of(depth), depth)
    rows, columns = np.mgrid[: shape[0] : 5, : shape[1] : 7]
    for metres in (1.6, 5.0, 40.0, 1e7):
        far, near = camera.parts(rows, columns, np.full(rows.shape, metres, np.float32))
        wanted = motion_of(np.full(rows.shape, metres), rows, columns, shape)
        np.testing.assert_allclose(far + near, wanted, atol=0.15)


def test_things_that_move_do_not_spoil_the_camera_s_motion():
    depth, _, _ = scene()
    motion = motion_of(depth)
    motion[10:40, 5:35] += 7
    still = camera_motion(motion_of(depth), depth)
    found = camera_motion(motion, depth)
    np.testing.assert_allclose(found.turning, still.turning, atol=0.05)
    np.testing.assert_allclose(found.travel, still.travel, atol=0.05)


def test_motion_that_no_camera_makes_is_not_trusted():
    depth, _, albedo = scene()
    motion = np.random.default_rng(3).normal(0, 3, (*depth.shape, 2)).astype(np.float32)
    assert camera_motion(motion, depth) is None
    past, now, _ = pictures(*scene()[:2], 4)
    assert follow(depth, albedo, past, now, motion)[0] is motion


@pytest.mark.parametrize("factor", [2, 4, 1e6])
def test_what_a_mirror_shows_is_followed_at_its_own_depth(factor):
    depth, mirror, albedo = scene()
    past, now, shown = pictures(depth, mirror, factor)
    result, motion = follow(depth, albedo, past, now)
    np.testing.assert_array_equal(result[~mirror], motion[~mirror])
    inside = np.zeros_like(mirror)
    inside[22:40, 26:58] = True
    assert np.abs(motion - shown)[inside].max() > 1
    off = np.abs(result - shown)[inside].max(axis=-1)
    assert np.quantile(off, 0.9) < 0.3


def test_a_mirror_s_own_marks_keep_the_mirror_s_motion():
    depth, mirror, albedo = scene()
    past, now, _ = pictures(depth, mirror, 1)
    result, motion = follow(depth, albedo, past, now)
    kept = (result == motion).all(axis=-1)
    assert kept[mirror].mean() > 0.9


def test_where_nothing_shows_the_motion_is_passed_on_untouched():
    depth, mirror, albedo = scene()
    past, now, _ = pictures(depth, mirror, 4)
    result, motion = follow(depth, np.maximum(albedo, 0.1), past, now)
    assert result is motion
    flat = np.ones_like(now)
    result, motion = follow(depth, albedo, np.ones_like(past), flat)
    assert result is motion
    still = np.zeros((*depth.shape, 2), np.float32)
    assert follow(depth, albedo, past, now, still)[0] is still
    empty = np.zeros_like(depth)
    assert follow(empty, albedo, past, now, motion)[0] is motion


def test_a_mirror_that_moves_itself_is_left_alone():
    depth, mirror, albedo = scene((121, 165))  # of which the mirror is a small part
    past, now, _ = pictures(depth, mirror, 4)
    motion = motion_of(depth)
    motion[mirror] += 2
    # the camera is known, and the depths it would be followed to bring the past nearer
    assert camera_motion(motion, depth) is not None
    assert follow(depth, albedo, past, now, motion)[0] is motion


@pytest.mark.parametrize("extreme", [1e-30, 1e30])
def test_depths_of_any_size_give_finite_motion(extreme):
    depth, mirror, albedo = scene()
    past, now, _ = pictures(depth, mirror, 4)
    motion = motion_of(depth)
    depth[::3, ::4] = extreme
    result, _ = follow(depth, albedo, past, now, motion)
    assert np.isfinite(result).all()


@pytest.mark.parametrize("shape", [(1, 1), (15, 400), (16, 16), (17, 33)])
def test_mirrors_are_looked_for_in_frames_of_any_size(shape):
    assert has_mirrors(np.zeros((*shape, 3), np.float32), 1e-3) == (min(shape) >= 16)
    assert not has_mirrors(np.full((*shape, 3), 0.5, np.float32), 1e-3)


def test_a_stream_accumulates_what_the_mirror_shows(monkeypatch):
    depth, mirror, albedo = scene()
    past, now, _ = pictures(depth, mirror, 4)

    def frame(light, motion):
        color = np.dstack([light] * 3) * np.where(mirror[..., None], 1, albedo)
        return Frame(color=color, albedo=albedo, depth=depth, motion=motion)

    def stream():
        """How far what was accumulated is from what the mirror shows now, and the stages."""
        with stillray.Denoiser("wskp-3s") as denoiser:
            denoiser.denoise(frame(past[..., 0], None))
            second = frame(now, motion_of(depth))
            planned = {stage.name: stage.runs for stage in denoiser.stages(second)}
            denoiser.denoise(second)
            mean = remembered(denoiser).mean[..., 0]
            assert ("specular_motion" in denoiser.last_timings) == planned["specular_motion"]
        return np.abs(mean - now)[24:38, 28:56].mean(), planned["specular_motion"]

    followed, ran = stream()
    assert ran
    monkeypatch.setattr(decide, "has_mirrors", lambda *_: False)
    smeared, ran = stream()
    assert not ran
    assert followed < 0.3 * smeared

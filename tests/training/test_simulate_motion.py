"""Motion vectors against ray and plane in float64, without Mitsuba."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("mitsuba")

from stillray_training.simulate import buffers
from stillray_training.simulate.camera import Camera, look_at
from stillray_training.simulate.mesh import box, quad, rotation, sphere, translation
from stillray_training.simulate.paths import camera_path
from stillray_training.simulate.variant import load_mitsuba
from stillray_training.simulate.world import Lamp, Piece, Surface, World
from tests.training.simulate_worlds import FRONT, everything, moment, spinning, stage_of, still

SIZE = (25, 33)
GREY, WHITE = Surface(color=(0.5,) * 3), Surface(color=(0.9,) * 3)
TOLERANCE = 0.05  # pixels: what the project promises


@pytest.fixture(scope="module")
def mi():
    return load_mitsuba("scalar_rgb")[0]


def moving_camera(time: float) -> Camera:
    at = np.array([0.3 * time, 1.2 + 0.1 * time, 5.0 - 0.2 * time])
    return Camera(to_world=look_at(at, np.array([0, 0.6, 0]), np.array([0.05, 1, 0])), fov_x=50)


def world_with(pieces, **rest) -> World:
    lamp = Lamp(mesh=sphere([0, 6, 3], 0.1), radiance=(99,) * 3, around=True)
    return World(label="t", pieces=pieces, lamps=[lamp], **rest)


def render(mi, world, effects, path, *, spp=1):
    """One frame, and where each pixel's sample fell: the samples' own positions."""
    stage = stage_of(mi, world, effects, height=SIZE[0], width=SIZE[1])
    seen = {}
    original = buffers.first_hits

    def keep(*args):
        result = original(*args)
        seen.update(result)
        return result

    buffers.first_hits = keep
    try:
        frame = buffers.render_noisy(stage, moment(path, frame=2), spp=spp, seed=4)
    finally:
        buffers.first_hits = original
    return frame, seen["direction"].reshape(*SIZE, 3)


def project(camera: Camera, point: np.ndarray) -> np.ndarray:
    """Pinhole projection, written out: x right, y down, pixels."""
    local = np.linalg.inv(camera.to_world) @ np.append(point, 1.0)
    focal = SIZE[1] / 2 / np.tan(np.radians(camera.fov_x) / 2)
    return np.array(
        [SIZE[1] / 2 - focal * local[0] / local[2], SIZE[0] / 2 - focal * local[1] / local[2]]
    )


def test_motion_of_a_still_floor_is_the_cameras(mi):
    world = world_with([Piece(mesh=quad([-9, 0, 9], [18, 0, 0], [0, 0, -18]), surface=GREY)])
    frame, rays = render(mi, world, (), moving_camera)
    now, before = moving_camera(2.0), moving_camera(1.0)
    origin = now.to_world[:3, 3]
    checked = 0
    for row in range(SIZE[0]):
        for column in range(SIZE[1]):
            ray = rays[row, column].astype(float)
            if ray[1] > -0.02 or frame["depth"][row, column] == 0:
                continue
            point = origin - ray * origin[1] / ray[1]
            expected = project(before, point) - project(now, point)
            assert np.abs(frame["motion"][row, column] - expected).max() < TOLERANCE
            z = (point - origin) @ now.to_world[:3, 2]
            assert frame["depth"][row, column] == pytest.approx(z, rel=1e-4)
            checked += 1
    assert checked > 200


def test_background_at_infinity_moves_with_the_cameras_rotation_only(mi):
    world = world_with([Piece(mesh=sphere([0, 0.6, 0], 0.2), surface=GREY)])
    frame, rays = render(mi, world, (), moving_camera)
    now, before = moving_camera(2.0), moving_camera(1.0)
    sky = frame["depth"] == 0
    assert sky.mean() > 0.8
    assert (frame["normal"][sky] == 0).all()
    assert (frame["albedo"][sky] == 0).all()
    for row, column in np.argwhere(sky)[::7]:
        ray = rays[row, column].astype(float)
        far = 1e7 * ray
        expected = project(before, before.to_world[:3, 3] + far)
        expected = expected - project(now, now.to_world[:3, 3] + far)
        assert np.abs(frame["motion"][row, column] - expected).max() < TOLERANCE


def test_background_does_not_move_with_a_camera_that_only_walks(mi):
    def walk(time):
        return Camera(to_world=translation([0.4 * time, 0, 0]) @ FRONT.to_world, fov_x=50)

    frame, _ = render(
        mi, world_with([Piece(mesh=sphere([0, 0.6, 0], 0.3), surface=GREY)]), (), walk
    )
    assert np.abs(frame["motion"][frame["depth"] == 0]).max() < 1e-3
    assert np.abs(frame["motion"][frame["depth"] > 0]).max() > 1


def test_motion_follows_the_point_on_a_sliding_turning_object(mi):
    pose = spinning([0.2, 1, 0.1], 11.0, [0.13, 0.05, -0.1])
    top = Piece(mesh=box([0, 0.5, 0], [1.2, 1.0, 1.0]), surface=WHITE, group="b")
    floor = Piece(mesh=quad([-9, -1, 9], [18, 0, 0], [0, 0, -18]), surface=GREY)
    world = world_with([floor, top], moving={"b": pose})
    frame, rays = render(mi, world, ("moving_object",), moving_camera)
    now, before = moving_camera(2.0), moving_camera(1.0)
    origin = now.to_world[:3, 3]
    checked = 0
    for row, column in np.argwhere(frame["albedo"][..., 0] > 0.8):
        # where the ray enters the box, in the box's own frame: slabs
        to_local = np.linalg.inv(pose(2.0))
        start = (to_local @ np.append(origin, 1))[:3]
        ray = to_local[:3, :3] @ rays[row, column].astype(float)
        low, high = np.array([-0.6, 0.0, -0.5]), np.array([0.6, 1.0, 0.5])
        near = np.minimum((low - start) / ray, (high - start) / ray).max()
        local = np.append(start + near * ray, 1.0)
        expected = project(before, (pose(1.0) @ local)[:3]) - project(now, (pose(2.0) @ local)[:3])
        assert np.abs(frame["motion"][row, column] - expected).max() < TOLERANCE
        checked += 1
    assert checked > 40
    # by world position alone the vectors would be wrong: the object really matters here
    flat, _ = render(mi, world_with([floor, top]), (), moving_camera)
    both = (frame["albedo"][..., 0] > 0.8) & (flat["albedo"][..., 0] > 0.8)
    assert np.abs(frame["motion"] - flat["motion"])[both].max() > 1


def test_the_floor_that_an_object_uncovers_keeps_the_floors_motion(mi):
    # disocclusion: what was hidden before still has a place in the previous frame
    block = Piece(mesh=box([0, 0.5, 1.0], [1.0, 1.0, 0.4]), surface=WHITE, group="b")
    floor = Piece(mesh=quad([-9, 0, 9], [18, 0, 0], [0, 0, -18]), surface=GREY)
    world = world_with([floor, block], moving={"b": lambda time: translation([0.8 * time, 0, 0])})
    path = still(FRONT)
    frame, _ = render(mi, world, ("moving_object",), path)
    on_floor = (frame["albedo"][..., 0] > 0.4) & (frame["albedo"][..., 0] < 0.6)
    on_block = frame["albedo"][..., 0] > 0.8
    assert on_block.sum() > 20
    assert np.abs(frame["motion"][on_floor]).max() < 1e-3
    # pixels left of the block now, where it stood one frame before: floor, and uncovered
    left = np.argwhere(on_block)[:, 1].min()
    assert on_floor[:, max(left - 3, 0) : left].any()
    assert frame["motion"][on_block][:, 0].max() < -2  # it came from the left


@pytest.mark.parametrize("spp", [2, 5])
def test_motion_of_several_samples_is_their_mean(mi, spp):
    path = moving_camera
    frame = buffers.render_noisy(
        stage_of(mi, everything(), ("moving_object",), height=9, width=11),
        moment(path, frame=2),
        spp=spp,
        seed=8,
    )
    assert np.isfinite(frame["motion"]).all()
    hit = frame["depth"] > 0
    np.testing.assert_allclose(np.linalg.norm(frame["normal"][hit], axis=-1), 1, atol=1e-5)
    assert frame["color"].shape == (9, 11, 3)


def test_motion_takes_the_albedo_back_to_the_previous_frame(mi):
    # end to end: warping frame 1 by the vectors of frame 2 lands on the same surfaces
    def pose(time):
        return translation([0.15 * time, 0, 0]) @ rotation([0, 1, 0], 5 * time)

    world = world_with(
        [
            Piece(mesh=quad([-9, 0, 9], [18, 0, 0], [0, 0, -18]), surface=GREY),
            Piece(mesh=box([0, 0.6, 0], [1.4, 1.2, 1.0]), surface=WHITE, group="b"),
        ],
        moving={"b": pose},
    )
    stage = stage_of(mi, world, ("moving_object",), height=SIZE[0], width=SIZE[1])
    previous, current = (
        buffers.render_noisy(stage, moment(moving_camera, frame=k), spp=1, seed=k) for k in (1, 2)
    )
    row, column = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    x = np.round(column + current["motion"][..., 0]).astype(int)
    y = np.round(row + current["motion"][..., 1]).astype(int)
    inside = (x >= 0) & (x < SIZE[1]) & (y >= 0) & (y < SIZE[0])
    warped = previous["albedo"][y.clip(0, SIZE[0] - 1), x.clip(0, SIZE[1] - 1), 0]
    same = np.abs(warped - current["albedo"][..., 0]) < 0.05
    assert same[inside].mean() > 0.9  # the rest: silhouettes and what was hidden


@pytest.mark.parametrize("move", ["still", "dolly", "orbit", "handheld"])
def test_camera_moves_are_smooth_seeded_and_as_fast_as_asked(move):
    one, two = (
        camera_path(move, np.random.default_rng(3), FRONT, 5.0, speed=0.01) for _ in range(2)
    )
    times = np.linspace(0, 8, 33)
    places = np.array([one(t).to_world[:3, 3] for t in times])
    np.testing.assert_array_equal(places, [two(t).to_world[:3, 3] for t in times])
    np.testing.assert_allclose(places[0], FRONT.to_world[:3, 3], atol=1e-12)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1) * 4
    assert steps.max() <= 2 * 0.01 * 5.0
    assert (steps.max() == 0) == (move == "still")
    # smooth: neighbouring steps differ by little
    assert np.abs(np.diff(steps)).max() <= 0.3 * max(steps.max(), 1e-9)
    for t in times:
        turn = one(t).to_world[:3, :3]
        np.testing.assert_allclose(turn.T @ turn, np.eye(3), atol=1e-12)


def test_projection_puts_the_target_in_the_middle_and_right_to_the_right():
    camera = Camera(
        to_world=look_at(np.array([0, 0, 5.0]), np.zeros(3), np.array([0, 1.0, 0])), fov_x=90
    )
    x, y, z = camera.project(np.array([[0, 0, 0], [5, 0, 0], [0, 5, 0], [1, 1, 3]]), 100, 200)
    np.testing.assert_allclose(x, [100, 200, 100, 150], atol=1e-9)
    np.testing.assert_allclose(y, [50, 50, -50, 0], atol=1e-9)
    np.testing.assert_allclose(z, [5, 5, 5, 2])

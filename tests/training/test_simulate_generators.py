from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("mitsuba")

from stillray.errors import InputError
from stillray_training.simulate import mesh as shapes
from stillray_training.simulate.generators import GENERATORS, generate, openings
from stillray_training.simulate.generators.home import Home
from stillray_training.simulate.mesh import Mesh
from stillray_training.simulate.plan import make_plan
from stillray_training.simulate.textures import KINDS, pattern, sky
from stillray_training.simulate.variant import load_mitsuba
from stillray_training.simulate.viewpoint import find_path, inside
from stillray_training.simulate.world import Lamp, Piece, Surface, World
from tests.training.simulate_worlds import stage_of


@pytest.fixture(scope="module")
def mi():
    return load_mitsuba("scalar_rgb")[0]


MESHES = {
    "box": shapes.box([1, 2, 3], [0.5, 1, 2]),
    "sphere": shapes.sphere([0, 1, 0], 0.7, rings=12),
    "cylinder": shapes.cylinder([1, 0, 0], 0.3, 1.5),
    "tube": shapes.tube([[0, 0, 0], [0.1, 1, 0], [0.5, 1.5, 0.4]], 0.05),
    "sheet": shapes.sheet(0.1 * np.random.default_rng(1).random((5, 7)), 2.0, 1.0),
    "quad": shapes.quad([0, 0, 0], [2, 0, 0], [0, 0, -1]),
    "mirrored": shapes.sphere([0, 0, 0], 1.0, rings=6).moved(np.diag([-1.0, 1, 1, 1])),
    "stretched": shapes.sphere([0, 0, 0], 1.0, rings=6).moved(np.diag([1.0, 3, 0.5, 1])),
}


@pytest.mark.parametrize("name", MESHES)
def test_meshes_are_wound_the_way_their_normals_point(name):
    mesh = MESHES[name]
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    solid = np.linalg.norm(face, axis=1) > 1e-9  # the poles of spheres have empty triangles
    mean = sum(mesh.normals[mesh.faces[:, i]] for i in range(3))
    assert ((face * mean).sum(-1)[solid] > 0).all()
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-9)


@pytest.mark.parametrize("name", ["box", "sphere", "cylinder"])
def test_closed_bodies_hold_the_volume_they_should(name):
    # the divergence theorem: only a closed, outward surface gives the volume
    mesh = MESHES[name]
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    volume = (a * np.cross(b, c)).sum() / 6
    expected = {"box": 1.0, "sphere": 4 / 3 * np.pi * 0.7**3, "cylinder": np.pi * 0.09 * 1.5}[name]
    assert volume == pytest.approx(expected, rel=0.08)  # facets cut corners off
    assert volume <= expected * (1 + 1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_patterns_fill_the_unit_range_and_follow_their_seed(kind):
    one, two = (pattern(kind, np.random.default_rng(5), 64) for _ in range(2))
    np.testing.assert_array_equal(one, two)
    assert one.shape == (64, 64)
    assert one.min() == 0
    assert one.max() == pytest.approx(1)
    assert one.std() > 0.05


@pytest.mark.parametrize("kind", ["clear", "cloudy", "dusk", "night", "studio"])
def test_skies_are_bright_above_and_mean_one(kind):
    image = sky(kind, np.random.default_rng(2), 32)
    assert image.shape == (32, 64, 3)
    assert image.min() >= 0
    assert image.mean() == pytest.approx(1, rel=1e-4)
    assert image[:16].mean() > image[16:].mean()


def fingerprint(world: World) -> list[float]:
    return [
        float(np.sum(p.mesh.vertices) + len(p.mesh.faces) + sum(p.surface.color))
        for p in world.pieces
    ]


@pytest.mark.parametrize("name", GENERATORS)
def test_scenes_follow_their_seed_and_differ_between_seeds(name):
    one, again, other = generate(name, 3), generate(name, 3), generate(name, 4)
    assert fingerprint(one) == fingerprint(again)
    assert one.effects == again.effects
    assert fingerprint(one) != fingerprint(other)


@pytest.mark.parametrize("name", GENERATORS)
@pytest.mark.parametrize("seed", range(3))
def test_every_scene_gives_a_plan_of_finite_geometry_and_light(name, seed):
    world = generate(name, seed)
    plan = make_plan(world)
    assert set(plan.effects) == set(world.effects)
    for shape in plan.shapes.values():
        assert np.isfinite(shape.mesh.vertices).all()
        assert np.isfinite(shape.mesh.normals).all()
        assert shape.mesh.faces.max() < len(shape.mesh.vertices)
    for piece in world.pieces:
        assert all(0 <= v <= 1 for v in piece.surface.color)
    assert all(all(v >= 0 for v in lamp.radiance) for lamp in world.lamps)
    for group in (*world.moving, *world.swinging):
        bodies = world.pieces_of(group) + [lamp for lamp in world.lamps if lamp.group == group]
        assert bodies


def test_together_a_few_scenes_call_for_every_effect():
    from stillray_training.simulate.effects import EFFECTS

    # table tops are quick to make; a table by a window has relief, which they have not
    called = {e for seed in range(60) for e in generate("tabletop", seed).effects}
    called |= {e for seed in range(3) for e in generate("desk", seed).effects}
    assert called == set(EFFECTS)


def test_a_still_life_whose_lamps_are_all_behind_its_backdrop_has_a_sky():
    hidden = 0
    for seed in range(100):
        world = generate("tabletop", seed)
        walls = [piece.mesh.vertices for piece in world.pieces if not piece.group]
        walled = any(np.ptp(wall[:, 0]) > 2.9 and wall[:, 2].max() < -0.8 for wall in walls)
        if walled and all(lamp.mesh.vertices[:, 2].mean() < -0.87 for lamp in world.lamps):
            hidden += 1
            assert "environment" in world.effects
    assert hidden >= 2


@pytest.mark.parametrize("seed", range(5))
def test_cameras_stand_in_the_open_whatever_the_seed(mi, seed):
    # boxes fill most of the space: an analytic test says whether a camera is inside one
    rng = np.random.default_rng(seed)
    centres = rng.uniform([-3, 0, -3], [3, 2, 3], (14, 3))
    sizes = rng.uniform(0.4, 1.6, (14, 3))
    surface = Surface(color=(0.5,) * 3)
    room = shapes.box([0, 1.25, 0], [8, 3.5, 8])
    walls = Mesh(
        vertices=room.vertices, normals=-room.normals, uvs=room.uvs, faces=room.faces[:, ::-1]
    )
    pieces = [
        Piece(mesh=shapes.box(c, s), surface=surface) for c, s in zip(centres, sizes, strict=True)
    ]
    world = World(
        label="boxes",
        pieces=[Piece(mesh=walls, surface=surface), *pieces],
        lamps=[Lamp(mesh=shapes.sphere([0, 2.8, 0], 0.05), radiance=(9,) * 3, around=True)],
        space=(np.array([-4.5, -0.5, -4.5]), np.array([4.5, 3.0, 4.5])),  # reaches outside too
        gaze=(np.array([-3, 0, -3.0]), np.array([3, 2, 3.0])),
    )
    stage = stage_of(mi, world)
    for move in ("dolly", "handheld"):
        path, middle = find_path(
            stage, np.random.default_rng([seed, 1]), frames=4, move=move, speed=0.02
        )
        assert middle > 0
        for time in np.linspace(0, 3, 13):
            place = path(time).to_world[:3, 3]
            assert not (np.abs(place - centres) < sizes / 2).all(axis=1).any()
            assert (np.abs(place - [0, 1.25, 0]) < [4, 1.75, 4]).all()  # inside the room
    for centre in centres[:4]:
        from dataclasses import replace

        at = path(0.0).to_world.copy()
        at[:3, 3] = centre
        assert inside(stage, replace(path(0.0), to_world=at), middle)


def test_a_scene_without_room_for_a_camera_says_so(mi):
    world = World(
        label="solid",
        pieces=[Piece(mesh=shapes.box([0, 0, 0], [4, 4, 4]), surface=Surface(color=(0.5,) * 3))],
        lamps=[Lamp(mesh=shapes.sphere([0, 5, 0], 0.1), radiance=(9,) * 3, around=True)],
        space=(-np.ones(3), np.ones(3)),
        gaze=(-np.ones(3), np.ones(3)),
    )
    with pytest.raises(InputError, match="scene solid has no open place for a camera"):
        find_path(stage_of(mi, world), np.random.default_rng(0), frames=2, move="still", speed=0.0)


@pytest.mark.parametrize("style", openings.BARS)
@pytest.mark.parametrize("seed", range(3))
def test_bars_fill_their_opening_and_do_not_leave_it(style, seed):
    mesh = shapes.join(openings.BARS[style](Home([seed], None), 1.3, 1.7))
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    assert (low[:2] > -0.015).all()
    assert (high[:2] < np.array([1.3, 1.7]) + 0.015).all()
    assert (high - low)[1] > 1.5
    # about a quarter of a bar's surface is seen: they bar the view and let most of it through
    assert 0.01 < mesh.area() / 4 / (1.3 * 1.7) < 0.35


@pytest.mark.parametrize("seed", range(4))
def test_something_moves_in_every_scene_of_shadows(seed):
    world = generate("shadows", seed)
    assert "moving_object" in world.effects
    for group, motion in world.moving.items():
        step = motion(1.0)[:3, 3] - motion(0.0)[:3, 3]
        assert world.pieces_of(group)
        assert not np.allclose(motion(1.0), motion(0.0)), step


@pytest.mark.parametrize("name", ["interior", "desk"])
def test_rooms_are_muted_and_lit_from_wide_surfaces(name):
    saturation, brightest = [], []
    for seed in range(3):
        world = generate(name, seed)
        for piece in world.pieces:
            color = np.array(piece.surface.color)
            saturation.append((color.max() - color.min()) / color.max())
        gain = max(max(lamp.radiance) for lamp in world.lamps)
        power = [np.mean(lamp.radiance) * lamp.mesh.area() for lamp in world.lamps]
        main = world.lamps[int(np.argmax(power))]
        brightest.append(main.mesh.area())
        assert max(main.radiance) > 0.05 * gain  # no bulb outshines the window by far
    assert np.median(saturation) < 0.35
    assert min(brightest) > 0.1  # square metres


def test_the_picture_of_a_fitted_face_covers_it_once():
    face = openings.fitted(shapes.quad([1, 2, 0], [0.9, 0, 0], [0, 2.1, 0]))
    np.testing.assert_allclose(np.ptp(face.uvs, axis=0), 1)


def test_brighter_lamps_are_asked_more_often():
    dim = Lamp(mesh=shapes.sphere([0, 2, 0], 0.1, rings=4), radiance=(1, 1, 1))
    bright = Lamp(mesh=shapes.sphere([1, 2, 0], 0.1, rings=4), radiance=(100, 100, 100))
    plan = make_plan(World(label="two", lamps=[dim, bright]), ("soft_shadow",))
    weight = {n: s.emitter.params["sampling_weight"] for n, s in plan.shapes.items()}
    assert weight["lamp1"] == pytest.approx(10 * weight["lamp0"])

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mitsuba")

from stillray.errors import InputError
from stillray_training.simulate import effects as registry
from stillray_training.simulate.effects import EFFECTS
from stillray_training.simulate.effects.environment import environment_map
from stillray_training.simulate.mesh import box, quad, sphere, translation
from stillray_training.simulate.plan import make_plan
from stillray_training.simulate.textures import Texture
from stillray_training.simulate.variant import load_mitsuba
from stillray_training.simulate.world import Fog, Lamp, Lens, Piece, Sky, Sun, Surface, World
from tests.training.simulate_worlds import (
    FRONT,
    everything,
    exact,
    noisy,
    spinning,
    stage_of,
    still,
)

FLOOR = quad([-4, 0, 4], [8, 0, 0], [0, 0, -8])


@pytest.fixture(scope="module")
def mi():
    return load_mitsuba("scalar_rgb")[0]


@pytest.fixture(scope="module")
def base(mi):
    return noisy(mi, everything(), spp=2)


def down(x: float = 0.0, z: float = 0.0, *, y: float = 4.0, fov: float = 40.0):
    """A camera that looks straight down, picture right along +x, picture down along +z."""
    from stillray_training.simulate.camera import Camera, look_at

    return Camera(
        to_world=look_at(np.array([x, y, z]), np.array([x, 0, z]), np.array([0, 0, -1.0])),
        fov_x=fov,
    )


# -- nothing that was not asked for


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_not_asked_for_leaves_no_trace_in_the_plan(name):
    others = [other for other in EFFECTS if other != name]
    without, with_it = make_plan(everything(), others), make_plan(everything(), EFFECTS)
    assert not [node for node in without.nodes() if node.asked_by == name]
    assert not [p for p, who in without.plugins() if who == name]
    assert not [d for d in without.dimensions if d.asked_by == name]
    assert not [b for b in without.buffers if b.asked_by == name]
    assert not [bounces for bounces, who in without.depth if who == name]
    marks = [n for n in with_it.nodes() if n.asked_by == name]
    marks += [d for d in with_it.dimensions if d.asked_by == name]
    marks += [b for b in with_it.buffers if b.asked_by == name]
    assert marks


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_not_asked_for_leaves_the_pixels_as_if_it_did_not_exist(
    mi, base, monkeypatch, name
):
    monkeypatch.delitem(registry.EFFECTS, name)
    for layer, values in noisy(mi, everything(), spp=2).items():
        np.testing.assert_array_equal(values, base[layer])


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_asked_for_changes_the_picture(mi, base, name):
    path = None
    if name == "motion_blur":  # without anything that moves there is nothing to blur

        def path(time):
            return replace(FRONT, to_world=translation([0.3 * time, 0, 0]) @ FRONT.to_world)

        base = noisy(mi, everything(), spp=2, path=path)
    changed = noisy(mi, everything(), (name,), spp=2, path=path)
    assert np.abs(changed["color"] - base["color"]).max() > 0.01
    assert np.isfinite(changed["color"]).all()


@pytest.mark.parametrize("names", [(), ("glossy",), ("mirror_glass", "texture"), tuple(EFFECTS)])
def test_the_loaded_scene_holds_the_plugins_of_the_plan(mi, names):
    classes = {
        "diffuse": "SmoothDiffuse",
        "roughplastic": "RoughPlastic",
        "conductor": "SmoothConductor",
        "roughconductor": "RoughConductor",
        "normalmap": "NormalMap",
        "null": "Null",
        "area": "AreaLight",
        "point": "PointLight",
        "envmap": "EnvironmentMapEmitter",
        "directional": "DirectionalEmitter",
        "path": "PathIntegrator",
        "volpath": "VolumetricPathIntegrator",
        "perspective": "PerspectiveCamera",
        "thinlens": "ThinLensCamera",
    }
    stage = stage_of(mi, everything(), names)
    loaded = [stage.integrator, stage.sensor, *stage.scene.emitters()]
    loaded += [shape.bsdf() for shape in stage.scene.shapes()]
    planned = {classes[plugin] for plugin, _ in stage.plan.plugins() if plugin in classes}
    # what lies in a normal map is not on the list of materials
    maps = [node for node in stage.plan.nodes() if node.plugin == "normalmap"]
    hidden = {classes[node.params["bsdf"].plugin] for node in maps}
    hidden.add("SmoothDiffuse")  # the black body of a lamp
    assert {o.class_name() for o in loaded} | hidden == planned | hidden


def test_numbers_drawn_are_those_the_plan_names(mi):
    from stillray_training.simulate import trace

    class Counting:
        def __init__(self):
            self.sampler = mi.load_dict({"type": "independent"})
            self.sampler.seed(0)
            self.drawn = 0

        def next_1d(self):
            self.drawn += 1
            return self.sampler.next_1d()

        def next_2d(self):
            self.drawn += 2
            return self.sampler.next_2d()

    class Silent:
        def sample(self, *_):
            return mi.Color3f(0), True, []

    for names in ((), ("depth_of_field",), ("texture", "glossy", "sun", "environment")):
        stage = stage_of(mi, everything(), names)
        stage.integrator = Silent()
        sampler = Counting()
        shot = trace.Shot(time=0.0, camera=FRONT, previous=FRONT, jitter=np.zeros(2))
        trace.sample(stage, shot, sampler, 5)
        camera = [d for d in stage.plan.dimensions if d.per == "sample"]
        assert sampler.drawn == sum(d.size for d in camera)


def test_an_unknown_effect_is_named_with_the_known_ones():
    with pytest.raises(InputError, match=r"effects must be of soft_shadow, .* got caustics"):
        make_plan(everything(), ("caustics",))


def test_an_effect_the_scene_cannot_show_is_refused():
    with pytest.raises(InputError, match="effect medium needs a fog, and everything has none"):
        make_plan(replace(everything(), fog=None), ("medium",))


def test_a_scene_without_any_light_is_refused():
    with pytest.raises(InputError, match="effects must let something shine"):
        make_plan(replace(everything(), lamps=[]), ("texture",))


# -- an oracle for each effect


def test_texture_shows_the_picture_at_its_place(mi):
    picture = Texture(kind="painting", seed=4, low=(0.1,) * 3, high=(0.9,) * 3, size=8.0)
    surface = Surface(color=(0.5,) * 3, texture=picture)
    world = World(
        label="t",
        pieces=[Piece(mesh=FLOOR, surface=surface)],
        lamps=[Lamp(mesh=sphere([0, 3, 0], 0.1), radiance=(9, 9, 9), around=True)],
    )
    camera = down(y=4.0 / np.tan(np.radians(20)))  # sees the whole picture, x right, z down
    seen = noisy(mi, world, ("texture",), path=still(camera), spp=8, height=16, width=16)
    # u runs with x and v against z, and row 0 of a picture is its top
    expected = picture.image().reshape(16, 16, 16, 16, 3).mean(axis=(1, 3))
    error = np.abs(seen["albedo"] - expected)
    assert np.median(error) < 0.05  # 8 samples of a pixel that holds 256 texels
    for turned in (expected[::-1], expected[:, ::-1], expected[::-1, ::-1]):
        assert np.abs(seen["albedo"] - turned).mean() > 2 * error.mean()


def test_glossy_shows_a_highlight_where_the_law_of_reflection_puts_it(mi):
    metal = Surface(color=(0.9,) * 3, roughness=0.1, metal=True)
    world = World(
        label="t",
        pieces=[Piece(mesh=FLOOR, surface=metal)],
        lamps=[Lamp(mesh=sphere([1.0, 2.0, 0], 0.05), radiance=(900,) * 3, around=True)],
    )
    camera = down(x=-1.0, y=2.0, fov=100)
    with_it = exact(mi, world, ("glossy",), path=still(camera), spp=16, height=41, width=41)[..., 0]
    # equal heights: the mirror point lies half way between camera and lamp, at x = 0
    x, y, _ = camera.project(np.array([0.0, 0, 0]), 41, 41)
    row, column = np.unravel_index(np.argmax(with_it), with_it.shape)
    assert abs(column + 0.5 - x) <= 1.5
    assert abs(row + 0.5 - y) <= 1.5
    without = exact(mi, world, path=still(camera), spp=16, height=41, width=41)[..., 0]
    _, flat = np.unravel_index(np.argmax(without), without.shape)
    assert abs(flat - column) > 5  # a matte floor is brightest under the lamp


@pytest.mark.parametrize(("special", "expected"), [("mirror", 0.8), ("glass", 1.0), ("pane", 1.0)])
def test_mirror_and_glass_conserve_the_radiance_of_a_uniform_sky(
    mi, monkeypatch, special, expected
):
    # white furnace: clear glass of any form is invisible in uniform light, a mirror shows R L
    monkeypatch.setattr(
        "stillray_training.simulate.effects.environment.environment_map",
        lambda sky: np.full((16, 32, 3), 2.0, np.float32),
    )
    tint = 0.8 if special == "mirror" else 1.0
    ball = Piece(
        mesh=sphere([0, 0.6, 0], 0.8, rings=24), surface=Surface(color=(tint,) * 3, special=special)
    )
    world = World(label="t", pieces=[ball], sky=Sky())
    color = exact(mi, world, ("mirror_glass", "environment"), spp=1024, height=9, width=9)
    # paths that bounce on inside are cut off at the depth limit; a fifth of those that a mirror
    # reflects ends by chance, which leaves noise of 1.6 %
    np.testing.assert_allclose(color[4, 4], 2.0 * expected, rtol=0.06)


def test_soft_shadow_has_the_penumbra_of_the_lamp(mi):
    wide, high, edge = 0.8, 4.0, 1.0  # lamp width and height, height of the occluder's edge
    world = World(
        label="t",
        pieces=[
            Piece(mesh=FLOOR, surface=GREY),
            Piece(
                mesh=quad([-4, edge, 1], [4, 0, 0], [0, 0, -2]),
                surface=replace(GREY, two_sided=True),
            ),
        ],
        lamps=[
            Lamp(mesh=quad([-wide / 2, high, -0.2], [wide, 0, 0], [0, 0, 0.4]), radiance=(20,) * 3)
        ],
    )
    expected = wide * edge / (high - edge)  # similar triangles
    camera = down(x=0.0, y=0.9, fov=40)  # under the occluder
    width = 60
    metres = 2 * 0.9 * np.tan(np.radians(20)) / width

    def profile(names):
        color = exact(mi, world, names, path=still(camera), spp=700, height=3, width=width)
        return color[..., 0].mean(axis=0)

    lit = profile(("soft_shadow",))
    direct = (lit - lit[:6].mean()) / (lit[-6:].mean() - lit[:6].mean())
    between = np.interp([0.1, 0.9], np.maximum.accumulate(direct), np.arange(width)) * metres
    # a straight ramp over the penumbra: 80 % of it lies between a tenth and nine tenths
    assert (between[1] - between[0]) / 0.8 == pytest.approx(expected, rel=0.15)
    hard = profile(())
    hard = (hard - hard[:6].mean()) / (hard[-6:].mean() - hard[:6].mean())
    assert ((hard > 0.1) & (hard < 0.9)).sum() <= 2


GREY = Surface(color=(0.5, 0.5, 0.5))


def test_environment_lights_a_floor_with_its_cosine_integral(mi):
    sky = Sky(kind="clear", seed=3, radiance=1.5)
    world = World(label="t", pieces=[Piece(mesh=FLOOR, surface=GREY)], sky=sky)
    color = exact(mi, world, ("environment",), path=still(down()), spp=400, height=5, width=5)
    image = environment_map(sky).astype(np.float64)
    height, width = image.shape[:2]
    irradiance = np.zeros(3)
    for row in range(height // 2):
        theta = np.pi * (row + 0.5) / height
        solid_angle = np.sin(theta) * (np.pi / height) * (2 * np.pi / width)
        irradiance += (image[row] * np.cos(theta) * solid_angle).sum(axis=0)
    np.testing.assert_allclose(color.mean(axis=(0, 1)), 0.5 / np.pi * irradiance, rtol=0.03)


@pytest.mark.parametrize("facing", [(1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)])
def test_the_dark_half_of_an_indoor_sky_lies_behind_the_windows(mi, facing):
    from stillray_training.simulate.camera import Camera, look_at

    world = World(
        label="t",
        pieces=[Piece(mesh=sphere([0, -99, 0], 0.1), surface=GREY)],
        sky=Sky(kind="cloudy", facing=facing),
    )
    eye = np.array([0, 1.0, 0])
    for sign in (1, -1):
        view = look_at(eye, eye + sign * np.array(facing) + [0, 0.4, 0], np.array([0, 1.0, 0]))
        camera = Camera(to_world=view, fov_x=30)
        color = exact(mi, world, ("environment",), path=still(camera), spp=1, height=4, width=4)
        assert (color > 0.05).all() if sign > 0 else (color == 0).all()


def test_sun_lights_a_floor_by_the_cosine_law_and_casts_a_sharp_shadow(mi):
    direction = np.array([1.0, -1.0, 0.0])
    wall = Piece(mesh=box([0, 0.5, 0], [0.02, 1.0, 2.0]), surface=Surface(color=(0.0,) * 3))
    world = World(
        label="t",
        pieces=[Piece(mesh=FLOOR, surface=GREY), wall],
        sun=Sun(direction=tuple(direction), irradiance=(3.0, 3.0, 3.0)),
    )
    camera = down(y=6.0, fov=30)
    color = exact(mi, world, ("sun",), path=still(camera), spp=16, height=21, width=41)[..., 0]
    lit = 0.5 / np.pi * 3.0 * np.cos(np.radians(45))
    assert np.median(color[:, :15]) == pytest.approx(lit, rel=0.02)
    for x, bright in ((0.5, False), (0.95, False), (1.1, True)):  # 1 m high, 45 degrees: 1 m long
        px, py, _ = camera.project(np.array([x, 0, 0]), 21, 41)
        assert (color[int(py), int(px)] > 0.8 * lit) == bright


def test_a_moving_light_moves_its_spot_by_its_own_displacement(mi):
    world = World(
        label="t",
        pieces=[Piece(mesh=FLOOR, surface=GREY)],
        lamps=[
            Lamp(mesh=sphere([-0.5, 0.4, 0], 0.05), radiance=(50,) * 3, around=True, group="lamp")
        ],
        swinging={"lamp": lambda time: translation([time, 0, 0])},
    )
    camera = down(y=6.0, fov=30)
    for names, place in (
        (("moving_light",), 0.5),
        (("moving_light", "soft_shadow"), 0.5),
        ((), -0.5),
    ):
        color = exact(mi, world, names, path=still(camera), spp=16, height=41, width=41)[..., 0]
        if "soft_shadow" in names:  # the lamp itself is in the picture: look at its column
            color = np.minimum(color, np.median(color) * 50)
        columns = color.sum(axis=0)
        middle = (columns * (np.arange(41) + 0.5)).sum() / columns.sum()
        x, _, _ = camera.project(np.array([place, 0, 0]), 41, 41)
        assert middle == pytest.approx(x, abs=2.5)


def test_a_moving_object_is_seen_where_it_is_at_that_frame(mi):
    world = World(
        label="t",
        pieces=[
            Piece(mesh=FLOOR, surface=GREY),
            Piece(
                mesh=box([0, 0.1, 0], [0.5, 0.2, 0.5]), surface=Surface(color=(0.9,) * 3), group="b"
            ),
        ],
        lamps=[Lamp(mesh=sphere([0, 5, 0], 0.1), radiance=(900,) * 3, around=True)],
        moving={"b": spinning([0, 1, 0], 0.0, [0.7, 0, 0])},
    )
    camera = down(y=6.0, fov=30)
    for names, place in ((("moving_object",), 0.7), ((), 0.0)):
        seen = noisy(mi, world, names, path=still(camera), height=41, width=41)
        bright = np.argwhere(seen["albedo"][..., 0] > 0.8)
        x, y, _ = camera.project(np.array([place, 0.2, 0]), 41, 41)
        np.testing.assert_allclose(bright.mean(axis=0) + 0.5, [y, x], atol=0.7)


@pytest.mark.parametrize(("distance", "focus"), [(4.0, 2.0), (2.0, 6.0), (4.0, 4.0)])
def test_depth_of_field_spreads_a_point_over_the_thin_lens_circle(mi, distance, focus):
    from stillray_training.simulate.camera import Camera, look_at

    size, fov, radius = 61, 40.0, 0.02
    point = Lamp(mesh=sphere([0, 0, -distance], radius), radiance=(500,) * 3, around=True)
    world = World(
        label="t",
        pieces=[Piece(mesh=sphere([0, -99, 0], 0.1), surface=GREY)],
        lamps=[point],
        lens=Lens(aperture=0.05),
    )
    camera = Camera(
        to_world=look_at(np.zeros(3), np.array([0, 0, -1.0]), np.array([0, 1.0, 0])), fov_x=fov
    )
    color = exact(
        mi,
        world,
        ("soft_shadow", "depth_of_field"),
        path=still(camera),
        focus=focus,
        spp=300,
        height=size,
        width=size,
    )[..., 0]
    focal = size / 2 / np.tan(np.radians(fov / 2))  # pixels
    aperture = 0.05 * focus  # metres
    expected = 2 * aperture * focal * abs(1 / distance - 1 / focus) + 2 * focal * radius / distance
    spread = np.flatnonzero(color.max(axis=0) > 0.0)
    assert spread[-1] - spread[0] + 1 == pytest.approx(expected, abs=2.0)


@pytest.mark.parametrize("shutter", [0.25, 1.0])
def test_motion_blur_draws_streaks_of_the_shutters_length(mi, shutter):
    size, radius, speed = 81, 0.03, 1.2  # speed in metres a frame
    world = World(
        label="t",
        pieces=[Piece(mesh=FLOOR, surface=Surface(color=(0.0,) * 3))],
        lamps=[
            Lamp(mesh=sphere([-speed, 0.5, 0], radius), radiance=(9,) * 3, around=True, group="l")
        ],
        swinging={"l": lambda time: translation([speed * time, 0, 0])},
        shutter=shutter,
    )
    camera = down(y=4.5, fov=40)
    names = ("soft_shadow", "moving_light", "motion_blur")
    color = exact(mi, world, names, path=still(camera), spp=256, height=size, width=size)[..., 0]
    metres = 2 * 4.0 * np.tan(np.radians(20)) / size  # at the lamp's height
    expected = (speed * shutter + 2 * radius) / metres
    lit = np.flatnonzero(color[size // 2 - 1 : size // 2 + 2].max(axis=0) > 0)
    assert lit[-1] - lit[0] + 1 == pytest.approx(expected, abs=2.0)
    assert (lit[-1] + lit[0] + 1) / 2 == pytest.approx(size / 2, abs=1.0)  # centred on the frame
    frozen = exact(mi, world, names[:2], path=still(camera), spp=4, height=size, width=size)[..., 0]
    assert (frozen.max(axis=0) > 0).sum() <= 2 * radius / metres + 2


def test_a_blurred_noisy_frame_is_unbiased(mi):
    # the mean of many noisy frames is the reference, although one frame has only a few times
    world = replace(everything(), shutter=1.0)
    names = ("moving_object", "motion_blur")
    stage = stage_of(mi, world, names, height=5, width=7)
    from stillray_training.simulate import buffers
    from tests.training.simulate_worlds import moment

    frames = [buffers.render_noisy(stage, moment(), spp=8, seed=k)["color"] for k in range(24)]
    reference = buffers.render_reference(stage, moment(), spp=1024, seed=99)
    error = np.std(frames, axis=0) / np.sqrt(len(frames)) + 0.004
    assert (np.abs(np.mean(frames, axis=0) - reference) < 5 * error).all()


@pytest.mark.parametrize("extinction", [0.1, 0.5])
def test_a_medium_that_only_absorbs_follows_beer_and_lambert(mi, extinction):
    panel = Lamp(mesh=quad([-3, -3, -2], [6, 0, 0], [0, 6, 0]), radiance=(4.0, 4.0, 4.0))
    world = World(
        label="t",
        pieces=[Piece(mesh=sphere([0, -99, 0], 0.1), surface=GREY)],
        lamps=[panel],
        fog=Fog(extinction=extinction, albedo=(0.0,) * 3),
    )
    from stillray_training.simulate.camera import Camera, look_at

    view = look_at(np.array([0, 0, 1.0]), np.zeros(3), np.array([0, 1.0, 0]))
    camera = still(Camera(to_world=view, fov_x=4))
    thick = exact(mi, world, ("soft_shadow", "medium"), path=camera, spp=600, height=5, width=5)
    assert thick.mean() == pytest.approx(4.0 * np.exp(-extinction * 3.0), rel=0.03)
    clear = exact(mi, world, ("soft_shadow",), path=camera, spp=1, height=5, width=5)
    np.testing.assert_allclose(clear, 4.0, rtol=1e-5)

"""The loop that renders references, against Mitsuba's own; pictures' scale in the meshes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mitsuba")

from stillray.training.simulate import stage as stage_module
from stillray.training.simulate import trace
from stillray.training.simulate.mesh import quad, sphere
from stillray.training.simulate.relay import relay_radiance
from stillray.training.simulate.stage import _unscaled
from stillray.training.simulate.textures import Texture
from stillray.training.simulate.variant import load_mitsuba
from stillray.training.simulate.world import Lamp, Piece, Surface, World
from tests.simulate_worlds import everything, exact, moment, noisy, stage_of

EFFECTS = ("soft_shadow", "texture", "glossy", "mirror_glass", "environment", "sun")


@pytest.fixture(scope="module")
def mi():
    mi, _ = load_mitsuba()
    if "scalar" in mi.variant():
        pytest.skip("the loop is for JIT variants: no LLVM of a version known to work")
    return mi


def glassy() -> World:
    """Everything, and a ball of glass: paths that hit lights through what has no smooth lobe."""
    world = everything()
    ball = Piece(
        mesh=sphere([0.3, 0.5, 1.6], 0.45, rings=12),
        surface=Surface(color=(1.0, 1.0, 1.0), special="glass"),
    )
    return replace(world, pieces=[*world.pieces, ball])


@pytest.mark.parametrize("depth", [2, None])
def test_it_is_the_estimator_of_mitsubas_own_loop(mi, depth):
    stage = stage_of(mi, glassy(), (*EFFECTS, "depth_of_field"), height=16, width=16, depth=depth)
    stage.aim(moment().path(1.0), 5.0)

    def blocks(image):
        return image.reshape(4, 4, 4, 4, 3).mean(axis=(1, 3))

    own = np.array([blocks(relay_radiance(stage, stage.sensor, 160, seed)) for seed in range(12)])
    their = np.array(
        [blocks(trace._radiance_jit(stage, stage.sensor, 160, 500 + seed)) for seed in range(12)]
    )
    error = np.sqrt((own.var(axis=0, ddof=1) + their.var(axis=0, ddof=1)) / 12) + 1e-6
    assert (np.abs(own.mean(axis=0) - their.mean(axis=0)) < 6 * error).all()
    whole = [part.mean(axis=(1, 2)) for part in (own, their)]
    error = np.sqrt(sum(part.var(axis=0, ddof=1) for part in whole) / 12) + 1e-6
    assert (np.abs(whole[0].mean(axis=0) - whole[1].mean(axis=0)) < 4.5 * error).all()


@pytest.mark.parametrize("spp", [1, 64, 65, 130])
def test_every_pixel_has_as_many_samples_as_asked_for(mi, spp):
    wall = Lamp(mesh=quad([-20, -20, 0], [40, 0, 0], [0, 40, 0]), radiance=(3.0, 2.0, 1.0))
    world = World(label="t", lamps=[wall])
    image = exact(mi, world, ("soft_shadow",), spp=spp, height=5, width=7)
    np.testing.assert_allclose(image, np.broadcast_to([3.0, 2.0, 1.0], (5, 7, 3)), rtol=1e-5)


def test_the_same_seed_gives_the_same_pixels_and_another_others(mi):
    first, again, other = (exact(mi, glassy(), EFFECTS, spp=70, seed=s) for s in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any(axis=-1).mean() > 0.9


def test_a_medium_goes_to_mitsubas_volumetric_loop(mi):
    clear, foggy = (
        exact(mi, everything(), ("soft_shadow", *more), spp=64).mean() for more in ((), ("medium",))
    )
    assert 0.2 * clear < foggy < 0.97 * clear


def test_pictures_lie_where_they_lay_before_their_scale_moved_into_the_mesh(mi, monkeypatch):
    worlds = []
    for _ in range(2):
        worlds.append(noisy(mi, everything(), ("texture", "glossy"), spp=4, guides=("roughness",)))
        monkeypatch.setattr(stage_module, "_unscaled", lambda node: (node, np.ones(2)))
    scaled, plain = worlds
    assert plain["albedo"].std() > 0.1
    for name in ("albedo", "roughness"):
        assert (np.abs(scaled[name] - plain[name]) < 1e-3).mean() > 0.99


def test_a_material_with_pictures_of_two_sizes_keeps_both(mi):
    def pictures(roughness_size):
        surface = Surface(
            color=(0.5,) * 3,
            metal=True,
            roughness=0.3,
            texture=Texture(kind="checker", seed=1, low=(0.1,) * 3, high=(0.9,) * 3, size=2.0),
            roughness_texture=Texture(
                kind="checker", seed=2, low=(0.1,) * 3, high=(0.5,) * 3, size=roughness_size
            ),
        )
        world = World(label="t", pieces=[Piece(mesh=sphere([0, 0, 0], 1), surface=surface)])
        lamp = Lamp(mesh=sphere([0, 3, 0], 0.1), radiance=(9,) * 3, around=True)
        stage = stage_of(mi, replace(world, lamps=[lamp]), ("texture", "glossy"))
        (node,) = stage.plan.materials.values()
        return _unscaled(node)

    node, scale = pictures(2.0)
    assert not any("to_uv" in n.params for n in node.walk())
    np.testing.assert_array_equal(scale, [0.5, 0.5])
    node, scale = pictures(0.5)
    assert sorted(n.params["to_uv"][0, 0] for n in node.walk() if "to_uv" in n.params) == [0.5, 2.0]
    np.testing.assert_array_equal(scale, [1, 1])

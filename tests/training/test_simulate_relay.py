"""The loop that renders references, against Mitsuba's own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mitsuba")

from stillray_training.simulate import trace
from stillray_training.simulate.mesh import quad, sphere
from stillray_training.simulate.relay import relay_radiance
from stillray_training.simulate.variant import load_mitsuba
from stillray_training.simulate.world import Lamp, Piece, Surface, World
from tests.training.simulate_worlds import FRONT, everything, exact, moment, stage_of

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

    own = np.array(
        [blocks(relay_radiance(stage, stage.sensor, 160, seed, 1 << 22)) for seed in range(12)]
    )
    their = np.array(
        [blocks(trace.radiance_jit(stage, stage.sensor, 160, 500 + seed)) for seed in range(12)]
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
        exact(mi, everything(), ("soft_shadow", *more), spp=64) for more in ((), ("medium",))
    )
    empty = (clear == 0).all(axis=-1)
    assert empty.mean() > 0.1
    assert (foggy[empty] > 0).any(axis=-1).mean() > 0.9  # the air shines


def test_bounded_light_is_alike_in_frames_and_references(mi):
    # one stage, one bound: the mean of many noisy samples is the reference
    stage = stage_of(mi, glassy(), EFFECTS, height=16, width=16)
    shot = trace.Shot(time=1.0, camera=FRONT, previous=FRONT, jitter=np.zeros(2), clamp=0.05)
    stage.aim(FRONT, 5.0)
    pixels = np.arange(256)
    own = np.array(
        [trace.first_hits(stage, shot, pixels, seed, 64)["color"] / 64 for seed in range(12)]
    )
    other = np.array(
        [relay_radiance(stage, stage.sensor, 64, 90 + seed, 1 << 22, 0.05) for seed in range(12)]
    ).reshape(own.shape)
    means = [part.mean(axis=1) for part in (own, other)]
    error = np.sqrt(sum(part.var(axis=0, ddof=1) for part in means) / 12) + 1e-6
    assert (np.abs(means[0].mean(axis=0) - means[1].mean(axis=0)) < 4.5 * error).all()
    free = relay_radiance(stage, stage.sensor, 64, 5, 1 << 22).mean()
    assert other.mean() < 0.99 * free  # and the bound takes some of it


def test_direct_light_is_not_bounded(mi):
    wall = Lamp(mesh=quad([-20, -20, 0], [40, 0, 0], [0, 40, 0]), radiance=(3.0, 2.0, 1.0))
    stage = stage_of(mi, World(label="t", lamps=[wall]), ("soft_shadow",), height=4, width=4)
    stage.aim(FRONT, 5.0)
    image = relay_radiance(stage, stage.sensor, 4, 1, 1 << 22, 1e-3)
    np.testing.assert_allclose(image, np.broadcast_to([3.0, 2.0, 1.0], image.shape), rtol=1e-5)

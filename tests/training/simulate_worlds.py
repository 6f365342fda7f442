"""Small hand-made scenes for the simulator's tests, and rendering them in one call."""

from __future__ import annotations

import numpy as np
import pytest

from stillray_training.simulate import buffers
from stillray_training.simulate.camera import Camera, look_at
from stillray_training.simulate.mesh import box, quad, rotation, sphere, translation
from stillray_training.simulate.plan import Wants, make_plan
from stillray_training.simulate.stage import Stage
from stillray_training.simulate.textures import Relief, Texture
from stillray_training.simulate.variant import bound_llvm, load_mitsuba
from stillray_training.simulate.world import Fog, Lamp, Lens, Piece, Sky, Sun, Surface, World

HEIGHT, WIDTH = 17, 23
GREY = Surface(color=(0.5, 0.5, 0.5))
FRONT = Camera(
    to_world=look_at(np.array([0, 1.2, 5.0]), np.array([0, 0.6, 0]), np.array([0, 1.0, 0])),
    fov_x=50,
)


def opened(name: str):
    """Mitsuba under a variant; without an LLVM known to work the test is skipped, not ended."""
    if name.startswith("llvm") and bound_llvm() is None:
        pytest.skip("no LLVM of a version known to work")
    return load_mitsuba(name)[0]


def everything() -> World:
    """A floor, a ball, a box, a mirror, a lamp: a scene that could show every effect."""
    wood = Surface(
        color=(0.5, 0.4, 0.3),
        texture=Texture(
            kind="checker", seed=1, low=(0.1, 0.1, 0.1), high=(0.9, 0.8, 0.7), size=2.0
        ),
        roughness=0.2,
        relief=Relief(
            picture=Texture(kind="tiles", seed=2, low=(0,) * 3, high=(1,) * 3, size=2.0), depth=0.05
        ),
    )
    return World(
        label="everything",
        pieces=[
            Piece(mesh=quad([-3, 0, 3], [6, 0, 0], [0, 0, -6]), surface=wood),
            Piece(mesh=sphere([-0.6, 0.5, 0.5], 0.5, rings=8), surface=GREY, group="ball"),
            Piece(mesh=box([0.9, 0.5, 0], [0.7, 1.0, 0.7]), surface=GREY),
            Piece(
                mesh=quad([-1, 0.3, -1.5], [2, 0, 0], [0, 1.5, 0]),
                surface=Surface(color=(0.9, 0.9, 0.9), special="mirror"),
            ),
        ],
        lamps=[
            Lamp(
                mesh=sphere([1, 3, 2], 0.3, rings=6), radiance=(9, 9, 8), around=True, group="lamp"
            )
        ],
        sky=Sky(kind="cloudy", seed=2, radiance=0.4),
        sun=Sun(direction=(0.4, -1.0, -0.3), irradiance=(2, 2, 2)),
        fog=Fog(extinction=0.1),
        lens=Lens(aperture=0.05),
        moving={"ball": lambda time: translation([0.2 * time, 0, 0])},
        swinging={"lamp": lambda time: translation([-0.5 * time, 0, 0])},
        space=(np.array([-2.0, 0.5, 2.0]), np.array([2.0, 2.0, 4.0])),
        gaze=(np.array([-1.0, 0.0, -1.0]), np.array([1.0, 1.0, 1.0])),
    )  # fmt: skip


def spinning(axis: list[float], degrees: float, step: list[float]):
    """A motion that turns about an axis through the origin and moves on."""
    return lambda time: translation(np.array(step) * time) @ rotation(axis, degrees * time)


def stage_of(
    mi, world: World, effects=(), *, height: int = HEIGHT, width: int = WIDTH, **wants
) -> Stage:
    return Stage(mi, make_plan(world, effects, Wants(**wants)), height, width)


def still(camera: Camera):
    return lambda time: camera


def moment(path=None, *, frame: int = 1, focus: float = 5.0, jitter=(0.0, 0.0)) -> buffers.Moment:
    return buffers.Moment(
        frame=frame, path=path or still(FRONT), focus=focus, jitter=np.array(jitter)
    )


def noisy(mi, world: World, effects=(), *, path=None, spp: int = 1, seed: int = 3, **options):
    """One noisy frame of a world."""
    return buffers.render_noisy(
        stage_of(mi, world, effects, **options), moment(path), spp=spp, seed=seed
    )


def exact(
    mi, world: World, effects=(), *, path=None, focus=5.0, spp: int = 64, seed: int = 3, **options
):
    """A reference of a world."""
    stage = stage_of(mi, world, effects, **options)
    return buffers.render_reference(stage, moment(path, focus=focus), spp=spp, seed=seed)

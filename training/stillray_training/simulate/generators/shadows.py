"""Things that move over plain floors and before plain walls, and the shadows they cast there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillray_training.simulate.assets import Library
from stillray_training.simulate.effects import check_names
from stillray_training.simulate.generators import furniture
from stillray_training.simulate.generators.build import lift
from stillray_training.simulate.generators.finish import finish
from stillray_training.simulate.generators.home import Home, of_home
from stillray_training.simulate.generators.lights import sunlight
from stillray_training.simulate.generators.openings import railing, wire_chair
from stillray_training.simulate.generators.sunlit import soft_box
from stillray_training.simulate.generators.things import thing
from stillray_training.simulate.mesh import box, quad, rotation, sphere, translation
from stillray_training.simulate.world import Motion, Sky, Surface, World

KEY = "key"  # group of the light that may be carried
_WIDE = 5.0  # of the floor each way from the origin, metres


def shadows(seed: int, library: Library | None = None) -> World:
    """A seeded stage around the origin: plain floor and wall, two to five things, all on paths."""
    b = Home([seed, 23], library)
    plain = b.chance(0.7)
    ground = Surface(color=b.color(light=b.between(0.2, 0.7))) if plain else b.planks()
    b.add(quad([-_WIDE, 0, _WIDE], [2 * _WIDE, 0, 0], [0, 0, -2 * _WIDE]), ground)
    back = Surface(color=b.off_white()) if b.chance(0.6) else b.wall()
    depth = b.between(0.8, 2.2)
    b.add(quad([-_WIDE, 0, -depth], [2 * _WIDE, 0, 0], [0, 3.2, 0]), back)
    side = 1 if b.chance(0.5) else -1  # of the light: shadows fall where cameras see them
    if b.chance(0.4):
        x = -side * b.between(1.5, 2.5)
        b.add(quad([x, 0, side * _WIDE], [0, 0, -2 * side * _WIDE], [0, 3.2, 0]), back)
    for _ in range(int(b.rng.integers(3, 7))):
        spot = b.place([-1.0, -0.6 * depth], [1.0, 0.8], 0.3)
        if spot is not None:
            _stands(b, lift(spot[0], 0, spot[1]) @ rotation([0, 1, 0], b.between(0, 360)))
    if b.chance(0.25):
        railing(b, lift(-1.5, 0, -0.6 * depth), 3.0, 0.9)
    style = b.pick("box", "sun", "both", p=[0.5, 0.3, 0.2])
    if style != "sun":
        power = b.between(100, 350)
        soft_box(b, side * b.between(30, 85), b.between(20, 60), b.between(0.2, 1.1), power, KEY)
        if b.chance(0.35):
            soft_box(b, b.between(-75, 75), b.between(25, 70), b.between(0.8, 1.6), 0.6 * power)
    kind = b.pick("clear", "cloudy", "studio")
    sky = Sky(kind=kind, seed=int(b.rng.integers(2**31)), radiance=b.between(0.06, 0.5))
    sun = sunlight(b, np.array([side, 0, b.between(0.0, 0.8)]), spread=25)
    ratio = sky.radiance * b.between(8, 30) / float(np.mean(sun.irradiance))
    sun = replace(sun, irradiance=tuple(ratio * v for v in sun.irradiance))  # type: ignore[arg-type]
    world = finish(
        b, "shadows", daylight=True, sky=sky, sun=sun,
        space=(np.array([-2.2, 0.4, 1.6]), np.array([2.2, 2.0, 3.6])),
        gaze=(np.array([-0.6, 0.0, -0.5]), np.array([0.6, 0.6, 0.5])),
    )  # fmt: skip
    moving, swinging = _paths(b), _carried(b)
    left_out = ["medium", "moving_light"] + (["sun"] if style == "box" else [])
    world = of_home(b, world, without=tuple(left_out))
    also = {"moving_object"} | ({"moving_light"} if swinging else set())
    also |= {"sun"} if style != "box" else set()
    effects = check_names({*world.effects, *also})
    return replace(world, moving=moving, swinging=swinging, effects=effects)


def _stands(b: Home, at: np.ndarray) -> None:
    """One thing on the floor."""
    kind = b.pick(
        "chair", "wire", "box", "ball", "thing", "asset", p=[0.15, 0.12, 0.18, 0.12, 0.13, 0.3]
    )
    if kind == "asset" and b.library is not None:
        kinds = ("clutter", "figure", "furniture", "vehicle", "plant")
        names = [name for kind in kinds for name in b.library.kind(kind)]
        names = [name for name in names if 0.15 < b.library.get(name).size.max() < 1.25]
        asset = b.library.get(str(b.rng.choice(names)))
        scale = max(1.0, b.between(0.35, 0.8) / float(asset.size.max()))
        b.place_asset(asset, at, np.ones(3) * scale)
        return
    group = f"{kind}{len(b.spots)}"
    if kind == "chair":
        furniture.chair(b, at)
    elif kind == "wire":
        wire_chair(b, at)
    elif kind == "thing":
        thing(b, at, scale=b.between(1.5, 3.0))
    elif kind == "ball":
        radius = b.between(0.1, 0.35)
        surface = b.plain(b.color(vivid=True))
        b.add(
            sphere([0, radius, 0], radius, rings=20),
            surface,
            at=at,
            group=b.can_move(group, at, "floor"),
        )
    else:
        w, h, d = b.rng.uniform([0.15, 0.15, 0.15], [0.6, 0.9, 0.6])
        surface = b.plain() if b.chance(0.6) else b.wood()
        b.add(box([0, h / 2, 0], [w, h, d]), surface, at=at, group=b.can_move(group, at, "floor"))


def _paths(b: Home) -> dict[str, Motion]:
    """Straight and turning paths for one to three things, slow to fast: 4 mm to 9 cm a frame."""
    moving: dict[str, Motion] = {}
    for index in b.rng.permutation(len(b.spots))[: int(b.rng.integers(1, 4))]:
        spot = b.spots[index]
        heading, speed = (
            b.between(0, 2 * np.pi),
            float(np.exp(b.between(np.log(0.004), np.log(0.09)))),
        )
        step = speed * np.array([np.cos(heading), 0.0, np.sin(heading)])
        spin = float(b.rng.normal() * 4) if b.chance(0.5) else 0.0
        moving[spot.group] = _path(spot.centre, step, spin)
    return moving


def _path(centre: np.ndarray, step: np.ndarray, spin: float) -> Motion:
    def pose(time: float) -> np.ndarray:
        return (
            translation(centre + step * time)
            @ rotation([0, 1, 0], spin * time)
            @ translation(-centre)
        )

    return pose


def _carried(b: Home) -> dict[str, Motion]:
    """In a third of the scenes that have one, the key light is carried along a line."""
    if not any(lamp.group == KEY for lamp in b.lamps) or not b.chance(0.35):
        return {}
    step = b.rng.normal(size=3) * b.between(0.01, 0.06)
    return {KEY: lambda time: translation(step * time)}

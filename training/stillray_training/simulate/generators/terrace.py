"""Outdoors before a house: sun between slats, paving, shutters, railings, foliage, sky."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillray_training.simulate.assets import Library
from stillray_training.simulate.generators import furniture
from stillray_training.simulate.generators.build import lift
from stillray_training.simulate.generators.finish import finish
from stillray_training.simulate.generators.home import Home, of_home
from stillray_training.simulate.generators.lights import sunlight
from stillray_training.simulate.generators.openings import (
    opening,
    panelled_door,
    railing,
    wire_chair,
)
from stillray_training.simulate.generators.plants import plant
from stillray_training.simulate.generators.shell import THICK, Wall, pierced
from stillray_training.simulate.mesh import box, join, quad, rotation, translation
from stillray_training.simulate.world import Sky, Surface, World

_WIDE = 16.0  # of the facade, metres
_FRONT = -1.6  # its z
_GREENS = ("bush", "tree_a", "meadow_patch", "fern", "tall_plant")


def terrace(seed: int, library: Library | None = None) -> World:
    """A seeded terrace around the origin; the facade is behind it, facing +z."""
    b = Home([seed, 24], library)
    _ground(b)
    _facade(b)
    _furnish(b)
    if b.chance(0.4):
        _pergola(b)
    if b.chance(0.5):
        railing(b, lift(-3.0, 0, b.between(1.4, 2.0)), 6.0, 0.95)
    _greens(b)
    kind = b.pick("clear", "cloudy", p=[0.75, 0.25])
    sky = Sky(kind=kind, seed=int(b.rng.integers(2**31)), radiance=b.between(2, 6))
    sun = sunlight(b, np.array([b.rng.normal() * 0.8, 0, 1.0]), spread=40)
    ratio = sky.radiance * b.between(3, 12) / float(np.mean(sun.irradiance))
    sun = replace(sun, irradiance=tuple(ratio * v for v in sun.irradiance))  # type: ignore[arg-type]
    world = finish(
        b, "terrace", daylight=True, sky=sky, sun=sun,
        space=(np.array([-2.4, 0.7, 1.0]), np.array([2.4, 1.9, 3.6])),
        gaze=(np.array([-1.3, 0.1, -1.6]), np.array([1.3, 1.5, 0.4])),
    )  # fmt: skip
    return of_home(b, world, without=("medium",))


def _ground(b: Home) -> None:
    style = b.pick("stone", "boards", "gravel", p=[0.5, 0.3, 0.2])
    surface = {"stone": b.stone, "boards": b.planks, "gravel": b.carpet}[style]()
    b.add(quad([-_WIDE, 0, _WIDE], [2 * _WIDE, 0, 0], [0, 0, -2 * _WIDE]), surface)


def _facade(b: Home) -> None:
    """A wall with windows, perhaps a door, dark behind."""
    high = b.between(3.0, 6.0)
    wall = Wall(frame=translation([-_WIDE / 2, 0, _FRONT]), length=_WIDE, height=high)
    count = int(b.rng.integers(4, 8))
    each = _WIDE / count
    bottom = 0.05 if b.chance(0.3) else b.between(0.7, 1.1)
    entrance = int(b.rng.integers(count // 2 - 1, count // 2 + 1))
    for i in range(count):
        middle, half = (i + 0.5) * each, b.between(0.25, 0.38) * each
        if i != entrance:
            wall.holes.append((middle - half, bottom, middle + half, min(2.5, high - 0.3)))
    b.add(pierced(wall), b.wall())
    for hole in wall.holes:
        opening(b, wall, hole)
    panelled_door(b, wall, (entrance + 0.5) * each)
    inside = Surface(color=b.color(light=0.06))
    b.block([_WIDE / 2, high / 2, -THICK - 0.7], [_WIDE, high, 0.9], inside, at=wall.frame)


def _furnish(b: Home) -> None:
    at = lift(b.between(-0.6, 0.6), 0, b.between(-0.6, 0.1)) @ rotation(
        [0, 1, 0], b.between(-40, 40)
    )
    b.take(at[0, 3], at[2, 3], 0.7)
    wide = b.between(0.8, 1.4)
    furniture.table(b, at, wide, b.between(0.7, 0.9), 0.73, int(b.rng.integers(1, 6)))
    for turn in b.rng.permutation([0, 90, 180, 270])[: int(b.rng.integers(1, 5))]:
        chair = wire_chair if b.chance(0.4) else furniture.chair
        spin = rotation([0, 1, 0], float(turn) + b.between(-20, 20))
        chair(b, at @ spin @ lift(0, 0, -0.55 - 0.3 * wide))


def _pergola(b: Home) -> None:
    """Slats overhead that let the sun through in stripes."""
    step, high = b.between(0.1, 0.35), b.between(2.3, 2.7)
    wood = b.wood()
    slats = [box([x, high, 0.2], [0.03, 0.1, 3.6]) for x in np.arange(-3.0, 3.0, step)]
    slats += [box([0, high - 0.12, z], [6.2, 0.14, 0.08]) for z in (-1.3, 1.8)]
    slats += [box([x, high / 2, 1.8], [0.09, high, 0.09]) for x in (-2.9, 2.9)]
    b.add(join(slats), wood)


def _greens(b: Home) -> None:
    """Plants in pots, and what grows in a library, to the sides and behind the terrace's edge."""
    for _ in range(int(b.rng.integers(1, 5))):
        spot = b.place([-2.6, _FRONT + 0.5], [2.6, 1.0], 0.4)
        if spot is not None:
            plant(b, lift(spot[0], 0, spot[1]), b.between(0.4, 1.3))
    names = [n for n in _GREENS if b.library is not None and n in b.library]
    if b.library is None or not names:
        return
    for _ in range(int(b.rng.integers(1, 5))):
        asset = b.library.get(str(b.rng.choice(names)))
        far = float(asset.size[[0, 2]].max()) / 2
        side = (1.6 + far) * (1 if b.chance(0.5) else -1)
        at = lift(side + b.between(-0.4, 0.4), 0, max(_FRONT + far, b.between(-1.0, 0.8)))
        b.place_asset(asset, at @ rotation([0, 1, 0], b.between(0, 360)), np.ones(3), "")

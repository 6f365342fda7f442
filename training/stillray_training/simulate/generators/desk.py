"""Close to a table by a window: clutter, thin things, glossy wood under glare, striped shadows."""

from __future__ import annotations

import numpy as np

from stillray_training.simulate.assets import Library
from stillray_training.simulate.generators import furniture
from stillray_training.simulate.generators.build import lift
from stillray_training.simulate.generators.finish import finish
from stillray_training.simulate.generators.home import Home, of_home
from stillray_training.simulate.generators.openings import opening, wire_chair
from stillray_training.simulate.generators.shell import floor_and_ceiling, pierced, walls
from stillray_training.simulate.generators.sunlit import ceiling_light, daylight
from stillray_training.simulate.generators.things import things
from stillray_training.simulate.mesh import box, cylinder, join, rotation
from stillray_training.simulate.world import Surface, World

_HIGH = 0.74  # of the table top, metres


def desk(seed: int, library: Library | None = None) -> World:
    """A seeded table in a small room; its window is in the wall on the right."""
    b = Home([seed, 22], library)
    size = b.rng.uniform([2.8, 2.4, 2.8], [4.2, 2.9, 4.2])
    sides = walls(size)
    window = sides[1]
    middle, half = window.length * b.between(0.35, 0.65), b.between(0.6, 1.2)
    left, right = max(0.1, middle - half), min(window.length - 0.1, middle + half)
    window.holes.append((left, b.between(0.6, 0.95), right, window.height - 0.25))
    wall = b.wall()
    for side in sides:
        b.add(pierced(side), wall)
        for hole in side.holes:
            opening(b, side, hole)
    floor_and_ceiling(b, size, b.planks(), Surface(color=b.off_white()))
    w, d = b.between(1.0, 1.5), b.between(0.7, 0.95)
    at = lift(size[0] / 2 - b.between(0.5, 0.9), 0, (middle - window.length / 2))
    at = at @ rotation([0, 1, 0], b.between(-100, 100))
    top = [b.wood(), b.stone(gloss=0.9), b.planks(), b.plain(b.color(light=0.5), gloss=0.9)]
    surface = top[b.rng.choice(4, p=[0.45, 0.2, 0.2, 0.15])]
    b.add(box([0, _HIGH - 0.02, 0], [w, 0.04, d]), surface, at=at)
    legs = [cylinder([x * (w / 2 - 0.06), 0, z * (d / 2 - 0.06)], 0.025, _HIGH - 0.04)
            for x in (-1, 1) for z in (-1, 1)]  # fmt: skip
    b.add(join(legs), b.metal(), at=at)
    things(b, at @ lift(0, _HIGH + 0.001, 0), w, d, int(b.rng.integers(4, 13)))
    chair = wire_chair if b.chance(0.5) else furniture.chair
    chair(b, at @ lift(0, 0, d / 2 + 0.1) @ rotation([0, 1, 0], 180 + b.between(-30, 30)))
    for side in (sides[0], sides[2], sides[3]):
        if b.chance(0.6):
            spot = side.spot(b.between(0.8, side.length - 0.8), 1.5, 0.005)
            furniture.picture(b, spot, b.between(0.3, 0.9), b.between(0.3, 0.7))
    sky, sun, outside = daylight(b, sides)
    ceiling_light(b, size, always=not outside and not any(lamp.window for lamp in b.lamps))
    x, _, z = at[:3, 3]
    low = np.maximum([x - 1.1, _HIGH + 0.12, z - 1.1], [-size[0] / 2 + 0.2, 0, -size[2] / 2 + 0.2])
    high = np.minimum([x + 0.8, 1.5, z + 1.1], [size[0] / 2 - 0.2, 9, size[2] / 2 - 0.2])
    gaze = (np.array([x - 0.3, _HIGH - 0.05, z - 0.3]), np.array([x + 0.3, _HIGH + 0.15, z + 0.3]))
    world = finish(b, "desk", daylight=outside, sky=sky, sun=sun, space=(low, high), gaze=gaze)
    return of_home(b, world, without=("medium",))

"""Corridors: long, with doors, a row of lamps, columns, pipes, a runner, a window at the end."""

from __future__ import annotations

import numpy as np

from stillray_training.simulate.generators import furniture, lamps
from stillray_training.simulate.generators.build import Builder, lift
from stillray_training.simulate.generators.finish import finish
from stillray_training.simulate.generators.lights import daylight
from stillray_training.simulate.generators.plants import plant
from stillray_training.simulate.generators.shell import (
    column,
    door,
    floor_and_ceiling,
    pierced,
    skirting,
    walls,
    window,
)
from stillray_training.simulate.mesh import quad, tube
from stillray_training.simulate.world import Surface, World


def corridor(seed: int) -> World:
    """A seeded corridor along z."""
    b = Builder([seed, 12])
    size = b.rng.uniform([1.6, 2.4, 8.0], [3.6, 4.0, 16.0])
    x, y, z = size[0] / 2, float(size[1]), size[2] / 2
    sides = walls(size)
    back, right, _, left = sides
    back.holes.append((size[0] * 0.25, 0.9, size[0] * 0.75, y - 0.4))
    if b.chance(0.5):
        step = b.between(1.6, 3.0)
        for s in np.arange(step / 2, right.length - 0.7, step):
            right.holes.append((s - 0.35 * step, b.between(0.4, 0.9), s + 0.35 * step, y - 0.4))
    wall = b.stone(gloss=0.3) if b.chance(0.2) else b.wall()
    for side in sides:
        b.add(pierced(side), wall)
        for hole in side.holes:
            window(b, side, hole, panes=b.chance(0.3))
    floor = b.stone(gloss=0.8) if b.chance(0.5) else b.planks()
    floor_and_ceiling(b, size, floor, Surface(color=b.color(light=0.8)))
    if b.chance(0.7):
        skirting(b, sides)
    step = b.between(1.8, 3.2)
    for s in np.arange(1.0, left.length - 1.0, step):
        if b.chance(0.7):
            door(b, left, s)
        elif b.chance(0.7):
            furniture.picture(b, left.spot(s, 1.6, 0.005), b.between(0.4, 1.0), b.between(0.4, 0.8))
        if right.clear(s - 0.6, s + 0.6, 0, 2.2):
            _side(b, right.spot(s, 0, 0.02))
    if b.chance(0.5):
        w = size[0] * b.between(0.4, 0.7)
        b.add(quad([-w / 2, 0.006, z - 0.5], [w, 0, 0], [0, 0, -2 * z + 1]), b.fabric())
    if b.chance(0.35):
        for s in np.arange(-z + 1, z - 0.5, b.between(2, 3.5)):
            for side in (-x + 0.2, x - 0.2):
                column(b, lift(side, 0, s), 0.13, y)
    if b.chance(0.4):
        for k in range(int(b.rng.integers(1, 5))):
            at = [-x + 0.1 + 0.09 * k, y - 0.12]
            line = np.array([[*at, -z], [*at, 0], [*at, z]])
            b.add(
                tube(line, b.between(0.015, 0.04), sides=12),
                b.metal() if b.chance(0.5) else b.plain(),
            )
    _lights(b, size)
    sky, sun, day = daylight(b, sides)
    return finish(
        b,
        "corridor",
        sky=sky,
        sun=sun,
        daylight=day,
        space=(
            np.array([-x + 0.35, 0.7, -z + 1.0]),
            np.array([x - 0.35, min(y - 0.4, 2.1), z - 0.3]),
        ),
        gaze=(np.array([-x, 0.4, -z]), np.array([x, 1.8, z])),
    )


def _side(b: Builder, at: np.ndarray) -> None:
    kind = b.pick("cabinet", "plant", "chair", "picture", "mirror", "nothing")
    if kind == "cabinet":
        furniture.cabinet(b, at, b.between(0.5, 1.0), b.between(0.6, 0.9), 0.3, clutter=3)
    elif kind == "plant":
        plant(b, at @ lift(0, 0, 0.25), b.between(0.4, 1.0))
    elif kind == "chair":
        furniture.chair(b, at @ lift(0, 0, 0.08))
    elif kind == "picture":
        furniture.picture(b, at @ lift(0, 1.6, 0), b.between(0.3, 0.9), b.between(0.3, 0.7))
    elif kind == "mirror":
        furniture.mirror(b, at @ lift(0, 1.5, 0), b.between(0.4, 0.7), b.between(0.6, 1.2))


def _lights(b: Builder, size: np.ndarray) -> None:
    y, z = size[1], size[2] / 2
    style = b.pick("panels", "pendants", "spots", "fairy", p=[0.35, 0.35, 0.15, 0.15])
    step = b.between(1.8, 4.0)
    lit = 0
    for s in np.arange(-z + 0.8, z, step):
        if lit and b.chance(0.3):
            continue  # one is out
        lit += 1
        if style == "panels":
            lamps.panel(b, lift(0, y, s), 0.2, 1.1, b.between(5, 30))
        elif style == "pendants":
            lamps.pendant(b, lift(0, y, s), b.between(0.2, 0.7), b.between(5, 40))
        elif style == "spots":
            lamps.spots(b, lift(0, y, s), size[0] * 0.6, b.between(10, 40))
    if style == "fairy":
        for side in (-0.4, 0.4):
            start, end = (
                np.array([side * size[0], y - 0.2, -z]),
                np.array([side * size[0], y - 0.2, z]),
            )
            lamps.fairy_lights(b, start, end, b.between(20, 80))

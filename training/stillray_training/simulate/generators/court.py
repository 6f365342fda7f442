"""Outdoor courts: facades, trees, fences, benches, under a sky."""

from __future__ import annotations

import numpy as np

from stillray_training.simulate.generators import furniture, lamps
from stillray_training.simulate.generators.build import Builder, lift
from stillray_training.simulate.generators.finish import finish
from stillray_training.simulate.generators.lights import sunlight
from stillray_training.simulate.generators.plants import plant, tree
from stillray_training.simulate.generators.shell import column, door, pierced, walls, window
from stillray_training.simulate.generators.things import thing
from stillray_training.simulate.mesh import box, cylinder, join, rotation, sheet, tube
from stillray_training.simulate.textures import noise
from stillray_training.simulate.world import Sky, Surface, World


def court(seed: int) -> World:
    """A seeded court, around x = z = 0."""
    b = Builder([seed, 13])
    size = b.rng.uniform([8, 4, 8], [14, 9, 14])
    x, z = size[0] / 2, size[2] / 2
    _ground(b)
    for side in [walls(size)[i] for i in b.rng.permutation(4)[: int(b.rng.integers(1, 4))]]:
        storeys = max(1, int(side.height // 3))
        step = b.between(1.8, 3.0)
        for floor in range(storeys):
            for s in np.arange(step / 2, side.length - 0.8, step):
                base = 3.0 * floor + 0.9
                side.holes.append((s - 0.5, base, s + 0.5, min(base + 1.5, side.height - 0.2)))
        b.add(pierced(side), b.wall() if b.chance(0.5) else b.stone(gloss=0.1))
        dark = Surface(color=(0.03, 0.035, 0.04), roughness=0.05)
        for hole in side.holes:
            le, bo, r, t = hole
            window(b, side, hole, panes=False)
            b.block(
                [(le + r) / 2, (bo + t) / 2, -0.35],
                [r - le + 0.1, t - bo + 0.1, 0.1],
                dark,
                at=side.frame,
            )
        if side.clear(0.2, 1.4, 0, 2.2):
            door(b, side, 0.8)
        if b.chance(0.4):
            for s in np.arange(0.5, side.length, b.between(1.5, 2.6)):
                column(b, side.spot(s, 0, 1.5), 0.15, 2.8)
            middle = [side.length / 2, 2.9, 0.8]
            b.block(middle, [side.length, 0.2, 1.8], b.wood(), at=side.frame)
    for _ in range(int(b.rng.integers(1, 6))):
        spot = b.place([-x + 1, -z + 1], [x - 1, z - 1], 1.0)
        if spot:
            tree(b, lift(spot[0], 0, spot[1]), b.between(2.5, 6.0))
    for _ in range(int(b.rng.integers(2, 8))):
        spot = b.place([-x + 0.7, -z + 0.7], [x - 0.7, z - 0.7], 0.7)
        if spot:
            _stand(b, lift(spot[0], 0, spot[1]) @ rotation([0, 1, 0], b.between(0, 360)))
    if b.chance(0.6):
        _fence(b, x, z)
    for _ in range(int(b.rng.integers(0, 3))):
        a, c = b.rng.uniform([-x, 3, -z], [x, 4, z]), b.rng.uniform([-x, 3, -z], [x, 4, z])
        t = np.linspace(0, 1, 20)[:, None]
        b.add(
            tube(a + (c - a) * t - [0, 0.4, 0] * np.sin(np.pi * t), 0.008, sides=6),
            b.plain((0.03,) * 3),
        )
    if b.chance(0.25):
        lamps.fairy_lights(b, np.array([-x, 3.0, 0]), np.array([x, 3.0, 0]), 60)
    kind = b.pick("clear", "cloudy", "dusk", "night", p=[0.5, 0.25, 0.15, 0.1])
    bright = {"clear": 1.0, "cloudy": 1.2, "dusk": 0.4, "night": 0.02}[kind]
    sky = Sky(kind=kind, seed=int(b.rng.integers(2**31)), radiance=bright)
    sun = sunlight(b, b.rng.normal(size=3), spread=180) if kind in ("clear", "dusk") else None
    if sun:
        from dataclasses import replace

        sun = replace(sun, irradiance=tuple(0.12 * v for v in sun.irradiance))  # type: ignore[arg-type]
    for _ in range(int(b.rng.integers(1, 4))):
        _post(b, lift(*b.rng.uniform([-x, 0, -z], [x, 0, z]) * [0.9, 0, 0.9]))
    return finish(
        b,
        "court",
        sky=sky,
        sun=sun,
        daylight=True,
        space=(np.array([-x + 0.5, 0.8, -z + 0.5]), np.array([x - 0.5, 2.6, z - 0.5])),
        gaze=(np.array([-x, 0.3, -z]), np.array([x, 2.5, z])),
    )


def _ground(b: Builder) -> None:
    relief = 0.05 * sum(noise(b.rng, 64, 4 * 2**i) / 2**i for i in range(3))
    relief = relief - relief.max()
    surface = b.stone(gloss=0.2)
    if b.chance(0.35):
        surface = Surface(
            color=(0.12, 0.2, 0.05),
            texture=b.texture("noise", (0.05, 0.1, 0.02), (0.2, 0.3, 0.08), 1.5),
        )
    lay = lift(-15, 0, 15) @ rotation([1, 0, 0], -90)
    b.add(sheet(relief, 30, 30), surface, at=lay)
    if b.chance(0.3):  # after rain
        from stillray_training.simulate.mesh import cylinder

        for _ in range(int(b.rng.integers(1, 5))):
            spot = b.rng.uniform([-4, 0, -4], [4, 0, 4])
            puddle = cylinder([*spot[:1], -0.02, spot[2]], b.between(0.3, 1.0), 0.022, segments=40)
            b.add(puddle, Surface(color=(0.05, 0.05, 0.055), roughness=0.03))


def _stand(b: Builder, at: np.ndarray) -> None:
    kind = b.pick("bench", "table", "pot", "crates", "thing", "bollards")
    if kind == "bench":
        boards = [box([0, 0.45, 0.1 * i], [1.6, 0.03, 0.08]) for i in range(4)]
        boards += [box([0, 0.6 + 0.13 * i, -0.06 - 0.03 * i], [1.6, 0.09, 0.025]) for i in range(3)]
        b.add(join(boards), b.wood(), at=at)
        b.add(
            join([box([s, 0.22, 0.15], [0.06, 0.44, 0.4]) for s in (-0.6, 0.6)]), b.metal(), at=at
        )
    elif kind == "table":
        furniture.table(b, at, 0.9, 0.9, 0.74, int(b.rng.integers(2, 6)))
        for turn in (0, 90, 180, 270):
            if b.chance(0.7):
                furniture.chair(b, at @ rotation([0, 1, 0], turn) @ lift(0, 0, -0.75))
    elif kind == "pot":
        plant(b, at, b.between(0.5, 1.4))
    elif kind == "crates":
        y = 0.0
        for _ in range(int(b.rng.integers(1, 4))):
            s = b.between(0.3, 0.6)
            group = b.can_move(f"crate{len(b.spots)}", at, "floor")
            b.block(
                [b.between(-0.1, 0.1), y + s / 2, 0], [s * 1.3, s, s], b.wood(), at=at, group=group
            )
            y += s
    elif kind == "bollards":
        b.add(join([cylinder([0.8 * i, 0, 0], 0.07, 0.8) for i in range(3)]), b.metal(), at=at)
    else:
        thing(b, at, scale=b.between(2, 5))


def _fence(b: Builder, x: float, z: float) -> None:
    side = b.between(-0.6, 0.6) * z
    bars = [
        tube([[s, 0, side], [s, 0.6, side], [s, 1.2, side]], 0.012, sides=6)
        for s in np.arange(-x, x, 0.13)
    ]
    bars += [tube([[-x, y, side], [0, y, side], [x, y, side]], 0.02, sides=6) for y in (0.15, 1.1)]
    # an open gate in the middle
    keep = [bar for bar in bars[:-2] if abs(bar.vertices[:, 0].mean()) > 0.8]
    b.add(join(keep + bars[-2:][:1]), b.metal() if b.chance(0.6) else b.plain())


def _post(b: Builder, at: np.ndarray) -> None:
    h = b.between(2.4, 3.6)
    b.add(tube([[0, 0, 0], [0, h / 2, 0], [0, h, 0]], 0.035), b.metal(), at=at)
    from stillray_training.simulate.mesh import sphere

    r = 0.14
    b.shine(
        sphere([0, h + r, 0], r, rings=12),
        b.light_color(b.between(10, 80) / (4 * np.pi**2 * r * r)),
        at=at,
        around=True,
    )

"""Still lifes: things on a table, close, before a backdrop, under studio light."""

from __future__ import annotations

import numpy as np

from stillray_training.simulate.generators import lamps
from stillray_training.simulate.generators.build import Builder, lift
from stillray_training.simulate.generators.finish import finish
from stillray_training.simulate.generators.lights import sunlight
from stillray_training.simulate.generators.things import KINDS, thing
from stillray_training.simulate.mesh import box, quad, rotation, sheet
from stillray_training.simulate.world import Sky, World

_BACKDROP = -0.85  # m, along z


def tabletop(seed: int) -> World:
    """A seeded still life around the origin, the table top at y = 0."""
    b = Builder([seed, 14])
    top = [b.wood(), b.stone(gloss=0.8), b.fabric(), b.plain(gloss=0.9)][b.rng.integers(4)]
    b.add(box([0, -0.02, 0], [2.4, 0.04, 1.6]), top)
    if walled := b.chance(0.75):
        # a backdrop that bends up behind, in front of which everything stands
        back = b.fabric() if b.chance(0.5) else b.wall()
        b.block([0, 0.8, _BACKDROP], [3.0, 1.7, 0.04], back)
        if b.chance(0.4):
            b.block([-1.3, 0.8, 0], [0.04, 1.7, 1.7], back)
    if b.chance(0.35):
        folds = 0.02 * np.sin(np.linspace(0, 9, 40))[None] * b.rng.random(
            (30, 1)
        ) + 0.01 * b.rng.random((30, 40))
        lay = lift(-0.5, 0.003, 0.4) @ rotation([1, 0, 0], -90)
        b.add(sheet(np.abs(folds), 1.0, 0.8), b.fabric(two_sided=True), at=lay)
    if b.chance(0.4):
        for level in range(int(b.rng.integers(1, 3))):
            w = b.between(0.3, 0.6)
            b.block(
                [b.between(-0.4, 0.4), 0.05 + 0.1 * level, b.between(-0.4, 0)],
                [w, 0.1, w * 0.6],
                b.stone(),
            )
    count = int(b.rng.integers(5, 18))
    favourites = b.rng.choice(KINDS, 6)
    spots: list[tuple[float, float]] = []
    for _ in range(count):
        for _ in range(12):
            x, z = float(b.rng.normal() * 0.35), float(b.rng.normal() * 0.22)
            if (
                abs(x) < 0.9
                and abs(z) < 0.6
                and all(np.hypot(x - u, z - v) > 0.14 for u, v in spots)
            ):
                spots.append((x, z))
                kind = b.pick(*favourites) if b.chance(0.6) else None
                thing(b, lift(x, 0.002, z), scale=b.between(0.8, 1.5), kind=kind)
                break
    lit = _studio(b, walled)
    indoors = b.chance(0.5)
    if indoors and not lit:
        indoors = False  # a window is all that lights it
    kind = b.pick("studio", "clear", "cloudy", p=[0.5, 0.25, 0.25])
    sky = Sky(kind=kind, seed=int(b.rng.integers(2**31)), radiance=b.between(0.1, 2))
    return finish(
        b, "tabletop", sky=sky, sun=sunlight(b, np.array([b.rng.normal(), 0, 1.0]), spread=60),
        daylight=not indoors,
        space=(np.array([-0.8, 0.12, 0.35]), np.array([0.8, 0.9, 1.3])),
        gaze=(np.array([-0.35, 0.0, -0.25]), np.array([0.35, 0.2, 0.15])),
    )  # fmt: skip


def _studio(b: Builder, walled: bool) -> bool:
    """Soft boxes at the sides and above; perhaps a desk lamp or a string of lights.

    Whether any of them lights the table: soft boxes may all be behind the backdrop.
    """
    lit = False
    for _ in range(int(b.rng.integers(1, 4))):
        w, h = b.between(0.1, 0.7), b.between(0.1, 0.7)
        azimuth, height = b.between(0, 360), b.between(20, 85)
        # starts 1.6 m away along +z, facing the origin, then is carried around it
        face = quad([w / 2, -h / 2, 1.6], [-w, 0, 0], [0, h, 0])
        turn = rotation([0, 1, 0], azimuth) @ rotation([1, 0, 0], -height)
        b.shine(face.moved(turn), b.light_color(b.between(2, 25) / (np.pi * w * h)))
        lit |= not walled or float(turn[2, 2]) * 1.6 > _BACKDROP
    if b.chance(0.25):
        lamps.desk_lamp(b, lift(b.between(-0.7, 0.7), 0, -0.4), b.between(0.3, 2))
        lit = True
    if b.chance(0.2):
        lamps.fairy_lights(b, np.array([-1.0, 0.6, -0.6]), np.array([1.0, 0.5, -0.5]), 3)
        lit = True
    return lit

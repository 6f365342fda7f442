"""Light of real rooms: wide windows and panels, sun between bars, lamps that glow all over."""

from __future__ import annotations

import numpy as np

from stillray_training.simulate.generators import lamps
from stillray_training.simulate.generators.build import lift
from stillray_training.simulate.generators.home import Home
from stillray_training.simulate.generators.lights import sunlight
from stillray_training.simulate.generators.shell import THICK, Wall
from stillray_training.simulate.mesh import lathe, quad, rotation, sphere, tube
from stillray_training.simulate.world import Sky, Sun


def daylight(b: Home, sides: list[Wall]) -> tuple[Sky | None, Sun | None, bool]:
    """Light through the windows: sky and sun, bright panels behind the bars, or dusk.

    Returns
    -------
    sky, sun, bool
        And whether the scene calls for them.
    """
    style = b.pick("sky", "panels", "dusk", p=[0.38, 0.47, 0.15])
    glazed = [wall for wall in sides if wall.holes]
    facing = tuple(float(v) for v in -glazed[0].frame[:3, 2]) if len(glazed) == 1 else None
    kind = b.pick("clear", "cloudy", "dusk", p=[0.5, 0.4, 0.1])
    strength = b.between(5, 12)
    sky = Sky(kind=kind, seed=int(b.rng.integers(2**31)), radiance=strength, facing=facing)  # type: ignore[arg-type]
    sun = sunlight(b, -glazed[0].frame[:3, 2], spread=55)
    # a lit patch is a few times as bright as the room, not the hundreds that a camera never shows
    ratio = strength * b.between(1.5, 6) / float(np.mean(sun.irradiance))
    sun = Sun(direction=sun.direction, irradiance=tuple(ratio * v for v in sun.irradiance))  # type: ignore[arg-type]
    if style == "panels":
        light = b.between(5, 22)
        for wall in glazed:
            _behind(b, wall, light)
    if style == "sky" and b.library is not None and "tree_a" in b.library and b.chance(0.4):
        wall = glazed[0]
        for _ in range(int(b.rng.integers(1, 4))):
            at = wall.spot(b.between(0, wall.length), b.between(-2.5, -0.5), -b.between(2.5, 7))
            b.place_asset(b.library.get("tree_a"), at, np.ones(3) * b.between(0.6, 1.0), "")
    return sky, sun, style == "sky"


def _behind(b: Home, wall: Wall, light: float) -> None:
    """A bright sky over a darker ground right behind each opening of a wall."""
    tint, ground = b.light_color(light), b.between(0.12, 0.6)
    horizon = b.between(0.0, 0.5)
    for le, bo, r, t in wall.holes:
        low, high = bo - 0.02, t + 0.02
        middle = low + horizon * (high - low)
        dark = tuple(ground * v * c for v, c in zip(tint, (0.85, 1.0, 0.7), strict=True))
        for y0, y1, color in ((low, middle, dark), (middle, high, tint)):
            if y1 - y0 > 0.05:
                face = quad([le - 0.02, y0, -THICK - 0.03], [r - le + 0.04, 0, 0], [0, y1 - y0, 0])
                b.shine(face.moved(wall.frame), color, window=True)  # type: ignore[arg-type]


def ceiling_light(b: Home, size: np.ndarray, *, always: bool) -> None:
    """Panels, glowing globes or drums under the ceiling; nothing in some rooms with daylight."""
    if not always and b.chance(0.5):
        return
    y, power = size[1], size[0] * size[2] * b.between(1.0, 5.0)
    style = b.pick("panels", "globe", "drum", "strips", p=[0.3, 0.25, 0.3, 0.15])
    if style in ("panels", "strips"):
        wide, long = (b.between(0.5, 1.0), b.between(0.6, 1.2))
        if style == "strips":
            wide, long = b.between(0.08, 0.2), 0.7 * size[2]
        for x in np.linspace(-0.25, 0.25, int(b.rng.integers(1, 4))) * size[0]:
            lamps.panel(b, lift(x, y, 0), wide, long, power / 3)
        return
    drop, radius = b.between(0.3, 0.9), b.between(0.12, 0.3)
    at = lift(b.between(-0.6, 0.6), y, b.between(-0.6, 0.6))
    group = b.can_move(f"pendant{len(b.spots)}", at, "hanging")
    cable = tube([[0, 0, 0], [0, -drop / 2, 0], [0, -drop, 0]], 0.004, sides=6)
    b.add(cable, b.plain((0.04, 0.04, 0.04)), at=at, group=group)
    if style == "globe":
        body = sphere([0, -drop - radius, 0], radius, rings=16)
    else:
        # the shade glows: seen from a room, a lamp is its shade
        tall = radius * b.between(0.7, 1.3)
        body = lathe([(0, 0), (radius, 0), (radius, tall), (0, tall)], segments=40)
        body = body.moved(lift(0, -drop - tall, 0))
    b.shine(body, b.light_color(power / (np.pi * body.area())), at=at, group=group, around=True)


def soft_box(
    b: Home, azimuth: float, height: float, size: float, power: float, group: str = ""
) -> None:
    """A bright square 3.5 m from the origin that faces it; azimuth and height in degrees."""
    face = quad([size / 2, -size / 2, 3.5], [-size, 0, 0], [0, size, 0])
    turn = rotation([0, 1, 0], azimuth) @ rotation([1, 0, 0], -height)
    b.shine(face.moved(turn), b.light_color(power / (np.pi * size * size)), group=group)

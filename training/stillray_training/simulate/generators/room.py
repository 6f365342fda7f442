"""Furnished rooms: living room, bedroom, kitchen, bathroom, office, class room, stair hall."""

from __future__ import annotations

import numpy as np

from stillray_training.simulate.generators import furniture, lamps
from stillray_training.simulate.generators.build import Builder, lift
from stillray_training.simulate.generators.finish import finish
from stillray_training.simulate.generators.lights import daylight
from stillray_training.simulate.generators.plants import plant
from stillray_training.simulate.generators.shell import (
    Wall,
    door,
    floor_and_ceiling,
    pierced,
    skirting,
    walls,
    window,
)
from stillray_training.simulate.generators.things import thing
from stillray_training.simulate.mesh import quad, rotation
from stillray_training.simulate.world import Surface, World

KINDS = ("living", "bedroom", "kitchen", "bathroom", "office", "class", "hall")
_ODDS = (0.26, 0.14, 0.17, 0.15, 0.11, 0.08, 0.09)
_WINDOWS_ON = 1  # the right wall; the back wall too in some rooms


def room(seed: int) -> World:
    """A seeded room; it stands on y = 0 around x = z = 0."""
    b = Builder([seed, 11])
    kind = b.pick(*KINDS, p=_ODDS)
    low, high = (
        ((2.2, 2.3, 2.4), (3.6, 2.8, 4.0))
        if kind == "bathroom"
        else (
            ((5.5, 2.8, 5.5), (8.5, 3.4, 9.0))
            if kind in ("class", "hall")
            else ((3.6, 2.4, 3.8), (6.5, 3.1, 7.5))
        )
    )
    size = b.rng.uniform(low, high)
    sides = walls(size)
    _windows(b, sides, kind)
    _surfaces(b, sides, size, kind)
    FURNISH[kind](b, sides, size)
    _walls_decor(b, sides, kind)
    _ceiling_lights(b, size, kind)
    if b.chance(0.15):
        x, z = size[0] / 2 - 0.1, size[2] / 2 - 0.1
        y = size[1] - 0.15
        lamps.fairy_lights(
            b, np.array([-x, y, b.between(-z, z)]), np.array([x, y, b.between(-z, z)]), 20
        )
    sky, sun, day = daylight(b, sides)
    x, y, z = size / [2, 1, 2]
    return finish(
        b,
        "room",
        daylight=day,
        sky=sky,
        sun=sun,
        space=(
            np.array([-x + 0.25, 0.6, -z + 0.25]),
            np.array([x - 0.25, min(y - 0.4, 2.2), z - 0.25]),
        ),
        gaze=(np.array([-x, 0.2, -z]), np.array([x, 1.5, z])),
    )


def _windows(b: Builder, sides: list[Wall], kind: str) -> None:
    chosen = [sides[_WINDOWS_ON]] + ([sides[0]] if b.chance(0.3) else [])
    for wall in chosen:
        count = int(b.rng.integers(1, 4)) if wall.length > 4 else 1
        low = b.pick("full", "normal", "high", p=[0.2, 0.65, 0.15])
        bottom = {"full": 0.05, "normal": b.between(0.7, 1.0), "high": 1.5}[low]
        top = wall.height - b.between(0.15, 0.5)
        each = wall.length / count
        width = each * b.between(0.35, 0.75)
        for i in range(count):
            middle = (i + 0.5) * each
            wall.holes.append((middle - width / 2, bottom, middle + width / 2, top))


def _surfaces(b: Builder, sides: list[Wall], size: np.ndarray, kind: str) -> None:
    wet = kind in ("bathroom", "kitchen")
    first = b.stone(gloss=0.8) if kind == "bathroom" and b.chance(0.75) else b.wall()
    second = first if b.chance(0.6) else (b.stone() if kind == "bathroom" else b.wall())
    for index, wall in enumerate(sides):
        b.add(pierced(wall), second if index == 0 else first)
        for hole in wall.holes:
            window(b, wall, hole, panes=b.chance(0.25))
    floor = (
        b.stone(gloss=0.75)
        if b.chance(0.75 if wet else 0.2)
        else (b.planks() if b.chance(0.75) else b.fabric())
    )
    floor_and_ceiling(b, size, floor, Surface(color=b.color(light=b.between(0.65, 0.85))))
    if not wet and b.chance(0.8):
        skirting(b, sides)


def _against(b: Builder, wall: Wall, width: float, high: float = 0.9) -> np.ndarray | None:
    """A free place for something that wide against a wall, and take it."""
    for _ in range(10):
        s = b.between(width / 2 + 0.1, max(width / 2 + 0.11, wall.length - width / 2 - 0.1))
        at = wall.spot(s, 0, 0.03)
        middle = wall.spot(s, 0, 0.4)[:3, 3]
        fits = wall.length > width + 0.2 and wall.clear(s - width / 2, s + width / 2, 0, high)
        if fits and b.free(middle[0], middle[2], width * 0.45):
            b.take(middle[0], middle[2], width * 0.45)
            return at
    return None


def _any_wall(b: Builder, sides: list[Wall], width: float, high: float = 0.9) -> np.ndarray | None:
    for index in b.rng.permutation(4):
        at = _against(b, sides[index], width, high)
        if at is not None:
            return at
    return None


def _free_spot(b: Builder, size: np.ndarray, radius: float) -> np.ndarray | None:
    x, z = np.maximum(size[[0, 2]] / 2 - radius - 0.2, 0.1)
    spot = b.place([-x, -z], [x, z], radius)
    return None if spot is None else lift(spot[0], 0, spot[1])


def _dining(b: Builder, size: np.ndarray) -> None:
    at = _free_spot(b, size, 0.9)
    if at is None:
        return
    w, d = b.between(0.9, 1.7), b.between(0.7, 0.95)
    at = at @ rotation([0, 1, 0], b.between(0, 360))
    furniture.table(b, at, w, d, 0.74, int(b.rng.integers(2, 9)))
    for side in (-1, 1):
        for s in (-w / 4, w / 4) if w > 1.2 else (0.0,):
            if b.chance(0.8):
                turn = 0 if side < 0 else 180
                out = d / 2 + b.between(0.1, 0.35)
                furniture.chair(
                    b, at @ lift(s, 0, side * out) @ rotation([0, 1, 0], turn + b.between(-15, 15))
                )
    if b.chance(0.5):
        lamps.pendant(b, lift(at[0, 3], size[1], at[2, 3]), b.between(0.7, 1.1), b.between(15, 60))


def _rug(b: Builder, size: np.ndarray) -> None:
    w, d = b.between(0.4, 0.8) * size[0], b.between(0.3, 0.7) * size[2]
    at = lift(b.between(-0.3, 0.3), 0.0, b.between(-0.5, 0.5)) @ rotation(
        [0, 1, 0], b.between(-10, 10)
    )
    cloth = b.fabric() if b.chance(0.6) else b.printed(max(w, d))
    b.add(quad([-w / 2, 0.008, d / 2], [w, 0, 0], [0, 0, -d]), cloth, at=at)


def _floor_lamp(b: Builder, sides: list[Wall]) -> None:
    at = _any_wall(b, sides, 0.5)
    if at is not None:
        lamps.standing(b, at @ lift(0, 0, 0.3), b.between(1.2, 1.7), b.between(10, 50))


def _plants(b: Builder, sides: list[Wall], most: int) -> None:
    for _ in range(int(b.rng.integers(0, most + 1))):
        at = _any_wall(b, sides, 0.6)
        if at is not None:
            plant(b, at @ lift(0, 0, 0.3), b.between(0.4, 1.3))


def _living(b: Builder, sides: list[Wall], size: np.ndarray) -> None:
    if b.chance(0.75):
        _rug(b, size)
    w = b.between(1.7, 2.4)
    at = _any_wall(b, sides, w)
    if at is not None:
        furniture.sofa(b, at, w)
        front = at @ lift(0, 0, 1.5)
        b.take(front[0, 3], front[2, 3], 0.6)
        furniture.table(
            b,
            front,
            b.between(0.8, 1.2),
            b.between(0.5, 0.7),
            b.between(0.35, 0.45),
            int(b.rng.integers(2, 7)),
        )
    for _ in range(int(b.rng.integers(0, 3))):
        spot = _free_spot(b, size, 0.5)
        if spot is not None:
            furniture.sofa(b, spot @ rotation([0, 1, 0], b.between(0, 360)), 0.85)
    stand = _any_wall(b, sides, 1.5)
    if stand is not None:
        furniture.cabinet(b, stand, 1.4, b.between(0.4, 0.6), 0.4, clutter=2)
        if b.chance(0.6):
            lamps.screen(b, stand @ lift(0, 0.62, 0.15), b.between(0.8, 1.2), b.between(1, 10))
    for _ in range(int(b.rng.integers(1, 3))):
        wide = b.between(0.7, 1.4)
        at = _any_wall(b, sides, wide, 2.0)
        if at is not None:
            furniture.shelf(b, at, wide, b.between(1.2, 2.1))
    if b.chance(0.6):
        _dining(b, size)
    _floor_lamp(b, sides)
    _plants(b, sides, 3)


def _bedroom(b: Builder, sides: list[Wall], size: np.ndarray) -> None:
    _rug(b, size)
    w = b.between(0.95, 1.8)
    at = _any_wall(b, sides, w + 1.0)
    if at is not None:
        furniture.bed(b, at, w)
        for side in (-1, 1):
            stand = at @ lift(side * (w / 2 + 0.28), 0, 0)
            furniture.cabinet(b, stand, 0.42, 0.48, 0.36, clutter=2)
            if b.chance(0.7):
                lamps.standing(
                    b, stand @ lift(0.05, 0.48, 0.15), b.between(0.3, 0.45), b.between(4, 20)
                )
    wardrobe = _any_wall(b, sides, 1.6, 2.0)
    if wardrobe is not None:
        furniture.cabinet(b, wardrobe, 1.5, 2.0, 0.55)
    if b.chance(0.6):
        _desk(b, sides)
    at = _any_wall(b, sides, 0.7, 1.8)
    if at is not None and b.chance(0.6):
        furniture.mirror(b, at @ lift(0, 1.0, 0), 0.5, 1.5)
    _plants(b, sides, 2)
    for _ in range(int(b.rng.integers(0, 4))):
        spot = _free_spot(b, size, 0.15)
        if spot is not None:
            thing(b, spot, kind=b.pick("books", "box", "ball", "toy", "cable"))


def _kitchen(b: Builder, sides: list[Wall], size: np.ndarray) -> None:
    for index in b.rng.permutation([0, 2, 3])[: int(b.rng.integers(1, 3))]:
        w = min(sides[index].length - 0.4, b.between(2.0, 4.0))
        at = _against(b, sides[index], w)
        if at is not None:
            furniture.counter(b, at, w)
    fridge = _any_wall(b, sides, 0.7, 1.9)
    if fridge is not None:
        furniture.cabinet(b, fridge, 0.65, 1.85, 0.62, clutter=1)
    _dining(b, size)
    if b.chance(0.4):
        _dining(b, size)
    at = _any_wall(b, sides, 0.9, 1.8)
    if at is not None and b.chance(0.5):
        furniture.shelf(b, at, 0.9, 1.8)
    _plants(b, sides, 2)


def _bathroom(b: Builder, sides: list[Wall], size: np.ndarray) -> None:
    at = _any_wall(b, sides, 1.75)
    if at is not None:
        furniture.bath(b, at, 1.7)
    at = _any_wall(b, sides, 0.8, 1.9)
    if at is not None:
        furniture.basin(b, at)
        if b.chance(0.6):
            lamps.spots(b, at @ lift(0, 2.1, 0.15), 0.6, b.between(5, 20))
    at = _any_wall(b, sides, 0.6)
    if at is not None:
        furniture.cabinet(b, at, 0.5, b.between(0.7, 1.6), 0.35, clutter=3)
    for _ in range(2):
        wall = sides[b.rng.integers(4)]
        s = b.between(0.5, wall.length - 0.5)
        if wall.clear(s - 0.4, s + 0.4, 0.8, 1.5):
            furniture.towel(b, wall.spot(s, 1.35, 0.01))
    if b.chance(0.5):
        _rug(b, size * 0.5)
    _plants(b, sides, 1)


def _desk(b: Builder, sides: list[Wall]) -> None:
    w = b.between(1.1, 1.6)
    at = _any_wall(b, sides, w)
    if at is None:
        return
    furniture.table(b, at @ lift(0, 0, 0.35), w, 0.65, 0.74, int(b.rng.integers(2, 7)))
    furniture.chair(
        b, at @ lift(b.between(-0.2, 0.2), 0, 0.9) @ rotation([0, 1, 0], 180 + b.between(-40, 40))
    )
    if b.chance(0.5):
        lamps.screen(b, at @ lift(0.1, 0.8, 0.2), b.between(0.45, 0.7), b.between(1, 6))
    if b.chance(0.6):
        lamps.desk_lamp(b, at @ lift(-0.4 * w, 0.74, 0.2), b.between(3, 12))


def _office(b: Builder, sides: list[Wall], size: np.ndarray) -> None:
    for _ in range(int(b.rng.integers(2, 5))):
        _desk(b, sides)
    for _ in range(int(b.rng.integers(1, 4))):
        wide = b.between(0.7, 1.2)
        at = _any_wall(b, sides, wide, 2.0)
        if at is not None:
            furniture.shelf(b, at, wide, b.between(1.4, 2.1))
    _plants(b, sides, 2)
    _floor_lamp(b, sides)


def _class(b: Builder, sides: list[Wall], size: np.ndarray) -> None:
    x, _, z = size / 2
    for row in np.arange(-z + 1.8, z - 1.0, b.between(1.3, 1.7)):
        for column in np.arange(-x + 1.0, x - 0.8, b.between(1.4, 1.9)):
            at = lift(column, 0, row) @ rotation([0, 1, 0], b.between(-4, 4))
            b.take(column, row, 0.8)
            furniture.table(b, at, 1.1, 0.5, 0.72, int(b.rng.integers(0, 4)))
            for s in (-0.28, 0.28):
                furniture.chair(
                    b, at @ lift(s, 0, 0.55) @ rotation([0, 1, 0], 180 + b.between(-20, 20))
                )
    board = sides[0].spot(sides[0].length / 2, 0.9, 0.02)
    if sides[0].clear(sides[0].length / 2 - 1.5, sides[0].length / 2 + 1.5, 0.8, 2.2):
        b.add(
            quad([-1.5, 0, 0], [3, 0, 0], [0, 1.2, 0]),
            b.plain((0.03, 0.06, 0.045), gloss=0.6),
            at=board,
        )


def _hall(b: Builder, sides: list[Wall], size: np.ndarray) -> None:
    x, y, z = size[0] / 2, size[1], size[2] / 2
    wide = b.between(1.0, 1.6)
    furniture.stairs(b, lift(-x + wide / 2 + 0.05, 0, z - 1.4), wide, y * b.between(0.75, 0.95))
    b.take(-x + wide / 2, 0, wide)
    b.take(-x + wide / 2, -z / 2, wide)
    b.take(-x + wide / 2, z / 2, wide)
    for _ in range(int(b.rng.integers(1, 4))):
        w = b.between(0.6, 1.3)
        at = _any_wall(b, sides, w, 1.2)
        if at is not None:
            furniture.cabinet(b, at, w, b.between(0.7, 1.0), 0.4, clutter=4)
    if b.chance(0.5):
        _dining(b, size)
    if b.chance(0.6):
        _rug(b, size)
    _floor_lamp(b, sides)
    _plants(b, sides, 3)


def _walls_decor(b: Builder, sides: list[Wall], kind: str) -> None:
    wall = sides[2 if b.chance(0.6) else 3]
    along = b.between(0.7, wall.length - 0.7)
    if wall.clear(along - 0.6, along + 0.6, 0, 2.2):
        door(b, wall, along)
    for _ in range(int(b.rng.integers(0, 7))):
        wall = sides[b.rng.integers(4)]
        w, h = b.between(0.25, 1.0), b.between(0.25, 0.8)
        s, y = b.between(0.6, wall.length - 0.6), b.between(1.4, 1.8)
        if wall.clear(s - w / 2 - 0.1, s + w / 2 + 0.1, y - h / 2, y + h / 2):
            maker = furniture.mirror if b.chance(0.2) else furniture.picture
            maker(b, wall.spot(s, y, 0.005), w, h)


def _ceiling_lights(b: Builder, size: np.ndarray, kind: str) -> None:
    style = b.pick("none", "pendant", "panels", "spots", p=[0.3, 0.35, 0.2, 0.15])
    if kind in ("office", "class") and b.chance(0.7):
        style = "panels"
    y, power = size[1], size[0] * size[2] * b.between(1.0, 5.0)
    if style == "none" and not b.lamps:
        style = "pendant"
    if style == "pendant":
        lamps.pendant(
            b, lift(b.between(-0.5, 0.5), y, b.between(-0.5, 0.5)), b.between(0.3, 0.8), power
        )
    elif style == "panels":
        for u in np.linspace(-0.3, 0.3, 2):
            for v in (
                np.linspace(-0.3, 0.3, int(b.rng.integers(1, 4))) if kind != "bathroom" else (0.0,)
            ):
                lamps.panel(
                    b,
                    lift(u * size[0], y, v * size[2]),
                    b.between(0.15, 0.6),
                    b.between(0.6, 1.2),
                    power / 4,
                )
    elif style == "spots":
        lamps.spots(b, lift(0, y, b.between(-0.4, 0.4)), 0.6 * size[0], power)


FURNISH = {
    "living": _living,
    "bedroom": _bedroom,
    "kitchen": _kitchen,
    "bathroom": _bathroom,
    "office": _office,
    "class": _class,
    "hall": _hall,
}

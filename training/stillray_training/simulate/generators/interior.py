"""Rooms as people live in them: daylight through barred windows, relief, objects, muted colours."""

from __future__ import annotations

import numpy as np

from stillray_training.simulate.assets import Library
from stillray_training.simulate.generators import furniture
from stillray_training.simulate.generators.build import lift
from stillray_training.simulate.generators.finish import finish
from stillray_training.simulate.generators.home import Home, of_home
from stillray_training.simulate.generators.openings import (
    fitted,
    opening,
    panelled_door,
    railing,
    wire_chair,
)
from stillray_training.simulate.generators.room import FURNISH, KINDS
from stillray_training.simulate.generators.shell import (
    THICK,
    Wall,
    floor_and_ceiling,
    pierced,
    skirting,
    walls,
)
from stillray_training.simulate.generators.sunlit import ceiling_light, daylight
from stillray_training.simulate.mesh import quad, rotation
from stillray_training.simulate.world import Surface, World

_ODDS = (0.3, 0.14, 0.16, 0.12, 0.12, 0.06, 0.1)  # of KINDS
_FREE_STANDING = (
    "wheelchair", "desk_fan", "tall_plant", "cloth_folds", "modern_armchair", "painted_stool",
)  # fmt: skip
Boxes = tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def interior(seed: int, library: Library | None = None) -> World:
    """A seeded room that stands on y = 0 around x = z = 0, furnished from a library if given."""
    b = Home([seed, 21], library)
    kind = b.pick(*KINDS, p=_ODDS)
    low, high = {
        "bathroom": ((2.4, 2.4, 2.6), (3.8, 2.8, 4.2)),
        "class": ((5, 2.8, 5.5), (8, 3.5, 8.5)),
        "hall": ((5, 2.8, 5.5), (8, 3.5, 8.5)),
    }.get(kind, ((3.4, 2.5, 3.8), (6, 3.1, 7)))
    size = b.rng.uniform(low, high)
    sides = walls(size)
    _cut_windows(b, sides)
    _surfaces(b, sides, size, kind)
    FURNISH[kind](b, sides, size)
    _more_furniture(b, sides, size)
    _decorate(b, sides)
    sky, sun, outside = daylight(b, sides)
    ceiling_light(b, size, always=not outside and not any(lamp.window for lamp in b.lamps))
    space, gaze = _framing(b, sides, size)
    world = finish(b, "interior", daylight=outside, sky=sky, sun=sun, space=space, gaze=gaze)
    return of_home(b, world, without=() if b.chance(0.2) else ("medium",))


def _cut_windows(b: Home, sides: list[Wall]) -> None:
    """Wide openings in the right wall, and perhaps in the back wall: the room's main lights."""
    for wall in [sides[1]] + ([sides[0]] if b.chance(0.4) else []):
        count = max(1, round(wall.length / b.between(1.6, 3.2)))
        each = wall.length / count
        width = each * b.between(0.55, 0.88)
        bottom = 0.04 if b.chance(0.35) else b.between(0.5, 0.95)
        top = wall.height - b.between(0.1, 0.4)
        for i in range(count):
            middle = (i + 0.5) * each
            wall.holes.append((middle - width / 2, bottom, middle + width / 2, top))


def _surfaces(b: Home, sides: list[Wall], size: np.ndarray, kind: str) -> None:
    wet = kind in ("bathroom", "kitchen")
    first = b.stone(gloss=0.8) if kind == "bathroom" and b.chance(0.6) else b.wall()
    second = first if b.chance(0.5) else b.wall()
    for index, wall in enumerate(sides):
        b.add(pierced(wall), second if index in (0, 3) else first)
        for hole in wall.holes:
            opening(b, wall, hole)
    style = b.pick("stone", "planks", "carpet", p=[0.7, 0.28, 0.02] if wet else [0.14, 0.66, 0.2])
    floor = {"stone": b.stone, "planks": b.planks, "carpet": b.carpet}[style]()
    ceiling = Surface(color=b.off_white())
    if b.chance(0.15):
        ceiling = b.carved("panels", b.between(0.6, 1.2), 0.02, b.off_white())
    floor_and_ceiling(b, size, floor, ceiling)
    if not wet and b.chance(0.85):
        skirting(b, sides)
    if not wet and b.chance(0.35):
        _wainscot(b, sides)
    if kind == "bathroom" and b.library is not None and b.chance(0.5):
        _cladding(b, sides)


def _wainscot(b: Home, sides: list[Wall]) -> None:
    """Panels of relief on the lower part of the walls, under a rail."""
    high = b.between(0.8, 1.2)
    board = b.carved(b.pick("panels", "ribs", "moulding"), high, 0.015)
    for wall in sides:
        if wall.clear(0, wall.length, 0, high):
            b.add(quad([0, 0, 0.006], [wall.length, 0, 0], [0, high, 0]), board, at=wall.frame)
            b.block([wall.length / 2, high, 0.015], [wall.length, 0.04, 0.03], board, at=wall.frame)


def _cladding(b: Home, sides: list[Wall]) -> None:
    """A wall of the library's tiles."""
    assert b.library is not None
    names = [name for name in b.library.kind("building part")]
    plain = [wall for wall in sides if not wall.holes]
    if not names or not plain:
        return
    asset, wall = b.library.get(str(b.rng.choice(names))), plain[b.rng.integers(len(plain))]
    count = max(1, round(wall.length / asset.size[0]))
    each = wall.length / count
    scale = np.array([each / asset.size[0], wall.height / asset.size[1], 0.2])
    for i in range(count):
        b.place_asset(asset, wall.spot((i + 0.5) * each, 0, 0.01), scale, "")


def _more_furniture(b: Home, sides: list[Wall], size: np.ndarray) -> None:
    """Thin things, and objects of the library that no other rule places."""
    x, z = size[0] / 2, size[2] / 2
    for _ in range(int(b.rng.integers(0, 3))):
        spot = b.place([-x + 0.5, -z + 0.5], [x - 0.5, z - 0.5], 0.3)
        if spot is not None:
            wire_chair(b, lift(spot[0], 0, spot[1]) @ rotation([0, 1, 0], b.between(0, 360)))
    if b.chance(0.2):
        # before the windows, as a gallery's
        railing(
            b, lift(x - b.between(0.35, 0.9), 0, z * 0.8) @ rotation([0, 1, 0], 90), 1.6 * z, 0.95
        )
    if b.library is None:
        return
    own = [name for name in _FREE_STANDING if name in b.library]
    for _ in range(int(b.rng.integers(1, 4)) if own else 0):
        asset = b.library.get(str(b.rng.choice(own)))
        radius = float(np.hypot(asset.size[0], asset.size[2]) / 2)
        low = np.maximum(np.array([x, z]) - radius - 0.1, 0.05)
        spot = b.place(list(-low), list(low), radius * 0.8)
        if spot is not None:
            at = lift(spot[0], 0, spot[1]) @ rotation([0, 1, 0], b.between(0, 360))
            b.place_asset(asset, at, np.ones(3))


def _decorate(b: Home, sides: list[Wall]) -> None:
    wall = sides[2 if b.chance(0.6) else 3]
    along = b.between(0.7, wall.length - 0.7)
    if wall.clear(along - 0.6, along + 0.6, 0, 2.2):
        panelled_door(b, wall, along)
    for _ in range(int(b.rng.integers(1, 7))):
        wall = sides[b.rng.integers(4)]
        w, h = b.between(0.25, 1.1), b.between(0.25, 0.9)
        s, y = b.between(0.6, wall.length - 0.6), b.between(1.4, 1.8)
        if not wall.clear(s - w / 2 - 0.1, s + w / 2 + 0.1, y - h / 2, y + h / 2):
            continue
        if b.chance(0.35):
            frame = b.carved("moulding", 1.0, 0.02)
            b.add(
                fitted(quad([-w / 2, -h / 2, 0.006], [w, 0, 0], [0, h, 0])),
                frame,
                at=wall.spot(s, y),
            )
        elif b.chance(0.1):
            furniture.mirror(b, wall.spot(s, y, 0.005), w, h)
        else:
            furniture.picture(b, wall.spot(s, y, 0.005), w, h)


def _framing(b: Home, sides: list[Wall], size: np.ndarray) -> Boxes:
    """Boxes to stand in and to look at: the room, a window, the floor before it, one thing."""
    x, y, z = size[0] / 2, size[1], size[2] / 2
    low, high = (
        np.array([0.3 - x, 0.5, 0.3 - z]),
        np.array([x - 0.3, min(y - 0.5, 1.9), z - 0.3]),
    )
    style = b.pick("room", "window", "floor", "thing", p=[0.35, 0.25, 0.15, 0.25])
    hole = sides[1].holes[b.rng.integers(len(sides[1].holes))]
    window = sides[1].spot((hole[0] + hole[2]) / 2, (hole[1] + hole[3]) / 2, -THICK)[:3, 3]
    if style == "window":
        high = high - [0.6 * x, 0, 0]
        return (low, high), (window - [0.3, 0.8, 1.0], window - [0, -0.3, -1.0])
    if style == "floor":
        near = np.array([x - 1.6, 0.0, window[2] - 0.8])
        return (low - [0, -0.4, 0], high - [x, 0, 0]), (near, near - [-1.0, -0.5, -1.6])
    if style == "thing" and b.spots:
        at = b.spots[b.rng.integers(len(b.spots))].centre
        at = np.clip(at, [-x, 0, -z], [x, 1.6, z])
        reach = b.between(0.9, 2.0)
        first, last = np.maximum(at - reach, low), np.minimum(at - [-reach, -1.1, -reach], high)
        if (last - first > 0.3).all():
            return (first, last), (at - [0.3, 0.1, 0.3], at - [-0.3, -0.5, -0.3])
    return (low, high), (np.array([-x, 0.2, -z]), np.array([x, 1.5, z]))

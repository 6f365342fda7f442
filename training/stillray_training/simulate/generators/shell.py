"""Walls with openings, floors, ceilings, windows, doors and curtains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from stillray_training.simulate.generators.build import Builder, lift
from stillray_training.simulate.mesh import Mesh, box, cylinder, join, quad, sheet, tube
from stillray_training.simulate.world import Surface

THICK = 0.22  # of outer walls, metres

Hole = tuple[float, float, float, float]  # left, bottom, right, top along the wall, metres


@dataclass(frozen=True, kw_only=True, eq=False)
class Wall:
    """A wall in its own frame: x along it, y up, z into the room."""

    frame: np.ndarray  # (4, 4) to the world
    length: float
    height: float
    holes: list[Hole] = field(default_factory=list)

    def spot(self, along: float, up: float = 0.0, out: float = 0.0) -> np.ndarray:
        """A transform to a place on the wall."""
        return self.frame @ lift(along, up, out)

    def clear(self, left: float, right: float, low: float, high: float) -> bool:
        """Whether no opening lies in that part."""
        return all(
            r <= left or le >= right or t <= low or bo >= high for le, bo, r, t in self.holes
        )


def walls(size: np.ndarray) -> list[Wall]:
    """The four walls of a room of ``size`` (x, y, z) metres around x = z = 0: back, right, front,
    left."""
    x, z = size[0] / 2, size[2] / 2
    y = float(size[1])
    frames = [
        ((-x, -z), (1, 0), 2 * x), ((x, -z), (0, 1), 2 * z),
        ((x, z), (-1, 0), 2 * x), ((-x, z), (0, -1), 2 * z),
    ]  # fmt: skip
    made = []
    for (ox, oz), (ax, az), length in frames:
        along = np.array([ax, 0.0, az])
        frame = np.eye(4)
        frame[:3, 0], frame[:3, 1], frame[:3, 2] = along, [0, 1, 0], np.cross(along, [0, 1.0, 0])
        frame[:3, 3] = [ox, 0, oz]
        made.append(Wall(frame=frame, length=float(length), height=y))
    return made


def pierced(wall: Wall) -> Mesh:
    """The inner face of a wall around its openings, and the openings' reveals."""
    xs = sorted({0.0, wall.length, *(v for hole in wall.holes for v in (hole[0], hole[2]))})
    ys = sorted({0.0, wall.height, *(v for hole in wall.holes for v in (hole[1], hole[3]))})
    parts = []
    for x0, x1 in pairwise(xs):
        for y0, y1 in pairwise(ys):
            cx, cy = (x0 + x1) / 2, (y0 + y1) / 2
            if any(le < cx < r and bo < cy < t for le, bo, r, t in wall.holes):
                continue
            face = quad([x0, y0, 0], [x1 - x0, 0, 0], [0, y1 - y0, 0])
            # one picture over the whole wall, whatever cells it is cut into
            uvs = face.uvs + np.array([x0, y0])
            parts.append(
                Mesh(vertices=face.vertices, normals=face.normals, uvs=uvs, faces=face.faces)
            )
            # the outside, so that no light comes through from behind and none is lost in it
            parts.append(quad([x1, y0, -THICK], [x0 - x1, 0, 0], [0, y1 - y0, 0]))
    for le, bo, r, t in wall.holes:
        parts.append(quad([le, bo, 0], [0, 0, -THICK], [0, t - bo, 0]))
        parts.append(quad([r, bo, -THICK], [0, 0, THICK], [0, t - bo, 0]))
        parts.append(quad([le, bo, 0], [r - le, 0, 0], [0, 0, -THICK]))
        parts.append(quad([le, t, -THICK], [r - le, 0, 0], [0, 0, THICK]))
    return join(parts).moved(wall.frame)


def floor_and_ceiling(b: Builder, size: np.ndarray, floor: Surface, ceiling: Surface) -> None:
    """The floor at y = 0 and the ceiling over it."""
    x, y, z = size[0] / 2, size[1], size[2] / 2
    b.add(quad([-x, 0, z], [2 * x, 0, 0], [0, 0, -2 * z]), floor)
    b.add(quad([-x, y, -z], [2 * x, 0, 0], [0, 0, 2 * z]), ceiling)
    # seen from outside, by the sun
    b.add(
        quad(
            [-x - THICK, y + 0.1, z + THICK], [2 * x + 2 * THICK, 0, 0], [0, 0, -2 * z - 2 * THICK]
        ),
        ceiling,
    )
    if b.chance(0.2):
        for s in np.arange(-z + 0.4, z - 0.2, b.between(0.7, 1.3)):
            b.block([0, y - 0.09, s], [2 * x, 0.18, 0.12], b.wood())


def window(b: Builder, wall: Wall, hole: Hole, *, panes: bool) -> None:
    """Frame, bars, panes and perhaps curtains or blinds of an opening."""
    le, bo, r, t = hole
    w, h = r - le, t - bo
    at = wall.spot(le, bo, -THICK * 0.7)
    wood = b.plain(b.color(light=0.75)) if b.chance(0.6) else b.wood()
    bars = [
        box([w / 2, 0.025, 0], [w, 0.05, 0.05]), box([w / 2, h - 0.025, 0], [w, 0.05, 0.05]),
        box([0.025, h / 2, 0], [0.05, h, 0.05]), box([w - 0.025, h / 2, 0], [0.05, h, 0.05]),
    ]  # fmt: skip
    across, down = int(b.rng.integers(0, 4)), int(b.rng.integers(0, 3))
    bars += [box([w * i / (across + 1), h / 2, 0], [0.03, h, 0.035]) for i in range(1, across + 1)]
    bars += [box([w / 2, h * i / (down + 1), 0], [w, 0.03, 0.035]) for i in range(1, down + 1)]
    b.add(join(bars), wood, at=at)
    if panes:
        b.add(
            quad([0, 0, 0], [w, 0, 0], [0, h, 0]), Surface(color=(1, 1, 1), special="pane"), at=at
        )
    b.block([w / 2, -0.02, THICK * 0.75], [w + 0.1, 0.03, THICK * 0.9], wood, at=at)
    dressing = b.pick("none", "curtains", "blinds", p=[0.4, 0.4, 0.2])
    if dressing == "curtains":
        curtains(b, wall, hole)
    elif dressing == "blinds":
        tilt = b.between(-0.02, 0.02)
        slats = [
            box([w / 2, y, 0.1], [w - 0.02, 0.004 + abs(tilt), 0.045])
            for y in np.arange(h * b.between(0, 0.6), h, 0.055)
        ]
        if slats:
            b.add(join(slats), b.plain(b.color(light=0.7)), at=at)


def curtains(b: Builder, wall: Wall, hole: Hole) -> None:
    """A pair of curtains on a rod."""
    le, bo, r, t = hole
    cloth = b.fabric(two_sided=True)
    low = max(0.03, bo - 0.2) if b.chance(0.5) else 0.03
    high = min(t + 0.12, wall.height - 0.04)
    for side in (0, 1):
        w = (r - le) * b.between(0.15, 0.42)
        columns = max(24, int(w * 90))
        folds = 0.05 * np.sin(np.linspace(0, w * b.between(35, 60), columns) + b.rng.normal(size=1))
        loose = np.linspace(1.0, 0.7, 8)[:, None] + 0.1 * b.rng.random((8, 1))
        x = le - 0.12 if side == 0 else r + 0.12 - w
        b.add(sheet(folds[None] * loose, w, high - low), cloth, at=wall.spot(x, low, 0.12))
    rod = tube([[le - 0.25, high, 0.12], [(le + r) / 2, high, 0.12], [r + 0.25, high, 0.12]], 0.012)
    b.add(rod, b.metal(), at=wall.frame)


def door(b: Builder, wall: Wall, along: float) -> None:
    """A closed panelled door with a frame and a handle, its middle at ``along``."""
    w, h = b.between(0.8, 0.95), 2.05
    leaf = b.wood() if b.chance(0.5) else b.plain(b.color(light=0.7), gloss=0.5)
    at = wall.spot(along)
    b.block([0, h / 2, 0.015], [w, h, 0.03], leaf, at=at)
    raised = []
    for y0, y1 in ((0.15, 0.9), (1.05, h - 0.15)):
        for x in (-w / 4, w / 4):
            raised.append(box([x, (y0 + y1) / 2, 0.035], [w / 2 - 0.14, y1 - y0, 0.014]))
    b.add(join(raised), leaf, at=at)
    rim = [box([s * (w / 2 + 0.04), h / 2, 0.02], [0.08, h + 0.08, 0.05]) for s in (-1, 1)]
    rim.append(box([0, h + 0.04, 0.02], [w, 0.08, 0.05]))
    b.add(join(rim), b.plain(b.color(light=0.75)), at=at)
    knob = tube(
        [[w / 2 - 0.08, 1.0, 0.03], [w / 2 - 0.08, 1.0, 0.08], [w / 2 - 0.18, 1.0, 0.085]], 0.009
    )
    b.add(knob, b.metal(), at=at)


def skirting(b: Builder, all_walls: Sequence[Wall]) -> None:
    """A board along the foot of the walls, cut where openings reach the floor."""
    board = b.plain(b.color(light=0.75)) if b.chance(0.6) else b.wood()
    h = b.between(0.06, 0.14)
    for wall in all_walls:
        if wall.clear(0, wall.length, 0, h):
            b.block([wall.length / 2, h / 2, 0.008], [wall.length, h, 0.016], board, at=wall.frame)


def column(b: Builder, at: np.ndarray, radius: float, height: float) -> None:
    """A column with foot and head."""
    stone = b.stone()
    b.add(cylinder([0, 0.1, 0], radius, height - 0.2, segments=32), stone, at=at)
    for y in (0.05, height - 0.05):
        b.block([0, y, 0], [2.6 * radius, 0.1, 2.6 * radius], stone, at=at)

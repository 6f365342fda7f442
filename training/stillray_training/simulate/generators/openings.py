"""Windows as real rooms have them: muntins, grilles, lattices, blinds, shutters, curtains."""

from __future__ import annotations

import numpy as np

from stillray_training.simulate.generators.build import lift
from stillray_training.simulate.generators.home import Home
from stillray_training.simulate.generators.shell import THICK, Hole, Wall, curtains
from stillray_training.simulate.mesh import Mesh, box, join, quad, rotation, tube
from stillray_training.simulate.world import Surface


def opening(b: Home, wall: Wall, hole: Hole) -> None:
    """What stands in and before an opening: frame, thin bars, sill, blinds or curtains."""
    le, bo, r, t = hole
    w, h = r - le, t - bo
    at = wall.spot(le, bo, -THICK * 0.7)
    paint = b.plain(b.color(light=b.between(0.03, 0.1)) if b.chance(0.45) else b.off_white())
    edge = b.between(0.035, 0.06)
    frame = [box([w / 2, y, 0], [w, edge, 0.05]) for y in (edge / 2, h - edge / 2)]
    frame += [box([x, h / 2, 0], [edge, h, 0.05]) for x in (edge / 2, w - edge / 2)]
    style = b.pick("muntins", "casement", "grille", "lattice", p=[0.45, 0.2, 0.2, 0.15])
    b.add(join(frame + BARS[style](b, w, h)), paint, at=at)
    b.block(
        [w / 2, -0.02, THICK * 0.75], [w + 0.1, 0.03, THICK * 0.9], b.plain(b.off_white()), at=at
    )
    dressing = b.pick(
        "none", "curtains", "venetian", "vertical", "shutters", p=[0.34, 0.18, 0.28, 0.1, 0.1]
    )
    if dressing == "curtains":
        _curtains(b, wall, hole)
    elif dressing == "venetian":
        venetian(b, at @ lift(0, 0, 0.1), w, h)
    elif dressing == "vertical":
        vertical(b, at @ lift(0, 0, 0.09), w, h)
    elif dressing == "shutters":
        shutters(b, wall, hole)


def _muntins(b: Home, w: float, h: float) -> list[Mesh]:
    """Bars of a few centimetres and less that part a window into small panes."""
    pane, thick = b.between(0.2, 0.5), b.between(0.01, 0.028)
    across, down = max(2, round(w / pane)), max(2, round(h / (pane * b.between(1.0, 1.6))))
    bars = [box([w * i / across, h / 2, 0], [thick, h, 0.03]) for i in range(1, across)]
    return bars + [box([w / 2, h * i / down, 0], [w, thick, 0.03]) for i in range(1, down)]


def _casement(b: Home, w: float, h: float) -> list[Mesh]:
    """One or two wings, and perhaps a transom."""
    bars = [box([w / 2, h / 2, 0], [0.07, h, 0.055])]
    if b.chance(0.6):
        bars.append(box([w / 2, h * b.between(0.65, 0.8), 0], [w, 0.05, 0.05]))
    return bars


def _grille(b: Home, w: float, h: float) -> list[Mesh]:
    """Wrought rods before the window, with two rails."""
    radius, count = b.between(0.004, 0.01), max(3, round(w / b.between(0.08, 0.15)))
    out = -0.08  # on the window's outer side
    rods = [_rod([w * i / count, 0, out], [w * i / count, h, out], radius) for i in range(1, count)]
    rods += [_rod([0, h * y, out], [w, h * y, out], radius) for y in (0.15, 0.5, 0.85)]
    return rods + _casement(b, w, h)


def _lattice(b: Home, w: float, h: float) -> list[Mesh]:
    """Lead cames in diamonds."""
    step, thick = b.between(0.1, 0.22), b.between(0.003, 0.007)
    rods = []
    for sign in (1, -1):
        for c in np.arange(-h, w + h, step):
            # x = c + y or x = c + h - y, cut to the opening
            y0, y1 = (
                (max(0.0, -c), min(h, w - c)) if sign > 0 else (max(0.0, c + h - w), min(h, c + h))
            )
            if y1 - y0 > 0.02:
                x0, x1 = (c + y0, c + y1) if sign > 0 else (c + h - y0, c + h - y1)
                rods.append(_rod([x0, y0, 0], [x1, y1, 0], thick, sides=4))
    return rods + _casement(b, w, h)


BARS = {"muntins": _muntins, "casement": _casement, "grille": _grille, "lattice": _lattice}


def _rod(start: list[float], end: list[float], radius: float, sides: int = 6) -> Mesh:
    ends = np.array([start, end], float)
    return tube([ends[0], ends.mean(axis=0), ends[1]], radius, sides=sides)


def venetian(b: Home, at: np.ndarray, w: float, h: float) -> None:
    """Slats across the opening, let down as far as may be, turned as may be, on cords."""
    step = b.between(0.026, 0.05)
    low = 0.01 if b.chance(0.5) else h * b.between(0.1, 0.6)
    slat = box([0, 0, 0], [w - 0.03, 0.0015, step * 1.1]).moved(
        rotation([1, 0, 0], b.between(5, 60) * (1 if b.chance(0.7) else -1))
    )
    paint = b.wood() if b.chance(0.3) else b.plain(b.color(light=b.between(0.3, 0.8)), gloss=0.5)
    places = [lift(w / 2, y, 0) for y in np.arange(h - 0.03, low, -step)]
    b.add(join([slat.moved(place) for place in places]), paint, at=at)
    cords = [_rod([x * w, low, 0.01], [x * w, h, 0.01], 0.0015, sides=4) for x in (0.12, 0.5, 0.88)]
    b.add(join(cords), b.plain(b.off_white(), gloss=0), at=at)
    b.block([w / 2, low, 0], [w - 0.02, 0.02, 0.03], paint, at=at)


def vertical(b: Home, at: np.ndarray, w: float, h: float) -> None:
    """Upright strips of cloth, all turned alike."""
    step = b.between(0.07, 0.11)
    turn = rotation([0, 1, 0], b.between(20, 80) * (1 if b.chance(0.5) else -1))
    strip = box([0, h / 2, 0], [step * 1.05, h - 0.06, 0.0015]).moved(turn)
    strips = [strip.moved(lift(x, 0, 0)) for x in np.arange(step, w * b.between(0.4, 1.0), step)]
    if strips:
        b.add(join(strips), b.fabric(), at=at)


def shutters(b: Home, wall: Wall, hole: Hole) -> None:
    """Louvred leaves on both sides of the opening, folded open against the wall."""
    le, bo, r, t = hole
    w, h = (r - le) * b.between(0.3, 0.5), t - bo
    leaf = b.carved("louvres", 1.0, 0.015)
    for x, side in ((le, -1), (r, 1)):
        turn = wall.spot(x, bo, 0.01) @ rotation([0, 1, 0], -side * b.between(5, 70))
        start = 0.0 if side > 0 else -w
        b.block([start + w / 2, h / 2, 0.012], [w, h, 0.024], leaf, at=turn)
        b.add(fitted(quad([start, 0, 0.0255], [w, 0, 0], [0, h, 0])), leaf, at=turn)


def _curtains(b: Home, wall: Wall, hole: Hole) -> None:
    le, _, r, t = hole
    if b.library is None or "curtain" not in b.library or b.chance(0.5):
        curtains(b, wall, hole)
        return
    asset = b.library.get("curtain")
    high = min(t + 0.1, wall.height - 0.03)
    scale = np.array([(r - le + 0.5) / asset.size[0], (high - 0.02) / asset.size[1], 1.0])
    b.place_asset(asset, wall.spot((le + r) / 2, 0.02, 0.16), scale, "")


def fitted(mesh: Mesh) -> Mesh:
    """A flat mesh whose whole extent shows a picture of size 1 once."""
    span = np.ptp(mesh.uvs, axis=0)
    uvs = (mesh.uvs - mesh.uvs.min(axis=0)) / np.maximum(span, 1e-9)
    return Mesh(vertices=mesh.vertices, normals=mesh.normals, uvs=uvs, faces=mesh.faces)


def railing(b: Home, at: np.ndarray, length: float, height: float) -> None:
    """Thin balusters under a hand rail, along x from the origin."""
    metal = b.plain(b.color(light=0.06)) if b.chance(0.5) else b.wood()
    radius, count = b.between(0.005, 0.014), max(4, round(length / b.between(0.07, 0.13)))
    rods = [_rod([length * i / count, 0.06, 0], [length * i / count, height, 0], radius)
            for i in range(count + 1)]  # fmt: skip
    b.add(join([*rods, _rod([0, 0.06, 0], [length, 0.06, 0], radius)]), metal, at=at)
    b.block([length / 2, height, 0], [length, 0.035, 0.05], b.wood(second=True), at=at)


def wire_chair(b: Home, at: np.ndarray) -> None:
    """A chair of bent wire: thin parts before whatever stands behind it."""
    group = b.can_move(f"wire_chair{len(b.spots)}", at, "floor")
    wire, w, seat, back = b.metal(), b.between(0.4, 0.48), 0.44, b.between(0.78, 0.9)
    rods = []
    for x in np.linspace(-w / 2, w / 2, int(b.rng.integers(8, 14))):
        line = [[x, seat, w], [x, seat - 0.015, w / 2], [x, seat, 0.03], [x, back, -0.1]]
        rods.append(tube(line, 0.003, sides=5))
    for y, z in ((seat, w), (seat, 0.03), (back, -0.1), ((seat + back) / 2, -0.035)):
        rods.append(_rod([-w / 2, y, z], [w / 2, y, z], 0.005))
    for x in (-w / 2, w / 2):
        for z, foot in ((w - 0.02, w + 0.03), (0.05, -0.03)):
            rods.append(_rod([x, 0, foot], [x, seat, z], 0.007))
    b.add(join(rods), wire, at=at, group=group)


def panelled_door(b: Home, wall: Wall, along: float) -> None:
    """A door whose panels are relief, its middle at ``along``."""
    w, h = b.between(0.8, 0.95), 2.05
    at = wall.spot(along)
    leaf = b.carved(b.pick("panels", "ribs", "louvres", p=[0.75, 0.15, 0.1]), 1.0, 0.02)
    b.block([0, h / 2, 0.012], [w, h, 0.024], Surface(color=leaf.color), at=at)
    b.add(fitted(quad([-w / 2, 0, 0.0255], [w, 0, 0], [0, h, 0])), leaf, at=at)
    rim = [box([s * (w / 2 + 0.04), h / 2, 0.02], [0.08, h + 0.08, 0.05]) for s in (-1, 1)]
    rim.append(box([0, h + 0.04, 0.02], [w, 0.08, 0.05]))
    b.add(join(rim), b.plain(b.off_white()), at=at)
    x = w / 2 - 0.08
    b.add(tube([[x, 1.0, 0.03], [x, 1.0, 0.08], [x - 0.1, 1.0, 0.085]], 0.009), b.metal(), at=at)

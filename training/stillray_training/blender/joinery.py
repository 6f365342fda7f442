"""Joinery of a painted room: mouldings, panels, doors, coffers, all of which normals alone show.

White relief is what a denoiser that was never shown any takes for noise: nothing but normals and a
little shade tells it, and where light is noisy only normals do.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from random import Random
from typing import Any

import bpy

from stillray_training.blender.parts import Material, Point, add, box, lathe

#: Of a moulding: how far each edge lies inside of a rectangle, and how far above it, metres.
Profile = list[tuple[float, float]]
#: Takes two coordinates in a plane and the height above it, metres, to the scene's.
Plane = Callable[[float, float, float], Point]
#: Low and high corner in a plane, metres.
Rectangle = tuple[tuple[float, float], tuple[float, float]]
_ARC = 5  # pieces of a quarter of a circle
_SHARP = math.radians(35)  # edges above it are not shaded smooth
_PROUD = 0.004  # metres before a wall, so that what is sunk does not lie in it


def paint(drawn: Random) -> Material:
    """What walls and joinery are painted with: white, or pale."""
    bright, warm = drawn.uniform(0.5, 0.85), drawn.uniform(0.0, 0.12)
    tint = (bright, bright * (1 - warm / 2), bright * (1 - warm))
    if drawn.random() < 0.25:
        red, green, blue = (bright * drawn.uniform(0.5, 1.0) for _ in range(3))
        tint = (red, green, blue)
    return Material("paint", tint, Roughness=drawn.uniform(0.25, 0.9))


def profile(drawn: Random, broad: float, high: float) -> Profile:
    """Fillets, coves, rounds and beads, ``high`` metres up from the plane over ``broad`` metres."""
    count = drawn.randint(2, 5)
    across = _parts(drawn, broad, count)
    up = _parts(drawn, high, count)
    points: Profile = [(0.0, 0.0)]
    for step, rise in zip(across, up, strict=True):
        x, z = points[-1]
        kind = drawn.choice(("fillet", "cove", "round", "slope", "bead"))
        if kind == "fillet":
            points += [(x, z + rise), (x + step, z + rise)]
        elif kind == "slope":
            points.append((x + step, z + rise))
        elif kind == "bead":
            turns = [math.pi * part / (2 * _ARC) for part in range(1, 2 * _ARC + 1)]
            half = step / 2
            points += [(x + half - half * math.cos(t), z + half * math.sin(t)) for t in turns]
            points.append((x + step, z + rise))
        else:
            turns = [math.pi / 2 * part / _ARC for part in range(1, _ARC + 1)]
            bent = [(1 - math.cos(t), math.sin(t)) for t in turns]
            if kind == "cove":
                bent = [(math.sin(t), 1 - math.cos(t)) for t in turns]
            points += [(x + step * a, z + rise * b) for a, b in bent]
    return points


def _parts(drawn: Random, whole: float, count: int) -> list[float]:
    """A length in random parts."""
    shares = [drawn.uniform(0.3, 1.0) for _ in range(count)]
    return [whole * share / sum(shares) for share in shares]


def moulded(
    around: Rectangle, edges: Sequence[tuple[float, float]], plane: Plane, material: Material,
    *, filled: bool = False,
) -> Any:  # fmt: skip
    """A moulding along the inside of a rectangle, mitred at its corners.

    Parameters
    ----------
    around
        The rectangle; an inset below 0 lies outside of it.
    edges
        See `Profile`.
    plane
        Where it lies.
    material
        Of all of it.
    filled
        Whether what is left inside is closed, at the height of the last edge.
    """
    (left, bottom), (right, top) = around
    points: list[Point] = []
    for inset, rise in edges:
        a, b, c, d = left + inset, right - inset, bottom + inset, top - inset
        points += [plane(u, v, rise) for u, v in ((a, c), (b, c), (b, d), (a, d))]
    faces: list[tuple[int, ...]] = [
        (4 * row + i, 4 * row + (i + 1) % 4, 4 * row + 4 + (i + 1) % 4, 4 * row + 4 + i)
        for row in range(len(edges) - 1)
        for i in range(4)
    ]
    if filled:
        last = 4 * (len(edges) - 1)
        faces.append((last, last + 1, last + 2, last + 3))
    return _faceted(points, faces, material)


def _faceted(points: list[Point], faces: list[tuple[int, ...]], material: Material) -> Any:
    """A mesh of flat faces and smooth rounds."""
    mesh = bpy.data.meshes.new("moulding")
    mesh.from_pydata(points, [], faces)
    mesh.shade_smooth()
    mesh.set_sharp_from_angle(angle=_SHARP)
    return add(mesh, material)


def fit_out(drawn: Random, size: Point, walls: Material, windows: str) -> None:
    """Joinery for a room from (0, 0, 0) to ``size``: along its edges and on its walls.

    Parameters
    ----------
    drawn
        Draws all of it.
    size
        Of the room, metres.
    walls
        What they are painted with.
    windows
        The wall that has some and is left as it is: ``back``, ``right``, or none.
    """
    width, depth, height = size
    wood = walls if drawn.random() < 0.6 else paint(drawn)
    floor: Rectangle = ((0.0, 0.0), (width, depth))
    if drawn.random() < 0.85:
        deep = drawn.uniform(0.05, 0.3)
        edges = profile(drawn, deep, deep * drawn.uniform(0.6, 1.6))
        down = max(rise for _, rise in edges)
        cornice = [(inset, _PROUD + down - rise) for inset, rise in reversed(edges)]
        moulded(floor, cornice, lambda u, v, h: (u, v, height - h), wood)
    if drawn.random() < 0.85:
        high = drawn.uniform(0.07, 0.3)
        edges = profile(drawn, high, drawn.uniform(0.015, 0.05))
        skirting = [(rise, high - across) for across, rise in edges]
        moulded(floor, [(skirting[-1][0], 0.0), *reversed(skirting)], _flat, wood)
    if drawn.random() < 0.5:
        _coffers(drawn, size, wood)
    elif drawn.random() < 0.5:
        _rose(drawn, size, wood)
    sides: dict[str, tuple[float, Plane]] = {
        "back": (width, lambda u, v, h: (u, depth - h, v)),
        "left": (depth, lambda u, v, h: (h, u, v)),
        "right": (depth, lambda u, v, h: (width - h, u, v)),
    }
    for name, (length, plane) in sides.items():
        fit = drawn.choice((_panels, _panels, _doors, _pilasters))
        if name != windows:
            fit(drawn, (length, height), plane, wood)


def _flat(u: float, v: float, h: float) -> Point:
    return u, v, h


def _panels(drawn: Random, size: tuple[float, float], plane: Plane, wood: Material) -> None:
    """Rows of frames, with or without raised fields, and a rail between."""
    length, height = size
    rail = drawn.uniform(0.5, 1.2)
    columns = max(1, round(length / drawn.uniform(0.35, 1.2)))
    gap = drawn.uniform(0.05, 0.15)
    broad = drawn.uniform(0.015, 0.07)
    high = drawn.uniform(0.008, 0.04)
    edges = profile(drawn, broad, high)
    back = profile(drawn, broad * drawn.uniform(0.3, 1.0), high * drawn.uniform(0.3, 1.0))
    inner = [(broad + x, _PROUD + high - rise) for x, rise in back]
    field = drawn.random() < 0.4
    if field:  # a field that rises again towards the middle
        start = inner[-1][0] + drawn.uniform(0.02, 0.06)
        inner += [(start, inner[-1][1]), (start + drawn.uniform(0.02, 0.06), high)]
    rows = [(0.25, rail - gap)]
    if drawn.random() < 0.6:
        rows.append((rail + gap, height - drawn.uniform(0.25, 0.5)))
    step = length / columns
    for low, top in rows:
        for column in range(columns):
            around = ((column * step + gap, low), ((column + 1) * step - gap, top))
            if min(step - 2 * gap, top - low) > 2.5 * inner[-1][0]:
                moulded(around, [*edges, *inner[1:]], plane, wood, filled=field)
    bar = profile(drawn, drawn.uniform(0.03, 0.09), drawn.uniform(0.015, 0.05))
    deep, tall = max(rise for _, rise in bar), bar[-1][0]
    ledge = [(0.0, 0.0), *((x, rise) for x, rise in bar), (tall, 0.0)]
    _run(ledge, (0.0, length), rail - deep / 2, plane, wood)


def _run(
    edges: Profile, along: tuple[float, float], at: float, plane: Plane, wood: Material
) -> None:
    """A straight piece along a plane's first coordinate, its lower edge at the second."""
    points = [plane(u, at + x, rise) for x, rise in edges for u in along]
    faces: list[tuple[int, ...]] = [
        (2 * i, 2 * i + 1, 2 * i + 3, 2 * i + 2) for i in range(len(edges) - 1)
    ]
    _faceted(points, faces, wood)


def _doors(drawn: Random, size: tuple[float, float], plane: Plane, wood: Material) -> None:
    """Doors or cupboards of sunk panels, with architraves."""
    length, height = size
    count = max(1, min(drawn.randint(1, 3), int(length / 1.4)))
    for index in range(count):
        broad, tall = drawn.uniform(0.6, 1.0), min(drawn.uniform(1.7, 2.2), height - 0.3)
        # each in a part of its own: faces in one plane are black
        left = length / count * index + drawn.uniform(0.15, length / count - broad - 0.15)
        frame = profile(drawn, drawn.uniform(0.05, 0.14), drawn.uniform(0.02, 0.05))
        # its outer edge at the wall, its inner at the leaf
        moulded(
            ((left - frame[-1][0], -0.2), (left + broad + frame[-1][0], tall + frame[-1][0])),
            [*frame, (frame[-1][0], 0.0)], plane, wood,
        )  # fmt: skip
        columns, rows = drawn.randint(1, 2), drawn.randint(1, 4)
        margin = drawn.uniform(0.06, 0.12)
        sunk = profile(drawn, drawn.uniform(0.01, 0.04), drawn.uniform(0.006, 0.02))
        deep = max(rise for _, rise in sunk)
        for column in range(columns):
            for row in range(rows):
                across, up = broad / columns, tall / rows
                low = (left + column * across + margin / 2, row * up + margin / 2)
                high = (left + (column + 1) * across - margin / 2, (row + 1) * up - margin / 2)
                edges = [(x, _PROUD + deep - rise) for x, rise in sunk]
                moulded((low, high), [(0.0, 0.0), *edges], plane, wood, filled=True)


def _pilasters(drawn: Random, size: tuple[float, float], plane: Plane, wood: Material) -> None:
    """Flat columns with flutes, bases and capitals."""
    length, height = size
    broad, deep = drawn.uniform(0.12, 0.35), drawn.uniform(0.02, 0.07)
    flutes = drawn.randint(2, 7)
    apart = drawn.uniform(0.9, 2.0)
    for index in range(max(1, int(length / apart))):
        left = index * apart + drawn.uniform(0.1, 0.3)
        steps = [math.pi * part / 8 for part in range(9)]
        points = [(0.0, 0.0), (0.0, deep)]
        for flute in range(flutes):
            each = broad / flutes
            points += [
                (flute * each + each * (0.1 + 0.4 * (1 - math.cos(t))),
                 deep - each * 0.35 * math.sin(t))
                for t in steps
            ]  # fmt: skip
        points += [(broad, deep), (broad, 0.0)]
        along = (0.0, height)
        _run(points, along, left, lambda u, v, h: plane(v, u, h), wood)
        for low, high in ((0.0, drawn.uniform(0.1, 0.3)), (height - 0.35, height - 0.1)):
            edges = profile(drawn, deep, deep)
            moulded(
                ((left - deep, low), (left + broad + deep, high)),
                [(x, 1.2 * deep + rise) for x, rise in edges], plane, wood, filled=True,
            )  # fmt: skip


def _coffers(drawn: Random, size: Point, wood: Material) -> None:
    """A ceiling of sunk squares."""
    width, depth, height = size
    step, beam = drawn.uniform(0.4, 1.1), drawn.uniform(0.06, 0.18)
    columns, rows = max(1, round(width / step)), max(1, round(depth / step))
    edges = profile(drawn, drawn.uniform(0.02, 0.1), drawn.uniform(0.02, 0.1))
    deep = max(rise for _, rise in edges)
    for column in range(columns):
        for row in range(rows):
            low = (width * column / columns + beam / 2, depth * row / rows + beam / 2)
            high = (width * (column + 1) / columns - beam / 2, depth * (row + 1) / rows - beam / 2)
            moulded((low, high), edges, lambda u, v, h: (u, v, height - deep + h), wood)
    for column in range(columns + 1):
        x = width * column / columns
        box((x - beam / 2, 0, height - deep), (x + beam / 2, depth, height), wood)
    for row in range(rows + 1):
        y = depth * row / rows
        # not in one plane with the others
        box((0, y - beam / 2, height - deep + _PROUD), (width, y + beam / 2, height), wood)


def _rose(drawn: Random, size: Point, wood: Material) -> None:
    """Rings around the middle of a ceiling."""
    width, depth, height = size
    edges = profile(drawn, drawn.uniform(0.15, 0.5), drawn.uniform(0.03, 0.12))
    rings = [(edges[-1][0] - x, -rise) for x, rise in edges]
    lathe(rings[::-1], (width / 2, depth * drawn.uniform(0.4, 0.8), height), wood)

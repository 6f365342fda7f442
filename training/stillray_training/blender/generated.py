"""Scenes of a seed to learn from: rooms, things on a table, places outdoors.

None is a scene of validation (`interior`, `objects`, `moving_shadow`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import bpy
from mathutils import Matrix, Vector

from stillray_training.blender import joinery
from stillray_training.blender.daylight import bright_wall, pierced, sky, sun
from stillray_training.blender.materials import color, material
from stillray_training.blender.parts import (
    Material,
    Point,
    add,
    background,
    ball,
    box,
    camera,
    key,
    lathe,
    light,
    primitive,
    rod,
    torus,
)
from stillray_training.blender.place import Place

_TRIES = 60  # at a place for the camera


def build(kind: str, seed: int, assets: Path | None, frames: int, motion: float = 1.0) -> list[str]:
    """A scene, its camera, and what moves over frames -1 to ``frames``; the assets in it.

    Parameters
    ----------
    kind
        Of `KINDS`.
    seed
        Other seeds give other scenes.
    assets
        Folder of licensed objects to stand about; None for none.
    frames
        How many will be rendered.
    motion
        The camera moves 1 to this many times as far, 1 or more: by 1, about 1.5 of 128 pixels a
        frame.
    """
    place = Place(Random(f"{kind} {seed}"), assets)
    KINDS[kind](place)
    # drawn by itself: whatever the motion, a seed gives the same scene
    _move(place, frames, motion ** Random(f"motion {seed}").random())
    return sorted(place.used)


def _room(place: Place) -> None:
    drawn = place.drawn
    width, depth, height = drawn.uniform(2.6, 6), drawn.uniform(3, 7), drawn.uniform(2.3, 3.4)
    walls = material(drawn, grain=1.5)
    ceiling = Material("ceiling", (0.8, 0.8, 0.78), Roughness=0.9)
    windows = _shell(place, (width, depth, height), walls, ceiling)
    _trim(place, width, depth)
    for _ in range(drawn.randint(3, 8)):
        at = (drawn.uniform(0.4, width - 0.4), drawn.uniform(0.8, depth - 0.3), 0.0)
        drawn.choice((_table, _chair, _shelf, _block, _plant, _standing_lamp, _rug, _furniture))(
            place, at
        )
    for _ in range(drawn.randint(1, 5)):
        _picture(place, width, depth, height)
    _room_lamps(place, width, depth, height, dark=not windows)
    _look(place, (0.3, 0.3, 0.5), (width - 0.3, depth * 0.5, min(1.9, height - 0.3)),
          (0.2, depth * 0.6, 0.2), (width - 0.2, depth - 0.1, height * 0.7), (18, 50))  # fmt: skip


def _panelled(place: Place) -> None:
    """A room whose walls and joinery are painted alike, so that little but normals tells them."""
    drawn = place.drawn
    width, depth, height = drawn.uniform(2.6, 6), drawn.uniform(3, 7), drawn.uniform(2.3, 3.6)
    walls = joinery.paint(drawn)
    ceiling = walls if drawn.random() < 0.5 else joinery.paint(drawn)
    windows = _shell(place, (width, depth, height), walls, ceiling)
    joinery.fit_out(drawn, (width, depth, height), walls, windows)
    for _ in range(drawn.randint(0, 5)):
        at = (drawn.uniform(0.4, width - 0.4), drawn.uniform(0.8, depth - 0.3), 0.0)
        drawn.choice((_table, _chair, _plant, _standing_lamp, _furniture, _tub))(place, at)
    _room_lamps(place, width, depth, height, dark=not windows)
    _look(place, (0.3, 0.3, 0.5), (width - 0.3, depth * 0.6, min(1.9, height - 0.3)),
          (0.0, depth * 0.5, 0.2), (width, depth, height), (18, 70))  # fmt: skip


def _backlit(place: Place) -> None:
    """A room that is looked at against its windows, or at what a mirror shows of them."""
    drawn = place.drawn
    width, depth, height = drawn.uniform(2.6, 5), drawn.uniform(2.6, 5.5), drawn.uniform(2.3, 3.4)
    walls = joinery.paint(drawn) if drawn.random() < 0.5 else material(drawn, grain=1.5)
    ceiling = Material("ceiling", (0.8, 0.8, 0.78), Roughness=0.9)
    box((-0.1, -0.1, -0.1), (width + 0.1, depth + 0.1, 0), material(drawn, grain=1.5))
    box((-0.1, -0.1, height), (width + 0.1, depth + 0.1, height + 0.1), ceiling)
    box((-0.1, -0.1, 0), (width + 0.1, 0, height), walls)
    box((-0.1, 0, 0), (0, depth, height), walls)
    bright_wall(place, width, (depth, height), walls, side=False)
    if drawn.random() < 0.4:
        bright_wall(place, depth, (width, height), walls, side=True)
    else:
        box((width, 0, 0), (width + 0.1, depth, height), walls)
    sky(place)
    mirrored = drawn.random() < 0.35
    if mirrored:
        _mirror(drawn, depth, height)
    for _ in range(drawn.randint(2, 7)):
        at = (drawn.uniform(0.4, width - 0.4), drawn.uniform(depth * 0.4, depth - 0.3), 0.0)
        drawn.choice((_chair, _chair, _table, _plant, _standing_lamp, _furniture, _tub, _block))(
            place, at
        )
    if drawn.random() < 0.3:
        _room_lamps(place, width, depth, height, dark=False)
    near, far = (0.3, 0.2, 0.4), (width - 0.3, depth * 0.5, min(1.9, height - 0.3))
    low, high = (0.1, depth, 0.3), (width - 0.1, depth + 0.1, height * 0.85)
    if mirrored and drawn.random() < 0.6:  # from beside the windows
        near, far = (width * 0.4, depth * 0.3, 0.6), (width - 0.3, depth * 0.8, 1.8)
        low, high = (0.0, depth * 0.3, 0.8), (0.1, depth * 0.9, height * 0.8)
    _look(place, near, far, low, high, (18, 60))


def _mirror(drawn: Random, depth: float, height: float) -> None:
    """On the wall at x = 0, with or without a frame."""
    broad, low = drawn.uniform(0.4, depth * 0.45), drawn.uniform(0.3, 1.1)
    middle, top = drawn.uniform(broad, depth - broad), height - drawn.uniform(0.2, 0.7)
    glass = Material("mirror", (0.9, 0.9, 0.9), Metallic=1.0, Roughness=0.0)
    box((0.0, middle - broad, low), (0.02, middle + broad, top), glass)
    if drawn.random() < 0.7:
        frame, rim = material(drawn, grain=0.1), drawn.uniform(0.01, 0.06)
        for a, b in ((low - rim, low), (top, top + rim)):
            box((0.0, middle - broad - rim, a), (0.035, middle + broad + rim, b), frame)
        for y in (middle - broad - rim, middle + broad):
            box((0.0, y, low), (0.034, y + rim, top), frame)


def _tub(place: Place, at: Point) -> None:
    """A white bowl with a thick rim, and folds in it."""
    drawn, (x, y, z) = place.drawn, at
    white = Material("enamel", (0.8, 0.8, 0.78), Roughness=drawn.uniform(0.1, 0.6))
    broad, high, rim = drawn.uniform(0.3, 0.6), drawn.uniform(0.3, 0.6), drawn.uniform(0.02, 0.06)
    turns = [math.pi * part / 8 for part in range(9)]
    edge = [(broad + rim - rim * math.cos(t), high + rim * math.sin(t)) for t in turns]
    inside = [(0, 0.08), (broad * 0.7, 0.1), (broad * 0.9, 0.2)]
    bowl = lathe([*inside, *edge, (broad * 0.8, 0.0)], at, white)
    bowl.scale = (1, drawn.uniform(1.0, 1.8), 1)
    if drawn.random() < 0.6:
        folds = add(_folds(drawn, broad * 1.2), white, (x, y, z + high * drawn.uniform(0.5, 0.9)))
        folds.scale = (1, bowl.scale[1], 1)


def _shell(place: Place, size: Point, walls: Material, ceiling: Material) -> str:
    """Floor, ceiling and walls from (0, 0, 0) to ``size``; which has windows: back, right, none."""
    drawn, (width, depth, height) = place.drawn, size
    box((-0.1, -0.1, -0.1), (width + 0.1, depth + 0.1, 0), material(drawn, grain=1.5))
    box((-0.1, -0.1, height), (width + 0.1, depth + 0.1, height + 0.1), ceiling)
    box((-0.1, 0, 0), (0, depth, height), walls)
    box((-0.1, -0.1, 0), (width + 0.1, 0, height), walls)
    other = walls if drawn.random() < 0.6 else material(drawn, grain=1.5)
    sunny = drawn.random() < 0.7
    if sunny and drawn.random() < 0.5:
        pierced(place, width, (depth, height), other, side=False)
        box((width, 0, 0), (width + 0.1, depth, height), walls)
        return "back"
    box((-0.1, depth, 0), (width + 0.1, depth + 0.1, height), other)
    if sunny:
        pierced(place, depth, (width, height), walls, side=True)
        return "right"
    box((width, 0, 0), (width + 0.1, depth, height), walls)
    return ""


def _trim(place: Place, width: float, depth: float) -> None:
    drawn = place.drawn
    if drawn.random() < 0.5:
        return
    stuff, high = Material("trim", color(drawn), Roughness=0.4), drawn.uniform(0.05, 0.15)
    for low, far in (
        ((0.0, 0.0, 0.0), (0.015, depth, high)),
        ((width - 0.015, 0.0, 0.0), (width, depth, high)),
        ((0.0, depth - 0.015, 0.0), (width, depth, high)),
    ):
        box(low, far, stuff, bevel=0.004)
    if drawn.random() < 0.6:  # panels whose frames stand out
        z, step = drawn.uniform(0.3, 0.8), drawn.uniform(0.3, 0.8)
        for index in range(int(width / step)):
            x = index * step + 0.05
            for (left, bottom), (right, top) in (
                ((x, z), (x + step - 0.1, z + 0.02)), ((x, z + 0.7), (x + step - 0.1, z + 0.72)),
                ((x, z), (x + 0.02, z + 0.7)), ((x + step - 0.12, z), (x + step - 0.1, z + 0.7)),
            ):  # fmt: skip
                box((left, depth - 0.012, bottom), (right, depth, top), stuff, bevel=0.003)


def _room_lamps(place: Place, width: float, depth: float, height: float, *, dark: bool) -> None:
    drawn = place.drawn
    for _ in range(drawn.randint(1, 3) if dark else drawn.randint(0, 1)):
        x, y = drawn.uniform(0.5, width - 0.5), drawn.uniform(0.5, depth - 0.5)
        warm = (1.0, drawn.uniform(0.6, 1), drawn.uniform(0.3, 1))
        power = drawn.uniform(15, 150)
        if drawn.random() < 0.6:
            size = drawn.uniform(0.1, 1.2)
            lamp = light("AREA", (x, y, height - 0.02), (x, y, 0), power, size=size, color=warm)
        else:
            z, size = drawn.uniform(1.2, height - 0.2), drawn.uniform(0.01, 0.15)
            lamp = light(
                "POINT", (x, y, z), (x, y, 0), power / 2, shadow_soft_size=size, color=warm
            )
        place.lamps.append(lamp)


def _table(place: Place, at: Point) -> None:
    drawn, (x, y, _) = place.drawn, at
    high = drawn.uniform(0.4, 0.85)
    broad, deep = drawn.uniform(0.3, 0.8), drawn.uniform(0.25, 0.5)
    stuff, leg = material(drawn, grain=0.5), drawn.uniform(0.01, 0.04)
    box((x - broad, y - deep, high - 0.04), (x + broad, y + deep, high), stuff, bevel=0.005)
    for a in (-1, 1):
        for b in (-1, 1):
            foot = (x + a * (broad - 0.05), y + b * (deep - 0.05), 0.0)
            rod(foot, (foot[0], foot[1], high - 0.04), leg, stuff)
    for _ in range(drawn.randint(1, 6)):
        spot = (x + drawn.uniform(-broad, broad) * 0.8, y + drawn.uniform(-deep, deep) * 0.8, high)
        _object(place, spot, drawn.uniform(0.08, 0.35))


def _chair(place: Place, at: Point) -> None:
    drawn, (x, y, _) = place.drawn, at
    if drawn.random() < 0.3 and place.asset(at, None, "chair monobloc_chair painted_stool"):
        return
    stuff, seat, slim = (
        material(drawn, grain=0.4),
        drawn.uniform(0.4, 0.5),
        drawn.uniform(0.01, 0.025),
    )
    box((x - 0.22, y - 0.22, seat), (x + 0.22, y + 0.22, seat + 0.04), stuff, bevel=0.01)
    back = drawn.choice((-1, 1)) * 0.2
    for a in (-0.2, 0.2):
        rod((x + a, y - back, 0), (x + a, y - back, seat), slim, stuff)
        rod((x + a, y + back, 0), (x + a, y + back * 1.3, 0.95), slim, stuff)
    for part in range(drawn.randint(2, 7)):
        z = 0.55 + 0.4 * part / 7
        rod((x - 0.2, y + back * 1.2, z), (x + 0.2, y + back * 1.2, z), slim * 0.7, stuff)


def _shelf(place: Place, at: Point) -> None:
    drawn, (x, y, _) = place.drawn, at
    stuff, broad, high = (
        material(drawn, grain=0.5),
        drawn.uniform(0.4, 0.9),
        drawn.uniform(0.8, 2.0),
    )
    for side in (-1, 1):
        box(
            (x + side * broad - 0.015, y - 0.15, 0),
            (x + side * broad + 0.015, y + 0.15, high),
            stuff,
        )
    levels = drawn.randint(2, 5)
    covers = [material(drawn, grain=0.2) for _ in range(5)]
    for level in range(levels + 1):
        z = 0.05 + (high - 0.1) * level / levels
        box((x - broad, y - 0.15, z), (x + broad, y + 0.15, z + 0.02), stuff)
        edge = x - broad + 0.03
        while level < levels and edge < x + broad * drawn.uniform(0.2, 1) - 0.05:
            thick, tall = drawn.uniform(0.01, 0.05), drawn.uniform(0.12, 0.26)
            near = y - drawn.uniform(0.05, 0.13)
            box((edge, near, z + 0.02), (edge + thick, y + 0.12, z + 0.02 + tall),
                drawn.choice(covers))  # fmt: skip
            edge += thick + 0.002


def _block(place: Place, at: Point) -> None:
    drawn, (x, y, _) = place.drawn, at
    a, b, c = drawn.uniform(0.2, 0.8), drawn.uniform(0.2, 0.45), drawn.uniform(0.2, 1.2)
    bevel = drawn.choice((0.0, 0.01, 0.06))
    stuff = material(drawn, grain=0.6)
    thing = box((x - a, y - b, 0), (x + a, y + b, c), stuff, bevel=bevel)
    place.things.append(thing)
    if drawn.random() < 0.6:
        _object(place, (x, y, c), drawn.uniform(0.1, 0.4))


def _plant(place: Place, at: Point) -> None:
    drawn, (x, y, z) = place.drawn, at
    if drawn.random() < 0.5 and place.asset(at, drawn.uniform(0.5, 1.6), "fern tall_plant bush"):
        return
    pot = material(drawn, grain=0.3)
    lathe([(0, 0), (0.12, 0), (0.17, 0.28), (0.15, 0.28), (0, 0.25)], at, pot)
    green = Material("leaf", (0.05, drawn.uniform(0.15, 0.4), 0.04), Roughness=0.5)
    for _ in range(drawn.randint(8, 40)):
        turn, far = drawn.uniform(0, 2 * math.pi), drawn.uniform(0.05, 0.5)
        tip = (x + far * math.cos(turn), y + far * math.sin(turn), z + drawn.uniform(0.4, 1.2))
        rod((x, y, z + 0.25), tip, 0.004, green)
        leaf = ball(tip, drawn.uniform(0.03, 0.1), green)
        leaf.scale = (1, drawn.uniform(0.2, 0.6), 0.05)
        leaf.rotation_euler = tuple(drawn.uniform(0, 3) for _ in range(3))


def _standing_lamp(place: Place, at: Point) -> None:
    drawn, (x, y, _) = place.drawn, at
    metal, high = material(drawn, grain=0.2), drawn.uniform(0.5, 1.7)
    rod((x, y, 0), (x, y, high), drawn.uniform(0.006, 0.02), metal)
    lathe([(0, 0), (0.14, 0), (0.14, 0.02), (0, 0.03)], at, metal)
    shade = Material("shade", color(drawn), Roughness=0.9)
    lathe([(0.17, 0), (0.1, 0.25)], (x, y, high), shade)
    bulb = Material("bulb", (1, 1, 1))
    bulb.surface.inputs["Emission Color"].default_value = (1, drawn.uniform(0.6, 1), 0.5, 1)
    bulb.surface.inputs["Emission Strength"].default_value = drawn.uniform(5, 80)
    ball((x, y, high + 0.1), drawn.uniform(0.02, 0.05), bulb)


def _rug(place: Place, at: Point) -> None:
    drawn, (x, y, _) = place.drawn, at
    a, b = drawn.uniform(0.4, 1.2), drawn.uniform(0.4, 1.2)
    box((x - a, y - b, 0.001), (x + a, y + b, 0.012), material(drawn, grain=0.5))


def _furniture(place: Place, at: Point) -> None:
    kinds = "bookshelf_worn modern_armchair painted_cabinet painted_cabinet_02 sofa_03 lantern"
    if not place.asset(at, None, kinds):
        _block(place, at)


def _picture(place: Place, width: float, depth: float, height: float) -> None:
    drawn = place.drawn
    a, b = drawn.uniform(0.1, 0.5), drawn.uniform(0.1, 0.4)
    x, z = drawn.uniform(a, width - a), drawn.uniform(1.0, height - 0.5)
    frame = material(drawn, grain=0.1)
    box((x - a, depth - 0.03, z - b), (x + a, depth, z + b), frame, bevel=0.004)
    box((x - a + 0.03, depth - 0.032, z - b + 0.03), (x + a - 0.03, depth - 0.01, z + b - 0.03),
        material(drawn, grain=drawn.uniform(0.1, 0.5)))  # fmt: skip


def _object(place: Place, at: Point, size: float) -> None:
    """One of a dozen things of about ``size`` metres that stand on a point."""
    drawn, (x, y, z) = place.drawn, at
    if drawn.random() < 0.35 and place.asset(at, size):
        return
    stuff = material(drawn, grain=size, opaque=False)
    kind = drawn.choice(("ball", "box", "vase", "ring", "head", "wires", "rods", "cloth"))
    half = size / 2
    if kind == "ball":
        thing = ball((x, y, z + half), half, stuff)
    elif kind == "box":
        a, b, c = (half * drawn.uniform(0.3, 1) for _ in range(3))
        thing = box((-a, -b, -c), (a, b, c), stuff, bevel=drawn.choice((0.0, half * 0.1)))
        thing.location, thing.rotation_euler = (x, y, z + c), (0, 0, drawn.uniform(0, 3))
    elif kind == "vase":
        steps = drawn.randint(4, 9)
        profile = [
            (half * drawn.uniform(0.2, 0.8), size * step / steps) for step in range(steps + 1)
        ]
        thing = lathe([(0, 0), *profile], (x, y, z), stuff)
        thing.modifiers.new("smooth", "SUBSURF").render_levels = 2
    elif kind == "ring":
        thing = torus((x, y, z + half * 0.25), half * 0.75, half * 0.25, stuff)
    elif kind == "head":
        mesh = primitive("monkey", matrix=Matrix.Scale(half, 4))
        mesh.shade_smooth()
        thing = add(mesh, stuff, (x, y, z + half * 0.9))
        thing.rotation_euler = (0, 0, drawn.uniform(0, 6))
        thing.modifiers.new("smooth", "SUBSURF").render_levels = 1
    elif kind == "wires":
        thing = add(primitive("icosphere", subdivisions=drawn.randint(1, 3), radius=half), stuff,
                    (x, y, z + half))  # fmt: skip
        thing.modifiers.new("wires", "WIREFRAME").thickness = size * drawn.uniform(0.01, 0.05)
    elif kind == "cloth":
        thing = add(_folds(drawn, size), stuff, (x, y, z + 0.02 * size))
    else:
        for _ in range(drawn.randint(3, 14)):
            tip = (
                x + drawn.uniform(-half, half),
                y + drawn.uniform(-half, half),
                z + size * drawn.uniform(0.5, 1),
            )
            thing = rod((x, y, z), tip, size * drawn.uniform(0.004, 0.03), stuff)
    place.things.append(thing)


def _folds(drawn: Random, size: float) -> Any:
    mesh = primitive("grid", x_segments=60, y_segments=60, size=size / 2)
    waves = [
        (
            drawn.uniform(5, 40) / size,
            drawn.uniform(5, 40) / size,
            drawn.uniform(0.002, 0.03) * size,
        )
        for _ in range(4)
    ]
    for point in mesh.vertices:
        x, y, _ = point.co
        point.co.z = sum(high * math.sin(a * x + b * y) for a, b, high in waves)
    mesh.shade_smooth()
    return mesh


def _tabletop(place: Place) -> None:
    drawn = place.drawn
    box((-3, -3, -0.1), (3, 3, 0), material(drawn, grain=0.8))
    if drawn.random() < 0.7:
        box((-4, drawn.uniform(1.2, 2.8), -1), (4, 3.2, 4), material(drawn, grain=1.0))
    for _ in range(drawn.randint(5, 16)):
        at = (drawn.uniform(-1.1, 1.1), drawn.uniform(-0.7, 1.1), 0.0)
        _object(place, at, drawn.uniform(0.15, 0.75))
    for _ in range(drawn.randint(1, 3)):
        far, turn = drawn.uniform(2, 5), drawn.uniform(0, 2 * math.pi)
        at = (far * math.cos(turn), -abs(far * math.sin(turn)), drawn.uniform(1, 4.5))
        tint = (1.0, drawn.uniform(0.7, 1), drawn.uniform(0.5, 1))
        size, power = drawn.choice((0.05, 0.4, 1.0, 2.5)), drawn.uniform(30, 300)
        place.lamps.append(light("AREA", at, (0, 0.2, 0.2), power, size=size, color=tint))
    if drawn.random() < 0.25:
        sky(place)
        sun(place, (drawn.uniform(-3, 3), -3, 4), (0, 0, 0))
    else:
        background(color(drawn), drawn.uniform(0.0, 0.4))
    _look(place, (-1.5, -3.8, 0.3), (1.5, -2.0, 2.5), (-0.5, -0.2, 0.1), (0.5, 0.5, 0.5), (25, 80))
    if drawn.random() < 0.2:
        lens = bpy.context.scene.camera.data.dof
        lens.use_dof, lens.aperture_fstop = True, drawn.uniform(0.1, 1.0)
        lens.focus_distance = drawn.uniform(2, 4)


def _outdoors(place: Place) -> None:
    drawn = place.drawn
    ground = add(_hills(drawn), material(drawn, grain=2.0))
    ground.location = (0, 6, 0)
    for _ in range(drawn.randint(1, 5)):
        _house(place, (drawn.uniform(-9, 9), drawn.uniform(5, 20), -0.3))
    if drawn.random() < 0.7:
        _fence(place, drawn.uniform(0.5, 5))
    for _ in range(drawn.randint(1, 5)):
        at = (drawn.uniform(-5, 5), drawn.uniform(0.5, 10), 0.0)
        chosen = drawn.choice((_plant, _block, _table, _greenery, _furniture))
        chosen(place, at)
    for _ in range(drawn.randint(1, 6)):
        at = (drawn.uniform(-2.5, 2.5), drawn.uniform(-0.5, 4), 0.0)
        _object(place, at, drawn.uniform(0.3, 1.2))
    sky(place)
    sun(place, (drawn.uniform(-8, 8), drawn.uniform(-8, 6), drawn.uniform(2, 9)), (0, 2, 0))
    _look(place, (-3, -6, 0.5), (3, -2.5, 3.0), (-1, 2, 0.2), (1, 6, 1.5), (20, 60))


def _hills(drawn: Random) -> Any:
    mesh = primitive("grid", x_segments=80, y_segments=80, size=15)
    rough = drawn.choice((0.0, 0.0, drawn.uniform(0.02, 0.15)))
    waves = [(drawn.uniform(-3, 3), drawn.uniform(-3, 3), drawn.random()) for _ in range(8)]
    for point in mesh.vertices:
        x, y, _ = point.co
        point.co.z = rough * sum(high * math.sin(a * x + b * y) for a, b, high in waves) - rough
    mesh.shade_smooth()
    return mesh


def _house(place: Place, at: Point) -> None:
    drawn, (x, y, z) = place.drawn, at
    a, b, c = drawn.uniform(1, 3), drawn.uniform(1, 3), drawn.uniform(2, 7)
    box((x - a, y - b, z), (x + a, y + b, z + c), material(drawn, grain=1.5))
    glass = Material("panes", (0.02, 0.03, 0.04), Roughness=0.05)
    frame = Material("frame", color(drawn), Roughness=0.5)
    columns, rows = drawn.randint(2, 6), drawn.randint(1, 5)
    for column in range(columns):
        for row in range(rows):
            u, v = x - a + 2 * a * (column + 0.5) / columns, z + c * (row + 0.5) / rows
            p, q = 0.35 * a / columns * 2, 0.3 * c / rows
            front = y - b
            box((u - p, front - 0.01, v - q), (u + p, front + 0.05, v + q), glass)
            box((u - p, front - 0.05, v - q - 0.06), (u + p, front, v - q), frame)
            box((u - 0.02, front - 0.03, v - q), (u + 0.02, front, v + q), frame)
            box((u - p, front - 0.03, v - 0.02), (u + p, front, v + 0.02), frame)


def _fence(place: Place, y: float) -> None:
    drawn = place.drawn
    stuff, step, high = (
        material(drawn, grain=0.3),
        drawn.uniform(0.08, 0.4),
        drawn.uniform(0.6, 1.5),
    )
    slim = drawn.uniform(0.006, 0.03)
    for index in range(int(8 / step)):
        x = -4 + index * step
        rod((x, y, -0.1), (x, y, high), slim, stuff)
    for z in (0.15, high - 0.1):
        rod((-4, y, z), (4, y, z), slim * 1.5, stuff)


def _greenery(place: Place, at: Point) -> None:
    if not place.asset(at, None, "bush tree_a meadow_patch fern"):
        _plant(place, at)


KINDS: dict[str, Callable[[Place], None]] = {
    "cycles_room": _room,
    "cycles_table": _tabletop,
    "cycles_outdoors": _outdoors,
    "cycles_panelled": _panelled,
    "cycles_backlit": _backlit,
}


def _look(
    place: Place, near: Point, far: Point, low: Point, high: Point, lens: tuple[float, float]
) -> None:
    """A camera in one box that looks into another, with some room before it."""
    drawn = place.drawn
    thing = camera(near, low, drawn.uniform(*lens))
    bpy.context.view_layer.update()
    for _ in range(_TRIES):
        at, to = (
            Vector([drawn.uniform(a, b) for a, b in zip(*corners, strict=True)])
            for corners in ((near, far), (low, high))
        )
        if _open(at, to):
            break
    thing.location = at
    thing.rotation_euler = (to - at).to_track_quat("-Z", "Y").to_euler()


def _open(at: Vector, to: Vector) -> bool:
    """Whether next to nothing stands right before a camera."""
    scene, depsgraph = bpy.context.scene, bpy.context.evaluated_depsgraph_get()
    ahead = (to - at).normalized()
    side = ahead.orthogonal().normalized()
    up = ahead.cross(side)
    close = 0
    for across in (-0.4, -0.15, 0.15, 0.4):
        for down in (-0.4, -0.15, 0.15, 0.4):
            way = (ahead + across * side + down * up).normalized()
            hit, point, *_ = scene.ray_cast(depsgraph, at, way, distance=50)
            close += hit and (point - at).length < 0.7
    return close <= 2


def _move(place: Place, frames: int, further: float) -> None:
    """Key the camera, a thing or a lamp for frames -1 to ``frames``, in some scenes none."""
    drawn, middle = place.drawn, frames / 2
    if drawn.random() < 0.65:
        eye = bpy.context.scene.camera
        step = further * Vector([drawn.gauss(0, 0.02) for _ in range(3)])
        key(eye, step, frames, middle, [further * drawn.gauss(0, 0.006) for _ in range(3)])
    if place.things and drawn.random() < 0.4:
        for thing in drawn.sample(place.things, min(len(place.things), drawn.randint(1, 2))):
            step = Vector([drawn.gauss(0, 0.04), drawn.gauss(0, 0.04), abs(drawn.gauss(0, 0.02))])
            key(thing, step, frames, middle, (0, 0, drawn.gauss(0, 0.05)))
    if place.lamps and drawn.random() < 0.15:
        lamp = drawn.choice(place.lamps)
        key(lamp, Vector([drawn.gauss(0, 0.1) for _ in range(3)]), frames, middle)

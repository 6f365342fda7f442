"""A furnished room, lit by sun and sky through two windows, one of them with a blind."""

from __future__ import annotations

import math
import random

import bpy
from mathutils import Vector

from stillray_training.blender.parts import (
    Material,
    Point,
    ball,
    box,
    camera,
    glowing,
    key,
    lathe,
    light,
    rod,
    sky,
    textile,
    torus,
    wood,
)

_WIDTH, _DEPTH, _HEIGHT = 4.6, 5.2, 2.7  # metres; x, y, z of the room, from its corner at 0
_WINDOWS = ((0.7, 1.9), (2.7, 3.9))  # left and right side, in the far wall
_SIDE_WINDOW = (0.3, 2.1)  # near and far side, out of view


def build() -> None:
    """The scene, a still."""
    _shell()
    _window(*_WINDOWS[0])
    _window(*_WINDOWS[1], blind=True)
    _table()
    _chair((1.75, 2.55))
    _sofa()
    _shelf()
    _lamp((0.45, 4.6))
    _walls_things()
    sky(32, 0.25)
    light("SUN", (3, 12, 8), (1.6, 1.2, 0), 4.5, angle=math.radians(0.53), color=(1, 0.93, 0.82))
    for left, right in _WINDOWS:
        x = (left + right) / 2
        _skylight((x, _DEPTH + 0.16, 1.55), (x, 0, 1.55), (right - left, 1.5))
    y = sum(_SIDE_WINDOW) / 2
    _skylight((_WIDTH + 0.16, y, 1.55), (0, y, 1.55), (_SIDE_WINDOW[1] - _SIDE_WINDOW[0], 1.7))
    camera((3.35, 0.35, 1.45), (1.75, 4.2, 0.98), 25)


def move(frames: int) -> None:
    """Key the camera for frames -1 to ``frames``: sideways and turning, 2 to 6 pixels a frame."""
    eye = bpy.context.scene.camera
    key(eye, Vector((-0.035, 0.02, 0.0)), frames, stands=0, turn=(0, 0, -0.006))


def _skylight(place: Point, target: Point, size: tuple[float, float]) -> None:
    """What the sky would send through a window, as a lamp: paths need not find the window."""
    power = 28 * size[0] * size[1]
    light(
        "AREA", place, target, power, shape="RECTANGLE", size=size[0], size_y=size[1],
        color=(0.78, 0.88, 1.0),
    )  # fmt: skip


def _paint(name: str, color: tuple[float, float, float]) -> Material:
    made = Material(name, color, Roughness=0.75)
    grain = made.node("TexNoise", Vector=made.coordinates(), Scale=90.0, Detail=1.0)
    made.emboss(grain.outputs[0], 0.0004, 0.5)
    return made


def _panelled() -> Material:
    """White wainscot whose panels are relief only."""
    made = Material("wainscot", (0.72, 0.71, 0.68), Roughness=0.35)
    bricks = made.node(
        "TexBrick", Vector=made.coordinates(rotation=(0, math.pi / 2, math.pi / 2)), Scale=1.0,
        Mortar_Size=0.035, Mortar_Smooth=0.6, Brick_Width=0.62, Row_Height=0.42,
    )  # fmt: skip
    bricks.offset = 0.0
    made.emboss(bricks.outputs["Fac"], 0.02)
    return made


def _shell() -> None:
    wall, white = _paint("wall", (0.74, 0.71, 0.62)), Material("white", (0.85, 0.85, 0.83))
    box((-0.2, -0.2, -0.1), (_WIDTH + 0.2, _DEPTH + 0.2, 0),
        wood("floor", (0.1, 0.045, 0.02), (0.45, 0.25, 0.13), plank=0.14))  # fmt: skip
    box((-0.2, -0.2, _HEIGHT), (_WIDTH + 0.2, _DEPTH + 0.2, _HEIGHT + 0.1), white)
    box((-0.2, -0.2, 0), (0, _DEPTH + 0.2, _HEIGHT), wall)
    first, last = _SIDE_WINDOW
    for near, far, bottom, top in (
        (-0.2, first, 0, _HEIGHT), (last, _DEPTH + 0.2, 0, _HEIGHT), (first, last, 0, 0.7),
        (first, last, 2.4, _HEIGHT),
    ):  # fmt: skip
        box((_WIDTH, near, bottom), (_WIDTH + 0.2, far, top), wall)
    box((0, -0.2, 0), (_WIDTH, 0, _HEIGHT), wall)
    for left, right in ((0, 0.7), (1.9, 2.7), (3.9, _WIDTH)):
        box((left, _DEPTH, 0), (right, _DEPTH + 0.2, _HEIGHT), wall)
    for left, right in _WINDOWS:
        box((left, _DEPTH, 0), (right, _DEPTH + 0.2, 0.8), wall)
        box((left, _DEPTH, 2.3), (right, _DEPTH + 0.2, _HEIGHT), wall)
        box((left - 0.06, _DEPTH - 0.12, 0.77), (right + 0.06, _DEPTH + 0.02, 0.8), white)
    panels = _panelled()
    box((0, 0, 0.1), (0.015, _DEPTH, 0.95), panels)
    box((0, 0, 0.95), (0.035, _DEPTH, 1.0), white, bevel=0.006)
    box((0, 0, 0), (0.025, _DEPTH, 0.1), white, bevel=0.005)
    box((0, _DEPTH - 0.025, 0), (_WIDTH, _DEPTH, 0.1), white, bevel=0.005)


def _window(left: float, right: float, *, blind: bool = False) -> None:
    paint = Material("frame", (0.78, 0.78, 0.76), Roughness=0.3)
    y = _DEPTH + 0.08
    for x in (left + 0.025, right - 0.025):
        box((x - 0.025, y - 0.03, 0.8), (x + 0.025, y + 0.03, 2.3), paint)
    for z in (0.825, 2.275):
        box((left, y - 0.03, z - 0.025), (right, y + 0.03, z + 0.025), paint)
    for share in (0.25, 0.5, 0.75):
        x = left + share * (right - left)
        box((x - 0.008, y - 0.015, 0.8), (x + 0.008, y + 0.015, 2.3), paint)
    for z in (1.3, 1.8):
        box((left, y - 0.015, z - 0.008), (right, y + 0.015, z + 0.008), paint)
    if blind:
        slat = Material("slat", (0.7, 0.62, 0.5), Roughness=0.5)
        for row in range(34):
            z = 0.86 + 0.042 * row
            thing = box((left + 0.06, -0.02, -0.001), (right - 0.06, 0.02, 0.001), slat)
            thing.location = (0.5 * (left + right), _DEPTH + 0.02, z)
            thing.rotation_euler = (0.15, 0, 0)
        for x in (left + 0.3, right - 0.3):
            rod((x, _DEPTH + 0.02, 0.85), (x, _DEPTH + 0.02, 2.28), 0.0025, slat)


def _table() -> None:
    oak = wood("table", (0.2, 0.11, 0.05), (0.55, 0.36, 0.18))
    box((1.1, 3.05, 0.71), (2.5, 3.85, 0.745), oak, bevel=0.008)
    for x in (1.18, 2.42):
        for y in (3.13, 3.77):
            rod((x, y, 0), (x, y, 0.71), 0.022, oak)
    ceramic = Material("vase", (0.12, 0.25, 0.45), Roughness=0.12, Coat_Weight=0.5)
    vase = [(0, 0), (0.06, 0), (0.11, 0.12), (0.09, 0.22), (0.045, 0.3), (0.06, 0.35)]
    lathe(vase, (1.75, 3.5, 0.746), ceramic)
    drawn, leaf = random.Random(5), Material("leaf", (0.09, 0.25, 0.06), Roughness=0.5)
    for _ in range(22):
        turn, spread = drawn.uniform(0, 2 * math.pi), drawn.uniform(0.05, 0.28)
        tip = (
            1.75 + spread * math.cos(turn),
            3.5 + spread * math.sin(turn),
            drawn.uniform(1.25, 1.5),
        )
        rod((1.75, 3.5, 1.05), tip, 0.004, leaf)
        blade = ball(tip, 1.0, leaf)
        blade.scale = (0.035, 0.018, 0.008)
        blade.rotation_euler = (drawn.uniform(-1, 1), drawn.uniform(-1, 1), turn)
    glass = Material("glass", (1, 1, 1), Roughness=0.0, IOR=1.45, Transmission_Weight=1.0)
    lathe([(0, 0), (0.035, 0), (0.04, 0.13), (0.036, 0.13), (0.032, 0.01), (0, 0.01)],
          (2.1, 3.35, 0.746), glass)  # fmt: skip
    silver = Material("bowl", (0.85, 0.83, 0.8), Metallic=1.0, Roughness=0.12)
    bowl = [(0, 0), (0.06, 0.0), (0.13, 0.05), (0.16, 0.1), (0.155, 0.1), (0.12, 0.055), (0, 0.015)]
    lathe(bowl, (1.38, 3.35, 0.746), silver)
    for place in ((1.36, 3.32), (1.43, 3.38), (1.34, 3.4)):
        ball((*place, 0.83), 0.042, Material("orange", (0.75, 0.27, 0.03), Roughness=0.4))
    for level, shade in enumerate(((0.5, 0.1, 0.08), (0.1, 0.2, 0.3), (0.6, 0.5, 0.2))):
        book = box((-0.11, -0.15, 0), (0.11, 0.15, 0.028), Material("book", shade, Roughness=0.5))
        book.location, book.rotation_euler = (
            (2.25, 3.62, 0.746 + 0.029 * level),
            (0, 0, 0.3 * level),
        )


def _chair(place: tuple[float, float]) -> None:
    x, y = place
    beech = wood("chair", (0.3, 0.14, 0.06), (0.6, 0.33, 0.15))
    box((x - 0.22, y - 0.21, 0.44), (x + 0.22, y + 0.21, 0.47), beech, bevel=0.01)
    for dx in (-0.19, 0.19):
        rod((x + dx, y + 0.18, 0), (x + dx, y + 0.18, 0.44), 0.014, beech)
        rod((x + dx, y - 0.2, 0), (x + dx * 1.05, y - 0.25, 0.95), 0.014, beech)
    box((x - 0.21, y - 0.265, 0.88), (x + 0.21, y - 0.24, 0.96), beech, bevel=0.008)
    for step in range(6):
        dx = -0.15 + 0.06 * step
        rod((x + dx, y - 0.2, 0.47), (x + dx, y - 0.25, 0.9), 0.006, beech)


def _sofa() -> None:
    cloth = textile("sofa", (0.16, 0.25, 0.28), (0.2, 0.3, 0.32), threads=320)
    box((3.55, 2.4, 0.12), (4.5, 4.4, 0.42), cloth, bevel=0.06)
    box((4.25, 2.4, 0.3), (4.55, 4.4, 0.85), cloth, bevel=0.08)
    for y in (2.32, 4.32):
        box((3.6, y, 0.12), (4.5, y + 0.18, 0.6), cloth, bevel=0.06)
    red = textile("cushion", (0.55, 0.1, 0.08), (0.75, 0.65, 0.45), threads=110)
    cushion = box((-0.22, -0.08, -0.22), (0.22, 0.08, 0.22), red, bevel=0.07)
    cushion.location, cushion.rotation_euler = (4.05, 4.05, 0.6), (0.35, 0, 0.5)
    rug = Material("rug", Roughness=0.95)
    ornament = rug.node("TexVoronoi", Vector=rug.coordinates(), Scale=7.0)
    ornament.distance = "MANHATTAN"
    rug.paint(rug.ramp(ornament.outputs["Distance"], [
        (0.0, (0.35, 0.05, 0.04)), (0.35, (0.55, 0.42, 0.28)), (0.6, (0.06, 0.08, 0.18)),
    ]))  # fmt: skip
    pile = rug.node("TexNoise", Vector=rug.coordinates(), Scale=260.0)
    rug.emboss(pile.outputs[0], 0.001)
    box((1.9, 1.3, 0), (3.5, 2.5, 0.012), rug)


def _shelf() -> None:
    board = Material("board", (0.12, 0.08, 0.06), Roughness=0.35)
    drawn = random.Random(11)
    for z in (1.2, 1.55, 1.9):
        box((0.02, 1.9, z), (0.27, 3.5, z + 0.022), board)
        y = 1.93
        while y < 3.4:
            thick, tall = drawn.uniform(0.015, 0.05), drawn.uniform(0.18, 0.29)
            shade = [drawn.uniform(0.05, 0.6) for _ in range(3)]
            if drawn.random() < 0.85:
                book = Material("book", (shade[0], shade[1], shade[2]), Roughness=0.45)
                box(
                    (0.05, y, z + 0.022),
                    (0.05 + drawn.uniform(0.13, 0.19), y + thick, z + 0.022 + tall),
                    book,
                )
            y += thick + 0.002
    for y in (1.9, 3.48):
        box((0.02, y, 1.2), (0.27, y + 0.02, 2.2), board)


def _lamp(place: tuple[float, float]) -> None:
    x, y = place
    brass = Material("brass", (0.75, 0.55, 0.25), Metallic=1.0, Roughness=0.2)
    rod((x, y, 0), (x, y, 0.02), 0.14, brass)
    rod((x, y, 0.02), (x, y, 1.5), 0.009, brass)
    shade = Material("shade", (0.85, 0.75, 0.6), Roughness=0.9, Transmission_Weight=0.0)
    through = shade.node("BsdfTranslucent", Color=(0.85, 0.7, 0.5, 1))
    shade.mix(through, 0.5)
    lathe([(0.2, 1.38), (0.13, 1.68)], (x, y, 0), shade)
    bulb = glowing((1.0, 0.72, 0.42), 70.0)
    ball((x, y, 1.54), 0.035, bulb)


def _walls_things() -> None:
    black = Material("picture frame", (0.03, 0.03, 0.03), Roughness=0.25)
    for y, scale in ((4.15, 3.0), (4.75, 6.0)):
        box((0.0, y - 0.2, 1.35), (0.03, y + 0.2, 1.9), black, bevel=0.006)
        picture = Material("picture", Roughness=0.15)
        waves = picture.node("TexWave", Vector=picture.coordinates(), Scale=scale, Distortion=7.0)
        picture.paint(picture.ramp(waves.outputs[1], [
            (0.1, (0.7, 0.55, 0.2)), (0.45, (0.15, 0.3, 0.35)), (0.8, (0.75, 0.72, 0.65)),
        ]))  # fmt: skip
        box((0.0, y - 0.17, 1.38), (0.034, y + 0.17, 1.87), picture)
    mirror = Material("mirror", (0.9, 0.9, 0.9), Metallic=1.0, Roughness=0.0)
    rod((2.3, _DEPTH, 1.6), (2.3, _DEPTH - 0.02, 1.6), 0.26, mirror)
    brass = Material("brass ring", (0.75, 0.55, 0.25), Metallic=1.0, Roughness=0.25)
    torus((2.3, _DEPTH - 0.02, 1.6), 0.27, 0.018, brass).rotation_euler = (math.pi / 2, 0, 0)

"""A street at night after rain: dozens of lamps, lit windows and signs, mirrored in asphalt."""

from __future__ import annotations

import math
from random import Random

import bpy
from mathutils import Vector

from stillray_training.blender.parts import (
    Color,
    Material,
    background,
    ball,
    box,
    camera,
    glowing,
    key,
    rod,
    text,
)

_WIDE, _LONG = 4.5, 34.0  # half the street's width, its length; metres


def build() -> None:
    """The scene, a still."""
    drawn = Random(11)
    _asphalt()
    pavement = Material("pavement", (0.25, 0.24, 0.23), Roughness=0.5)
    shades = {
        name: (shade, shade * 0.97, shade * 0.93, 1)
        for name, shade in (("Color1", 0.26), ("Color2", 0.2), ("Mortar", 0.08))
    }
    slabs = pavement.node("TexBrick", Vector=pavement.coordinates(), Scale=2.0, **shades)
    pavement.paint(slabs.outputs["Color"])
    for side in (-1, 1):
        near, far = sorted((side * 2.6, side * _WIDE))
        box((near, -3, 0), (far, _LONG, 0.14), pavement)
        y = -3.0
        while y < _LONG:
            y = _house(drawn, side, y)
        for y in range(3, int(_LONG), 5):
            _street_lamp(side, y + (1.5 if side > 0 else 0.0))
    for x, y, tint in (
        (-1.3, 7.0, (0.3, 0.02, 0.02)),
        (1.4, 11.0, (0.03, 0.06, 0.2)),
        (-1.3, 16.0, (0.5, 0.5, 0.5)),
    ):
        _car(x, y, tint)
    background((0.02, 0.03, 0.07), 0.4)
    camera((0.5, -1.6, 1.5), (-0.1, 10.0, 1.7), 26)


def move(frames: int) -> None:
    """Key the camera for frames -1 to ``frames``: forward and sideways."""
    key(bpy.context.scene.camera, Vector((0.04, 0.08, 0.01)), frames, stands=frames)


def _asphalt() -> None:
    wet = Material("asphalt", (0.035, 0.035, 0.038))
    puddles = wet.node("TexNoise", Vector=wet.coordinates(), Scale=0.7, Detail=3.0)
    rough = wet.node(
        "MapRange", Value=puddles.outputs[0], From_Min=0.45, From_Max=0.6, To_Min=0.04, To_Max=0.4
    )
    wet.vary("Roughness", rough.outputs[0])
    grain = wet.node("TexNoise", Vector=wet.coordinates(), Scale=60.0, Detail=2.0)
    wet.emboss(grain.outputs[0], 0.004, 0.3)
    box((-_WIDE, -3, -0.1), (_WIDE, _LONG, 0), wet)
    white = Material("marking", (0.7, 0.7, 0.68), Roughness=0.5)
    for y in range(0, int(_LONG), 3):
        box((-0.07, y, 0), (0.07, y + 1.6, 0.004), white)


def _house(drawn: Random, side: int, y: float) -> float:
    """One house with rows of windows; where the next begins."""
    deep, high = drawn.uniform(4, 8), drawn.uniform(5, 11)
    tint = drawn.choice(((0.35, 0.14, 0.1), (0.4, 0.36, 0.3), (0.18, 0.2, 0.24), (0.5, 0.42, 0.25)))
    wall = Material("wall", tint, Roughness=0.85)
    bricks = wall.node(
        "TexBrick", Vector=wall.coordinates(rotation=(0, math.pi / 2, 0)), Scale=4.0,
        Color1=(*tint, 1), Color2=(*(0.7 * part for part in tint), 1), Mortar=(0.3, 0.29, 0.27, 1),
    )  # fmt: skip
    wall.paint(bricks.outputs["Color"])
    near, far = sorted((side * _WIDE, side * (_WIDE + 3)))
    box((near, y, 0), (far, y + deep, high), wall)
    front = side * (_WIDE - 0.02)
    dark = Material("pane", (0.01, 0.012, 0.02), Roughness=0.05)
    frame = Material("frame", (0.6, 0.58, 0.52), Roughness=0.5)
    for row in range(int(high // 2.4)):
        for column in range(int(deep // 1.5)):
            u, v = y + 0.5 + 1.5 * column, 0.9 + 2.4 * row
            lit = drawn.random() < 0.4
            warm = (1, drawn.uniform(0.55, 0.9), drawn.uniform(0.25, 0.8))
            pane = glowing(warm, drawn.uniform(0.4, 4)) if lit else dark
            inner, outer = sorted((front, front + side * 0.05))
            box((inner, u, v), (outer, u + 0.8, v + 1.3), pane)
            a, b = sorted((front - side * 0.04, front))
            box((a, u - 0.06, v - 0.06), (b, u + 0.86, v), frame)
            box((a, u + 0.38, v), (b, u + 0.42, v + 1.3), frame)
            box((a, u, v + 0.84), (b, u + 0.8, v + 0.88), frame)
    if drawn.random() < 0.7:
        sign = glowing((drawn.random(), drawn.random(), drawn.random()), drawn.uniform(3, 10))
        words = drawn.choice(("HOTEL", "CAFE", "24h", "BAR", "PHARMACY", "RAMEN"))
        at = (side * (_WIDE - 0.08), y + (3.4 if side > 0 else 1.0), 3.0)
        thing = text(words, 0.7, sign, at)
        thing.data.extrude, thing.data.bevel_depth = 0.02, 0.01
        thing.rotation_euler = (math.pi / 2, 0, -side * math.pi / 2)
    return y + deep


def _street_lamp(side: int, y: float) -> None:
    iron = Material("iron", (0.05, 0.05, 0.05), Metallic=0.6, Roughness=0.5)
    x = side * 2.9
    rod((x, y, 0), (x, y, 3.6), 0.04, iron)
    rod((x, y, 3.6), (x - side * 0.7, y, 3.7), 0.025, iron)
    ball((x - side * 0.7, y, 3.62), 0.09, glowing((1, 0.7, 0.35), 90))


def _car(x: float, y: float, tint: Color) -> None:
    paint = Material("paint", tint, Metallic=0.3, Roughness=0.25, Coat_Weight=1.0)
    glass = Material("windscreen", (0.01, 0.01, 0.012), Roughness=0.03)
    tyre = Material("tyre", (0.02, 0.02, 0.02), Roughness=0.8)
    box((x - 0.8, y, 0.3), (x + 0.8, y + 3.8, 0.85), paint, bevel=0.12)
    box((x - 0.68, y + 0.7, 0.85), (x + 0.68, y + 2.9, 1.4), glass, bevel=0.18)
    for across in (-0.8, 0.72):
        for along in (0.7, 3.0):
            rod((x + across, y + along, 0.32), (x + across + 0.08, y + along, 0.32), 0.31, tyre)
    for across in (-0.6, 0.6):
        box(
            (x + across - 0.14, y - 0.02, 0.55),
            (x + across + 0.14, y, 0.68),
            glowing((1, 0.03, 0.02), 12),
        )

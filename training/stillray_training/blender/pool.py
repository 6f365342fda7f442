"""A pool in the sun: tiles under water that moves, caustics, chrome, a wet rim, slats of shade."""

from __future__ import annotations

import math

import bpy
import numpy as np
from mathutils import Vector

from stillray_training.blender.parts import (
    Material,
    Point,
    add,
    background,
    ball,
    box,
    camera,
    key,
    light,
    primitive,
    rod,
)

_WIDE, _LONG, _DEEP = 5.0, 9.0, 1.5  # metres


def build() -> None:
    """The scene, a still."""
    _basin()
    _water()
    _ladder()
    _beach_ball((0.6, 3.2, 0.16), 0.22)
    wall = Material("wall", (0.75, 0.7, 0.62), Roughness=0.9)
    wall.emboss(wall.node("TexNoise", Vector=wall.coordinates(), Scale=25.0).outputs[0], 0.01)
    box((-8, _LONG + 1.5, 0), (8, _LONG + 1.8, 2.6), wall)
    glass = Material("panes", (0.9, 0.95, 0.92), Roughness=0.0, Transmission_Weight=1.0, IOR=1.5)
    for x in (-2.0, 0.0, 2.0):
        box((x - 0.9, _LONG + 0.6, 0.05), (x + 0.9, _LONG + 0.62, 1.1), glass)
    _shade()
    light("SUN", (-4, -2, 7), (0, 4, 0), 5.0, angle=math.radians(0.53), color=(1, 0.95, 0.85))
    background((0.4, 0.6, 1.0), 0.8)
    camera((0.4, -1.6, 1.75), (0.0, 3.4, -0.1), 26)


def move(frames: int) -> None:
    """Key the camera for frames -1 to ``frames``; the ball drifts and turns."""
    key(bpy.context.scene.camera, Vector((0.03, 0.02, 0.0)), frames, stands=frames)
    thing = bpy.data.objects["beach ball"]
    key(thing, Vector((-0.02, 0.01, 0.0)), frames, stands=frames, turn=(0.0, 0.02, 0.03))


def _basin() -> None:
    tiles = Material("tiles", Roughness=0.25)
    cells = tiles.node(
        "TexBrick", Vector=tiles.coordinates(), Scale=1.0, Color1=(0.25, 0.5, 0.62, 1),
        Color2=(0.42, 0.66, 0.72, 1), Mortar=(0.8, 0.8, 0.78, 1), Mortar_Size=0.006,
        Brick_Width=0.15, Row_Height=0.15,
    )  # fmt: skip
    cells.offset = 0
    tiles.paint(cells.outputs["Color"])
    half = _WIDE / 2
    box((-half, 0, -_DEEP - 0.1), (half, _LONG, -_DEEP), tiles)
    sides: list[tuple[Point, Point]] = [
        ((-half - 0.1, 0, -_DEEP), (-half, _LONG, 0)),
        ((half, 0, -_DEEP), (half + 0.1, _LONG, 0)),
        ((-half, _LONG, -_DEEP), (half, _LONG + 0.1, 0)),
        ((-half, -0.1, -_DEEP), (half, 0, 0)),
    ]
    for low, high in sides:
        box(low, high, tiles)
    rim = Material("rim", Roughness=0.4)
    stone = rim.node("TexNoise", Vector=rim.coordinates(), Scale=6.0, Detail=8.0)
    rim.paint(rim.ramp(stone.outputs[0], [(0.35, (0.36, 0.33, 0.29)), (0.7, (0.62, 0.58, 0.5))]))
    wet = rim.node(
        "MapRange", Value=stone.outputs[0], From_Min=0.4, From_Max=0.6, To_Min=0.06, To_Max=0.7
    )
    rim.vary("Roughness", wet.outputs[0])
    around: list[tuple[Point, Point]] = [
        ((-9, -4, -0.1), (-half - 0.1, _LONG + 2, 0.1)),
        ((half + 0.1, -4, -0.1), (9, _LONG + 2, 0.1)),
        ((-half - 0.1, _LONG + 0.1, -0.1), (half + 0.1, _LONG + 2, 0.1)),
        ((-half - 0.1, -4, -0.1), (half + 0.1, -0.1, 0.1)),
    ]
    for low, high in around:
        box(low, high, rim, bevel=0.02)


def _water() -> None:
    """A surface of ripples of three lengths."""
    mesh = primitive("grid", x_segments=180, y_segments=320, size=0.5)
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    x, y = points.reshape(-1, 3)[:, 0] * _WIDE, (points.reshape(-1, 3)[:, 1] + 0.5) * _LONG
    z = np.full(x.shape, -0.05)
    for turn, length, high in ((0.4, 1.1, 0.02), (1.9, 0.63, 0.012), (2.8, 0.31, 0.006)):
        along = math.cos(turn) * x + math.sin(turn) * y
        z += high * np.sin(2 * math.pi * along / length + np.sin(2.3 * x + 1.1 * y))
    mesh.vertices.foreach_set("co", np.stack((x, y, z), 1).astype(np.float32).ravel())
    mesh.shade_smooth()
    add(mesh, Material("water", (0.9, 1, 0.98), Roughness=0.0, Transmission_Weight=1.0, IOR=1.33))


def _ladder() -> None:
    chrome = Material("chrome", (0.8, 0.8, 0.8), Metallic=1.0, Roughness=0.05)
    for y in (5.0, 5.5):
        rod((2.9, y, 0.1), (2.9, y, 0.8), 0.025, chrome)
        rod((2.9, y, 0.8), (2.3, y, 0.8), 0.025, chrome)
        rod((2.3, y, 0.8), (2.3, y, -1.0), 0.025, chrome)
    for up in (-0.3, -0.6, -0.9):
        rod((2.3, 5.0, up), (2.3, 5.5, up), 0.02, chrome)


def _beach_ball(center: Point, radius: float) -> None:
    rubber = Material("rubber", Roughness=0.3)
    turned = rubber.node("TexGradient", Vector=rubber.coordinates())
    turned.gradient_type = "RADIAL"
    ramp = rubber.ramp(turned.outputs[1], [
        (0.0, (0.8, 0.05, 0.04)), (0.2, (0.85, 0.85, 0.8)), (0.4, (0.05, 0.2, 0.7)),
        (0.6, (0.85, 0.85, 0.8)), (0.8, (0.9, 0.6, 0.05)),
    ])  # fmt: skip
    ramp.node.color_ramp.interpolation = "CONSTANT"
    rubber.paint(ramp)
    ball(center, radius, rubber).name = "beach ball"


def _shade() -> None:
    """Slats above one side, and their shadows."""
    timber = Material("timber", (0.3, 0.17, 0.09), Roughness=0.6)
    for y in np.arange(1.0, 8.0, 0.35):
        box((-4.6, y, 2.5), (-1.6, y + 0.1, 2.58), timber)
    for y in (1.0, 7.6):
        rod((-4.2, y, 0.0), (-4.2, y, 2.5), 0.06, timber)

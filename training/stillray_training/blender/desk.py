"""A desk at dusk: small print, wax and milk that light enters, smoke, liquor in glass, a mesh."""

from __future__ import annotations

import math
from random import Random

import bpy
from mathutils import Vector

from stillray_training.blender.parts import (
    Color,
    Material,
    Point,
    background,
    ball,
    box,
    camera,
    glowing,
    key,
    lathe,
    light,
    rod,
    text,
    wood,
)

_WORDS = (
    "noise",
    "light",
    "ray",
    "sample",
    "pixel",
    "still",
    "frame",
    "path",
    "glass",
    "shade",
)


def build() -> None:
    """The scene, a still."""
    top = wood("top", (0.07, 0.03, 0.015), (0.28, 0.14, 0.06))
    box((-1.6, -0.8, -0.05), (1.6, 1.6, 0), top, bevel=0.01)
    wall = Material("wall", (0.45, 0.5, 0.44), Roughness=0.9)
    box((-3, 1.6, -1), (3, 1.7, 3), wall)
    box((-3.1, -4, -1), (-3, 1.6, 3), wall)
    _print()
    for x, y, high, radius in ((-0.55, 0.75, 0.3, 0.07), (-0.33, 0.95, 0.2, 0.09)):
        _candle((x, y, 0), high, radius)
    _milk((0.62, 0.55, 0))
    _carafe((0.2, 0.95, 0))
    _smoke((-0.05, 0.55, 0))
    _basket((0.95, 1.0, 0))
    light("AREA", (2.4, -1.5, 2.2), (0, 0.5, 0), 40, size=0.6, color=(0.65, 0.78, 1.0))
    background((0.2, 0.3, 0.5), 0.12)
    camera((0.05, -1.35, 0.95), (0.02, 0.5, 0.12), 38)


def move(frames: int) -> None:
    """Key the camera for frames -1 to ``frames``: sideways and nearer."""
    key(bpy.context.scene.camera, Vector((0.008, 0.008, 0.0)), frames, stands=frames)


def _print() -> None:
    """A page of small letters, and the spines of books."""
    drawn = Random(7)
    paper = Material("paper", (0.78, 0.75, 0.68), Roughness=0.9)
    box((-0.5, -0.25, 0), (0.1, 0.45, 0.008), paper)
    ink = Material("ink", (0.02, 0.02, 0.025), Roughness=0.6)
    for line in range(16):
        size = 0.075 if line == 0 else 0.034
        words = " ".join(drawn.choice(_WORDS) for _ in range(2 if line == 0 else 5))
        text(words, size, ink, (-0.46, 0.38 - 0.04 * line, 0.009))
    x = -1.25
    for _ in range(7):
        thick, high = drawn.uniform(0.05, 0.1), drawn.uniform(0.3, 0.42)
        red, green, blue = (drawn.uniform(0.03, 0.5) for _ in range(3))
        cloth = Material("cloth", (red, green, blue), Roughness=0.8)
        box((x, 0.95, 0), (x + thick - 0.004, 1.25, high), cloth, bevel=0.004)
        gold = Material("gold", (0.8, 0.6, 0.25), Metallic=1.0, Roughness=0.3)
        at = (x + 0.3 * thick, 0.949, 0.05)
        title = text(drawn.choice(_WORDS).upper(), 0.6 * thick, gold, at)
        title.rotation_euler = (math.pi / 2, -math.pi / 2, 0)
        x += thick


def _candle(foot: Point, high: float, radius: float) -> None:
    wax = Material(
        "wax", (0.85, 0.72, 0.5), Roughness=0.4, Subsurface_Weight=1.0, Subsurface_Scale=0.06
    )
    profile = [(0.0, 0.0), (radius, 0.0), (radius, high), (0.8 * radius, high - 0.005),
               (0.6 * radius, high - 0.02), (0.0, high - 0.025)]  # fmt: skip
    lathe(profile, foot, wax)
    x, y, z = foot
    rod((x, y, z + high - 0.03), (x, y, z + high + 0.02), 0.003, Material("wick", (0.02,) * 3))
    flame = ball((x, y, z + high + 0.045), 0.014, glowing((1, 0.55, 0.18), 180))
    flame.scale = (0.8, 0.8, 2.0)


def _milk(foot: Point) -> None:
    china = Material("china", (0.85, 0.85, 0.83), Roughness=0.12)
    lathe([(0.0, 0.0), (0.09, 0.0), (0.13, 0.05), (0.14, 0.12), (0.132, 0.12), (0.122, 0.055),
           (0.0, 0.02)], foot, china)  # fmt: skip
    milk = Material(
        "milk", (0.9, 0.88, 0.8), Roughness=0.1, Subsurface_Weight=1.0, Subsurface_Scale=0.05
    )
    x, y, z = foot
    lathe([(0.0, 0.0), (0.126, 0.0)], (x, y, z + 0.09), milk)
    jelly = Material(
        "jelly", (0.8, 0.12, 0.1), Roughness=0.1, Subsurface_Weight=1.0, Subsurface_Scale=0.1
    )
    ball((x - 0.26, y - 0.2, z + 0.06), 0.06, jelly)


def _carafe(foot: Point) -> None:
    glass = _clear("glass", (1, 1, 1), 1.5)
    outside = [(0.0, 0.0), (0.1, 0.0), (0.12, 0.03), (0.12, 0.16), (0.05, 0.26), (0.045, 0.36)]
    inside = [(0.039, 0.36), (0.044, 0.26), (0.114, 0.158), (0.114, 0.034), (0.0, 0.012)]
    lathe([*outside, *inside], foot, glass)
    x, y, z = foot
    lathe([(0.0, 0.0), (0.1135, 0.022), (0.1135, 0.1), (0.0, 0.1)], (x, y, z + 0.0125),
          _clear("liquor", (0.9, 0.45, 0.1), 1.36))  # fmt: skip


def _clear(name: str, tint: Color, index: float) -> Material:
    return Material(name, tint, Roughness=0.0, Transmission_Weight=1.0, IOR=index)


def _smoke(foot: Point) -> None:
    """A plume that thins upwards."""
    x, y, z = foot
    stick = Material("stick", (0.2, 0.1, 0.05), Roughness=0.9)
    rod((x, y, z), (x, y, z + 0.1), 0.004, stick)
    ball((x, y, z + 0.1), 0.005, glowing((1, 0.2, 0.05), 20))
    smoke = Material("smoke")
    swirls = smoke.node(
        "TexNoise", Vector=smoke.coordinates((9, 9, 3)), Scale=1.0, Detail=3.0, Distortion=1.5
    )
    dense = smoke.node(
        "MapRange", Value=swirls.outputs[0], From_Min=0.5, From_Max=0.75, To_Min=0.0, To_Max=25.0
    )
    smoke.scatter(Density=dense.outputs[0], Anisotropy=0.3)
    box((x - 0.09, y - 0.09, z + 0.1), (x + 0.09, y + 0.09, z + 0.75), smoke)
    bpy.context.scene.cycles.volume_biased = True  # by steps: half a minute a frame less to set up


def _basket(foot: Point) -> None:
    """Wire, thinner than a pixel to two."""
    wire = Material("wire", (0.7, 0.68, 0.62), Metallic=1.0, Roughness=0.3)
    x, y, z = foot
    count = 26
    for step in range(count):
        turn = 2 * math.pi * step / count
        way = Vector((math.cos(turn), math.sin(turn), 0))
        low, high = Vector(foot) + 0.12 * way, Vector((x, y, z + 0.26)) + 0.2 * way
        rod(tuple(low), tuple(high), 0.0025, wire)
    for up in range(8):
        radius = 0.12 + 0.08 * up / 7
        points = [(radius + 0.0025 * math.cos(t), 0.0025 * math.sin(t)) for t in (0, 1.6, 3.1, 4.7)]
        lathe([*points, points[0]], (x, y, z + 0.26 * up / 7), wire)
    for turn in range(5):
        at = (x + 0.06 * math.cos(turn * 1.3), y + 0.06 * math.sin(turn * 1.3), z + 0.07)
        ball(at, 0.055, Material("fruit", (0.7, 0.12 + 0.1 * turn, 0.05), Roughness=0.4))

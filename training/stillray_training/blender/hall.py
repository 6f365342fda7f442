"""A hall full of haze: sunbeams between columns, a spotlight, lamps that glow in it."""

from __future__ import annotations

import math

import bpy
from mathutils import Vector

from stillray_training.blender.parts import (
    Material,
    background,
    ball,
    box,
    camera,
    glowing,
    key,
    lathe,
    light,
    wood,
)

_WIDE, _LONG, _HIGH = 6.0, 12.0, 4.5  # metres


def build() -> None:
    """The scene, a still."""
    stone = Material("stone", (0.6, 0.56, 0.5), Roughness=0.8)
    bricks = stone.node(
        "TexBrick", Vector=stone.coordinates(rotation=(math.pi / 2, 0, 0)), Scale=1.6,
        Color1=(0.62, 0.57, 0.5, 1), Color2=(0.5, 0.45, 0.4, 1), Mortar=(0.35, 0.33, 0.3, 1),
    )  # fmt: skip
    stone.paint(bricks.outputs["Color"])
    stone.emboss(bricks.outputs["Fac"], -0.02)
    box(
        (-0.1, -1, -0.1),
        (_WIDE, _LONG, 0),
        wood("floor", (0.1, 0.05, 0.02), (0.4, 0.24, 0.12), plank=0.2),
    )
    box((-0.1, -1, _HIGH), (_WIDE, _LONG, _HIGH + 0.1), stone)
    box((_WIDE, -1, 0), (_WIDE + 0.2, _LONG, _HIGH), stone)
    box((-0.1, _LONG, 0), (_WIDE, _LONG + 0.2, _HIGH), stone)
    box((-0.1, -1.2, 0), (_WIDE, -1, _HIGH), stone)
    _windows(stone)
    _columns()
    haze = Material("haze")
    haze.scatter(Density=0.06, Anisotropy=0.5)
    box((-0.05, -0.95, 0.0), (_WIDE, _LONG, _HIGH), haze)
    light("SUN", (-7, 3, 6), (2.5, 6, 0), 9.0, angle=math.radians(0.53), color=(1, 0.9, 0.72))
    light("SPOT", (4.6, 6.5, 4.3), (3.6, 7.4, 0.8), 400, spot_size=0.5, spot_blend=0.2,
          shadow_soft_size=0.03, color=(0.5, 0.7, 1))  # fmt: skip
    bulb = glowing((1, 0.6, 0.3), 60.0)
    for y in (3.5, 6.5, 9.5):
        ball((5.6, y, 2.2), 0.05, bulb)
    background((0.5, 0.65, 1.0), 1.0)
    camera((4.4, -0.4, 1.6), (2.7, 6.0, 1.5), 24)


def move(frames: int) -> None:
    """Key the camera for frames -1 to ``frames``: down the hall and sideways."""
    key(bpy.context.scene.camera, Vector((-0.05, 0.05, 0.0)), frames, stands=frames)


def _windows(stone: Material) -> None:
    """The sunny wall: openings with muntins."""
    y = -1.0
    bars = Material("lead", (0.04, 0.04, 0.045), Roughness=0.5)
    while y < _LONG:
        box((-0.3, y, 0), (0, y + 1.1, _HIGH), stone)
        box((-0.3, y + 1.1, 0), (0, y + 2.2, 0.9), stone)
        box((-0.3, y + 1.1, 3.6), (0, y + 2.2, _HIGH), stone)
        for step in (1, 2, 3):
            across = y + 1.1 + 0.275 * step
            box((-0.16, across - 0.015, 0.9), (-0.13, across + 0.015, 3.6), bars)
        for step in range(1, 6):
            up = 0.9 + 0.45 * step
            box((-0.16, y + 1.1, up - 0.012), (-0.13, y + 2.2, up + 0.012), bars)
        y += 2.2


def _columns() -> None:
    marble = Material("marble", Roughness=0.25)
    veins = marble.node(
        "TexWave", Vector=marble.coordinates((1, 1, 0.6)), Scale=1.3, Distortion=14.0, Detail=4.0
    )
    marble.paint(marble.ramp(veins.outputs[1], [
        (0.05, (0.25, 0.2, 0.18)), (0.3, (0.6, 0.55, 0.5)), (0.8, (0.75, 0.72, 0.68)),
    ]))  # fmt: skip
    profile = [
        (0.34, 0),
        (0.34, 0.15),
        (0.26, 0.3),
        (0.22, 2.0),
        (0.21, 3.9),
        (0.32, 4.1),
        (0.34, _HIGH),
    ]
    for y in (2.2, 4.4, 6.6, 8.8, 11.0):
        for x in (1.5, 4.9):
            lathe(profile, (x, y, 0), marble)
    cloth = Material("banner", (0.5, 0.04, 0.05), Roughness=0.9)
    pattern = cloth.node(
        "TexChecker", Vector=cloth.coordinates(), Scale=9.0,
        Color1=(0.5, 0.04, 0.05, 1), Color2=(0.75, 0.55, 0.15, 1),
    )  # fmt: skip
    cloth.paint(pattern.outputs["Color"])
    for y in (3.3, 7.7):
        box((_WIDE - 0.12, y - 0.5, 1.2), (_WIDE - 0.1, y + 0.5, 3.8), cloth)

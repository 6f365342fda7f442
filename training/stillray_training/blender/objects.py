"""A still life of a dozen objects: glass, metals, matte and waxy, relief, hair-thin parts."""

from __future__ import annotations

import math
import random

from mathutils import Matrix

from stillray_training.blender.parts import (
    Material,
    add,
    background,
    ball,
    box,
    camera,
    lathe,
    light,
    primitive,
    rod,
    textile,
    torus,
    wood,
)


def build() -> None:
    """The scene, a still."""
    box((-3, -2, -0.05), (3, 3, 0), wood("table", (0.09, 0.035, 0.015), (0.42, 0.22, 0.1)))
    wall = Material("wall", (0.55, 0.57, 0.6), Roughness=0.8)
    plaster = wall.node("TexNoise", Vector=wall.coordinates(), Scale=14.0, Detail=3.0)
    wall.emboss(plaster.outputs[0], 0.02)
    box((-4, 2.2, -1), (4, 2.3, 4), wall)
    _cloth()
    glass = Material("glass", (1, 1, 1), Roughness=0.0, IOR=1.45, Transmission_Weight=1.0)
    ball((-0.95, -0.3, 0.3), 0.3, glass)
    green = Material("bottle", (0.25, 0.7, 0.4), Roughness=0.02, Transmission_Weight=1.0)
    outer = [(0, 0), (0.16, 0), (0.17, 0.05), (0.17, 0.5), (0.06, 0.68), (0.05, 0.95)]
    inner = [(0.035, 0.95), (0.045, 0.68), (0.15, 0.49), (0.15, 0.06), (0, 0.04)]
    lathe(outer + inner, (-0.35, 0.9, 0.001), green)
    _metals()
    _matte()
    _hair_thin()
    light("AREA", (-2.6, -1.6, 3.2), (0, 0.2, 0.2), 150, size=1.0, color=(1, 0.9, 0.75))
    light("AREA", (2.8, -0.4, 1.8), (0, 0.3, 0.3), 25, size=0.4, color=(0.7, 0.8, 1))
    background((0.6, 0.7, 0.9), 0.12)
    camera((0.25, -3.7, 1.55), (0.0, 0.25, 0.36), 46)


def _cloth() -> None:
    mesh = primitive(
        "grid", x_segments=90, y_segments=50, size=0.5, matrix=Matrix.Diagonal((2.2, 0.9, 1, 1))
    )
    for point in mesh.vertices:
        x, y, _ = point.co
        point.co.z = 0.008 * math.sin(9 * x + 4 * y) + 0.006 * math.sin(17 * y - 5 * x)
    mesh.shade_smooth()
    cloth = textile("cloth", (0.5, 0.08, 0.07), (0.75, 0.7, 0.6), threads=240)
    add(mesh, cloth, (0.35, -0.55, 0.02))


def _metals() -> None:
    gold = Material("gold", (1.0, 0.68, 0.25), Metallic=1.0, Roughness=0.18)
    torus((0.28, -0.42, 0.1), 0.22, 0.07, gold)
    steel = Material("brushed steel", (0.62, 0.6, 0.58), Metallic=1.0, Roughness=0.3)
    scratches = steel.node("TexNoise", Vector=steel.coordinates((2, 2, 160)), Scale=6.0, Detail=1.0)
    steel.emboss(scratches.outputs[0], 0.002, 0.4)
    profile = [(0, 0), (0.24, 0), (0.26, 0.03), (0.26, 0.42), (0.24, 0.46), (0.05, 0.5)]
    lathe([*profile, (0.05, 0.55), (0, 0.56)], (0.75, 0.65, 0.001), steel)
    mirror = Material("chrome", (0.9, 0.9, 0.9), Metallic=1.0, Roughness=0.02)
    ball((1.25, 0.1, 0.24), 0.24, mirror)
    copper = Material("copper", (0.9, 0.42, 0.28), Metallic=1.0, Roughness=0.25)
    for level in range(7):
        rod((0.93, -0.75, 0.02 + 0.021 * level), (0.93, -0.75, 0.038 + 0.021 * level), 0.09, copper)


def _matte() -> None:
    ceramic = Material("ceramic", (0.75, 0.72, 0.66), Roughness=0.2, Coat_Weight=0.6)
    profile = [(0, 0), (0.1, 0), (0.2, 0.15), (0.23, 0.3), (0.12, 0.5), (0.1, 0.62), (0.14, 0.7)]
    lathe(profile, (-0.95, 0.75, 0.001), ceramic)
    stone = Material("stone", (0.42, 0.4, 0.44), Roughness=0.85)
    cells = stone.node("TexVoronoi", Vector=stone.coordinates(), Scale=11.0)
    cells.feature = "DISTANCE_TO_EDGE"
    stone.emboss(cells.outputs[0], 0.05)
    ball((0.2, 0.55, 0.3), 0.3, stone)
    checked = Material("checked", Roughness=0.4)
    checks = checked.node("TexChecker", Vector=checked.coordinates(), Scale=14.0)
    checks.inputs["Color1"].default_value = (0.02, 0.03, 0.12, 1)
    checks.inputs["Color2"].default_value = (0.8, 0.78, 0.7, 1)
    checked.paint(checks.outputs["Color"])
    cube = box((-0.17, -0.17, -0.17), (0.17, 0.17, 0.17), checked, bevel=0.02)
    cube.location, cube.rotation_euler = (-0.42, -0.1, 0.17), (0, 0, 0.5)
    wax = Material("wax", (0.85, 0.55, 0.4), Roughness=0.35, Subsurface_Weight=0.5)
    mesh = primitive("monkey", matrix=Matrix.Diagonal((0.21, 0.21, 0.21, 1)))
    mesh.shade_smooth()
    thing = add(mesh, wax, (-0.18, -0.62, 0.18))
    thing.rotation_euler = (0, 0, -0.3)
    thing.modifiers.new("smooth", "SUBSURF").render_levels = 2


def _hair_thin() -> None:
    wire = Material("wire", (0.05, 0.05, 0.06), Metallic=0.8, Roughness=0.35)
    thing = add(primitive("icosphere", subdivisions=3, radius=0.26), wire, (-1.35, 0.2, 0.27))
    modifier = thing.modifiers.new("wires", "WIREFRAME")
    modifier.thickness = 0.008
    drawn = random.Random(3)
    straw = Material("straw", (0.75, 0.6, 0.3), Roughness=0.7)
    for _ in range(26):
        turn, spread = drawn.uniform(0, 2 * math.pi), drawn.uniform(0.1, 0.34)
        top = (-0.95 + spread * math.cos(turn), 0.75 + spread * math.sin(turn),
               drawn.uniform(1.05, 1.5))  # fmt: skip
        rod((-0.95, 0.75, 0.5), top, 0.0035, straw)
        ball(top, 0.012, straw)
    box((1.3, 0.75, 0), (1.75, 1.1, 0.03), wire)
    for row in range(9):
        x = 1.32 + 0.05 * row
        rod((x, 0.8, 0.03), (x, 0.8, 0.7), 0.004, wire)
    rod((1.3, 0.8, 0.7), (1.75, 0.8, 0.7), 0.006, wire)

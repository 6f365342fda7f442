"""A meadow in the sun: grass and fur, thinner than a pixel, leaves that let light through."""

from __future__ import annotations

import math
from random import Random
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

from stillray_training.blender.parts import (
    Material,
    Point,
    add,
    background,
    camera,
    hair,
    key,
    light,
    primitive,
    rod,
)

_BLADES, _HAIRS, _LEAVES = 26000, 22000, 2600


def build() -> None:
    """The scene, a still."""
    drawn = Random(5)
    soil = Material("soil", (0.13, 0.09, 0.05), Roughness=0.95)
    mesh = primitive("grid", x_segments=8, y_segments=8, size=9.0)
    add(mesh, soil, (0, 6, 0))
    _grass(drawn)
    stone = Material("stone", (0.4, 0.38, 0.36), Roughness=0.9)
    cells = stone.node("TexNoise", Vector=stone.coordinates(), Scale=9.0, Detail=5.0)
    stone.emboss(cells.outputs[0], 0.05)
    for at, size in (((1.5, 3.0, 0.1), 0.34), ((-1.9, 4.4, 0.1), 0.5)):
        mesh = primitive("icosphere", subdivisions=4, radius=size)
        mesh.shade_smooth()
        add(mesh, stone, at).scale = (1.3, 1.0, 0.7)
    _fur(drawn, (-0.35, 2.6, 0.36), 0.33)
    _tree(drawn, (1.2, 5.2, 0))
    light("SUN", (-6, 1, 7), (0, 4, 0), 4.0, angle=math.radians(0.53), color=(1, 0.92, 0.8))
    background((0.35, 0.55, 0.95), 0.6)
    camera((0.1, -0.6, 0.95), (0.0, 3.0, 0.62), 32)


def move(frames: int) -> None:
    """Key the camera for frames -1 to ``frames``: sideways, 3 pixels a frame in the middle."""
    key(bpy.context.scene.camera, Vector((0.028, 0.012, 0.0)), frames, stands=frames)


def _blades(roots: list[Point], drawn: Random, size: float, material: Material) -> Any:
    """Triangles that stand on points and bend."""
    points: list[Vector] = []
    faces: list[tuple[int, ...]] = []
    for x, y, z in roots:
        high, turn = size * drawn.uniform(0.4, 1.0), drawn.uniform(0, 2 * math.pi)
        across = 0.02 * size / 0.3 * Vector((math.cos(turn), math.sin(turn), 0)) / 2
        lean = high * Vector((drawn.gauss(0, 0.3), drawn.gauss(0, 0.3), 1))
        root = Vector((x, y, z))
        bend = root + 0.55 * lean
        tip = root + lean + high * Vector((drawn.gauss(0, 0.25), drawn.gauss(0, 0.25), -0.1))
        first = len(points)
        points += [root - across, root + across, bend + 0.7 * across, bend - 0.7 * across, tip]
        faces += [(first, first + 1, first + 2, first + 3), (first + 3, first + 2, first + 4)]
    mesh = bpy.data.meshes.new("blades")
    mesh.from_pydata(points, [], faces)
    return add(mesh, material)


def _grass(drawn: Random) -> None:
    for tint, share in (
        ((0.1, 0.22, 0.03), 0.6),
        ((0.2, 0.26, 0.05), 0.3),
        ((0.35, 0.3, 0.12), 0.1),
    ):
        green = Material("grass", tint, Roughness=0.45)
        roots = []
        for _ in range(int(share * _BLADES)):
            y = 0.3 + 8 * drawn.random() ** 1.6  # denser where it is near
            roots.append((drawn.uniform(-0.6, 0.6) * (y + 1.5), y, 0.0))
        _blades(roots, drawn, 0.3, green)


def _fur(drawn: Random, center: Point, radius: float) -> None:
    """A ball of hair, as Cycles' curves."""
    brown = Material("skin", (0.25, 0.14, 0.08), Roughness=0.8)
    mesh = primitive("uvsphere", u_segments=48, v_segments=24, radius=radius * 0.97)
    add(mesh, brown, center)
    fur = Material("fur", (0.55, 0.36, 0.2), Roughness=0.4)
    stripes = fur.node("TexWave", Vector=fur.coordinates(), Scale=2.2, Distortion=3.0)
    fur.paint(fur.ramp(stripes.outputs[1], [(0.3, (0.6, 0.42, 0.24)), (0.6, (0.09, 0.06, 0.05))]))
    paths = []
    for _ in range(_HAIRS):
        way = Vector([drawn.gauss(0, 1) for _ in range(3)]).normalized()
        side = Vector([drawn.gauss(0, 0.35) for _ in range(3)]) + Vector((0, 0, -0.4))
        long = radius * drawn.uniform(0.15, 0.4)
        steps = [step / 4 for step in range(5)]
        paths.append([radius * way + long * t * way + long * t * t * side for t in steps])
    hair(np.array(paths), 0.0011, fur, center)


def _tree(drawn: Random, at: Point) -> None:
    bark = Material("bark", (0.2, 0.14, 0.1), Roughness=0.9)
    x, y, z = at
    rod(at, (x, y, z + 1.3), 0.07, bark)
    leaf = Material("leaf", (0.12, 0.3, 0.05), Roughness=0.35)
    through = leaf.node("BsdfTranslucent", Color=(0.25, 0.45, 0.06, 1))
    leaf.mix(through, 0.4)
    points: list[Vector] = []
    faces: list[tuple[int, ...]] = []
    for _ in range(18):
        way = Vector((drawn.gauss(0, 1), drawn.gauss(0, 1), abs(drawn.gauss(0, 0.7)))).normalized()
        end = Vector((x, y, z + 1.2)) + way * drawn.uniform(0.5, 1.0)
        rod((x, y, z + drawn.uniform(0.8, 1.25)), end, 0.015, bark)
        for _ in range(_LEAVES // 18):
            middle = end + Vector([drawn.gauss(0, 0.16) for _ in range(3)])
            turned = Matrix.Rotation(drawn.uniform(0, 6), 3, "Z") @ Matrix.Rotation(
                drawn.gauss(0, 0.8), 3, "X"
            )
            first = len(points)
            for corner in ((-0.02, 0, 0), (0, -0.045, 0.006), (0.02, 0, 0), (0, 0.045, 0.006)):
                points.append(middle + turned @ Vector(corner))
            faces.append(tuple(range(first, first + 4)))
    mesh = bpy.data.meshes.new("leaves")
    mesh.from_pydata(points, [], faces)
    add(mesh, leaf)

"""Foliage: clouds of leaves of a few pixels and less, through which one sees what lies behind."""

from __future__ import annotations

from random import Random

import bpy
import numpy as np
from mathutils import Vector

from stillray_training.blender.log_uniform import log_uniform
from stillray_training.blender.materials import color
from stillray_training.blender.parts import Material, add
from stillray_training.blender.view import View

_CLOUDS = (1, 4)
_BROAD = (0.1, 0.7)  # of a cloud, of the picture's width
_LEAF = (0.4, 10.0)  # of a leaf, pixels
_COUNT = (100, 6000)


def hang(drawn: Random) -> None:
    """Hang clouds of leaves before what the camera of the scene sees."""
    view, size = View(), bpy.context.scene.render.resolution_x
    for point, normal, far in view.places(drawn, drawn.randint(*_CLOUDS)):
        broad = far * view.width * log_uniform(drawn, *_BROAD)
        leaf = far * view.width / size * log_uniform(drawn, *_LEAF)
        rng = np.random.default_rng(drawn.getrandbits(32))
        middle = point + broad * drawn.uniform(0, 0.6) * (normal + Vector((0, 0, 0.5)))
        spread = np.array((1, 1, drawn.choice((1.0, 0.6, 0.1)))) * broad / 3
        count = int(log_uniform(drawn, *_COUNT))
        _cloud(rng.normal(np.array(middle), spread, (count, 3)), leaf, rng, _stuff(drawn))


def _cloud(middles: np.ndarray, long: float, rng: np.random.Generator, stuff: Material) -> None:
    """Leaves of four corners, turned all ways, bent along their midrib."""
    count = len(middles)
    along, other = (rng.normal(0, 1, (count, 3)) for _ in range(2))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, other)
    across *= rng.uniform(0.1, 0.6) / np.linalg.norm(across, axis=1, keepdims=True)
    size = long * rng.uniform(0.5, 1.0, (count, 1)) / 2
    lift = np.cross(along, across) * rng.uniform(0, 1.5)
    corners = [middles - size * along, middles + size * (across + lift),
               middles + size * along, middles + size * (lift - across)]  # fmt: skip
    mesh = bpy.data.meshes.new("leaves")
    numbers = np.arange(4 * count).reshape(count, 4)
    halves = np.concatenate([numbers[:, [0, 1, 2]], numbers[:, [0, 2, 3]]])
    mesh.from_pydata(np.stack(corners, axis=1).reshape(-1, 3).tolist(), [], halves.tolist())
    add(mesh, stuff)


def _stuff(drawn: Random) -> Material:
    """Of two colours, in places; light comes through most."""
    leaf = Material("leaf", color(drawn), Roughness=drawn.uniform(0.2, 0.8))
    patches = leaf.node("TexNoise", Vector=leaf.coordinates(), Scale=log_uniform(drawn, 0.5, 50))
    tint = leaf.ramp(patches.outputs[0], [(0.35, color(drawn)), (0.65, color(drawn))])
    leaf.paint(tint)
    if drawn.random() < 0.7:
        through = leaf.node("BsdfTranslucent", Color=tint)
        leaf.mix(through, drawn.uniform(0.2, 0.6))
    return leaf

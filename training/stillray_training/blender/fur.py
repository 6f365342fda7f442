"""Hair, fur and lawns: thousands of curves, each thinner than a pixel or about one."""

from __future__ import annotations

import math
from random import Random
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

from stillray_training.blender.log_uniform import log_uniform
from stillray_training.blender.materials import color
from stillray_training.blender.parts import Material, hair
from stillray_training.blender.view import View

_THINGS = (2, 6)
_THICK = (0.2, 2.0)  # pixels at the root
_LONG = (0.01, 0.12)  # of the picture's width
_REACH = (0.08, 1.2)  # of the picture's width: how far from what is seen they grow
_DENSITY = (0.05, 1.5)  # hairs a square of a pixel's size, where they grow
_MOST = 50_000
_STEPS = 5  # points of a hair


def grow(drawn: Random) -> None:
    """Let hair grow on some of what the camera of the scene sees."""
    view, size = View(), bpy.context.scene.render.resolution_x
    for point, _, far in view.places(drawn, drawn.randint(*_THINGS)):
        broad = far * view.width
        rng, reach = np.random.default_rng(drawn.getrandbits(32)), log_uniform(drawn, *_REACH)
        count = log_uniform(drawn, *_DENSITY) * math.pi * (reach * size) ** 2
        roots, normals = _roots(rng, point, reach * broad, min(int(count), _MOST))
        if len(roots):
            long = broad * log_uniform(drawn, *_LONG)
            paths = _paths(drawn, rng, roots, long * normals)
            thick = broad / size * log_uniform(drawn, *_THICK)
            hair(paths, thick / 2, _stuff(drawn, long))


def _roots(
    rng: np.random.Generator, near: Vector, reach: float, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Points of surfaces within reach of one, as many anywhere as there is surface, and normals."""
    scene = bpy.context.scene
    found = [_triangles(thing) for thing in scene.objects if thing.type == "MESH"]
    corners = np.concatenate(found)
    middle = np.array(near)
    apart = np.linalg.norm(corners - middle, axis=2).min(axis=1)
    wide = np.linalg.norm(corners - corners.mean(axis=1, keepdims=True), axis=2).max(axis=1)
    corners = corners[apart < reach + wide]  # more than those that reach into it
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    if area.sum() <= 0:
        return np.zeros((0, 3)), np.zeros((0, 3))
    chosen = rng.choice(len(area), 20 * count, p=area / area.sum())
    shares = rng.dirichlet((1, 1, 1), len(chosen))
    points = np.einsum("nk,nkd->nd", shares, corners[chosen])
    inside = np.flatnonzero(np.linalg.norm(points - middle, axis=1) < reach)[:count]
    return points[inside], (across / np.maximum(area, 1e-12)[:, None])[chosen[inside]]


def _triangles(thing: Any) -> np.ndarray:
    """(n, 3, 3), corners of a mesh in the world."""
    mesh = thing.data
    mesh.calc_loop_triangles()
    places = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", places)
    corners = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("vertices", corners)
    world = np.array(thing.matrix_world)
    return (places.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3])[corners.reshape(-1, 3)]


def _paths(
    drawn: Random, rng: np.random.Generator, roots: np.ndarray, along: np.ndarray
) -> np.ndarray:
    """(hairs, steps, 3): each starts along its normal, combed all one way, and bends."""
    long = np.linalg.norm(along, axis=1, keepdims=True)
    combed = long * rng.normal(0, 0.6, 3)
    wild, droop = drawn.uniform(0.05, 0.5), np.array((0, 0, drawn.uniform(0.0, 0.8)))
    way = along + combed * rng.uniform(0.5, 1, long.shape) + long * rng.normal(0, wild, along.shape)
    bend = long * (rng.normal(0, wild, along.shape) - droop)
    high = rng.uniform(0.4, 1.0, long.shape)
    steps = np.linspace(0, 1, _STEPS)[:, None]
    return roots[:, None] + (high * way)[:, None] * steps + (high * bend)[:, None] * steps**2


def _stuff(drawn: Random, long: float) -> Material:
    """Of one colour or in bands."""
    stuff = Material("hair", color(drawn), Roughness=drawn.uniform(0.2, 0.8))
    if drawn.random() < 0.5:
        bands = stuff.node("TexWave", Vector=stuff.coordinates(), Scale=0.3 / long, Distortion=4.0)
        stuff.paint(stuff.ramp(bands.outputs[1], [(0.35, color(drawn)), (0.6, color(drawn))]))
    return stuff

"""Thin things and glasses, stood about in what a camera sees.

Stalks, bars, nets and cables are as thick as pixels are wide, or less: of few samples, what they
look like before a wall is hard to tell from its noise. Glasses show surfaces behind them in light
and in features, with noise of both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from random import Random
from typing import Any

import bpy
from mathutils import Vector

from stillray_training.blender.log_uniform import log_uniform
from stillray_training.blender.materials import color
from stillray_training.blender.parts import Material, lathe
from stillray_training.blender.view import View

_PLACES = (4, 10)
_GLASSES = 0.3  # share of the places
_THICK = (0.15, 2.5)  # pixels
_BROAD = (0.08, 0.5)  # of the picture's width, what a thing spans
_LOW = 0.5  # least z of the normal of what things stand on

_Path = Sequence[Vector]


def scatter(drawn: Random) -> None:
    """Stand thin things and glasses where the camera of the scene looks."""
    view, size = View(), bpy.context.scene.render.resolution_x
    places = view.places(drawn, drawn.randint(*_PLACES))
    for index, (point, normal, far) in enumerate(places):
        broad = far * view.width * log_uniform(drawn, *_BROAD)
        stands = normal.z > _LOW
        if stands and drawn.random() < _GLASSES:
            _glass(drawn, point, broad / 2)
            continue
        build = drawn.choice((_stalks, _grass) if stands else (_bars, _net, _stalks))
        paths = build(drawn, point, normal, broad)
        if drawn.random() < 0.2:
            paths = [_cable(drawn, point, places[index - 1][0])]
        radius = far * view.width / size * log_uniform(drawn, *_THICK) / 2
        _threads(paths, radius, _stuff(drawn))


def _stuff(drawn: Random) -> Material:
    shade = drawn.choice((0.02, 0.9, None, None))
    tint = color(drawn) if shade is None else (shade,) * 3
    metallic = float(drawn.random() < 0.3)
    return Material("thin", tint, Roughness=drawn.uniform(0.1, 0.9), Metallic=metallic)


def _threads(paths: Sequence[_Path], radius: float, stuff: Material) -> Any:
    """Round threads along paths."""
    curve = bpy.data.curves.new("threads", "CURVE")
    curve.dimensions, curve.bevel_depth, curve.bevel_resolution = "3D", radius, 2
    curve.use_fill_caps = True
    for path in paths:
        spline = curve.splines.new("POLY")
        spline.points.add(len(path) - 1)
        for point, at in zip(spline.points, path, strict=True):
            point.co = (*at, 1)
    curve.materials.append(stuff.data)
    thing = bpy.data.objects.new("threads", curve)
    bpy.context.scene.collection.objects.link(thing)
    return thing


def _bent(start: Vector, along: Vector, bend: Vector) -> _Path:
    """From a point along a vector, its end moved by another."""
    steps = [step / 6 for step in range(7)]
    return [start + step * along + step**2 * bend for step in steps]


def _aside(drawn: Random, size: float) -> Vector:
    return Vector([drawn.gauss(0, size) for _ in range(3)])


def _stalks(drawn: Random, point: Vector, normal: Vector, broad: float) -> list[_Path]:
    """A bunch that spreads from one point."""
    up = (normal + Vector((0, 0, drawn.uniform(0, 2)))).normalized()
    spread = drawn.uniform(0.1, 0.5)
    return [
        _bent(point, broad * (drawn.uniform(0.5, 1.2) * up + _aside(drawn, spread)),
              broad * _aside(drawn, 0.1))
        for _ in range(drawn.randint(3, 30))
    ]  # fmt: skip


def _grass(drawn: Random, point: Vector, normal: Vector, broad: float) -> list[_Path]:
    """Blades all over a patch."""
    high = broad * drawn.uniform(0.15, 0.6)
    blades = []
    for _ in range(drawn.randint(20, 150)):
        offset = broad / 2 * Vector((drawn.gauss(0, 1), drawn.gauss(0, 1), 0))
        along = high * (drawn.uniform(0.5, 1) * normal + _aside(drawn, 0.2))
        blades.append(_bent(point + offset, along, high * _aside(drawn, 0.2)))
    return blades


def _bars(drawn: Random, point: Vector, normal: Vector, broad: float) -> list[_Path]:
    """Parallel bars before a wall."""
    up = normal.orthogonal().normalized()
    turn = drawn.choice((0.0, math.pi / 2, drawn.uniform(0, math.pi)))
    side = normal.cross(up)
    along = math.cos(turn) * up + math.sin(turn) * side
    across = normal.cross(along)
    count = drawn.randint(2, 16)
    middle = point + broad * drawn.choice((0.02, 0.1, 0.5)) * normal
    bars = [middle + broad * (index / count - 0.5) * across for index in range(count + 1)]
    half = broad / 2 * along
    return [[at - half, at + half] for at in bars]


def _net(drawn: Random, point: Vector, normal: Vector, broad: float) -> list[_Path]:
    """Two sets of bars, across each other or askew."""
    return _bars(drawn, point, normal, broad) + _bars(drawn, point, normal, broad)


def _cable(drawn: Random, start: Vector, end: Vector) -> _Path:
    """What hangs between two points."""
    sag = Vector((0, 0, -drawn.uniform(0, 0.3) * (end - start).length))
    steps = [step / 16 for step in range(17)]
    return [start.lerp(end, step) + 4 * step * (1 - step) * sag for step in steps]


def _glass(drawn: Random, point: Vector, high: float) -> None:
    """A vessel with walls of glass, empty or with something in it."""
    clear = drawn.random() < 0.6
    red, green, blue = (0.9,) * 3 if clear else color(drawn)
    tint = (0.5 + red / 2, 0.5 + green / 2, 0.5 + blue / 2)
    roughness = drawn.choice((0.0, 0.0, 0.0, 0.1, 0.3))
    glass = Material("glass", tint, Transmission_Weight=1.0, IOR=1.45, Roughness=roughness)
    steps = 8
    outer = [(high * drawn.uniform(0.2, 0.45), high * step / steps) for step in range(steps + 1)]
    wall = 0.06 * high
    inner = [(radius - wall, max(up, wall)) for radius, up in reversed(outer)]
    thing = lathe([(0, 0), *outer, *inner, (0, wall)], tuple(point), glass)
    thing.modifiers.new("smooth", "SUBSURF").render_levels = 1
    if drawn.random() < 0.4:
        _threads(_stalks(drawn, point + Vector((0, 0, wall)), Vector((0, 0, 1)), 1.5 * high),
                 0.01 * high, _stuff(drawn))  # fmt: skip

"""Thin things before bright windows: muntins, leads, ironwork, blinds, curtains, railings.

What is a pixel or two wide before something fifty times as bright is where a denoiser loses most.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from random import Random

import bpy

from stillray_training.blender.joinery import Plane, Rectangle
from stillray_training.blender.materials import color, material
from stillray_training.blender.parts import Material, Point, add, box, rod, torus

_BEFORE = 0.03  # metres behind a wall's face that bars begin
_PANE = 0.12  # metres of the smallest pane's side


def _bar(low: tuple[float, float], high: tuple[float, float], deep: float, plane: Plane,
         stuff: Material) -> None:  # fmt: skip
    box(plane(*low, -_BEFORE), plane(*high, -_BEFORE - deep), stuff)


def _edges(drawn: Random, opening: Rectangle, plane: Plane, stuff: Material) -> None:
    """The frame itself."""
    (left, low), (right, high) = opening
    wide, deep = drawn.uniform(0.02, 0.07), drawn.uniform(0.03, 0.08)
    for start, end in (
        ((left, low), (left + wide, high)), ((right - wide, low), (right, high)),
        ((left, low), (right, low + wide)), ((left, high - wide), (right, high)),
    ):  # fmt: skip
        _bar(start, end, deep, plane, stuff)


def muntins(drawn: Random, opening: Rectangle, plane: Plane, stuff: Material) -> None:
    """Upright and level bars between panes."""
    _edges(drawn, opening, plane, stuff)
    (left, low), (right, high) = opening
    wide, deep = drawn.uniform(0.008, 0.04), drawn.uniform(0.01, 0.05)
    columns = drawn.randint(1, max(1, min(8, int((right - left) / _PANE))))
    rows = drawn.randint(1, max(1, min(10, int((high - low) / _PANE))))
    for column in range(1, columns):
        u = left + (right - left) * column / columns
        _bar((u - wide / 2, low), (u + wide / 2, high), deep, plane, stuff)
    for row in range(1, rows):
        v = low + (high - low) * row / rows
        # not in one plane with the uprights
        _bar((left, v - wide / 2), (right, v + wide / 2), deep * 0.9, plane, stuff)


def leads(drawn: Random, opening: Rectangle, plane: Plane, stuff: Material) -> None:
    """Thin rods across, from both sides."""
    _edges(drawn, opening, plane, stuff)
    (left, low), (right, high) = opening
    step, slope = drawn.uniform(0.15, 0.5), drawn.uniform(0.6, 1.8)
    slim = drawn.uniform(0.003, 0.012)
    reach = (high - low) / slope
    for index in range(int((right - left + reach) / step) + 1):
        for turn in (-1, 1):
            foot = left + index * step if turn < 0 else right - index * step
            # from the foot up at a slope, cut off at the opening's sides
            first = max(0.0, (foot - right) * slope if turn < 0 else (left - foot) * slope)
            last = min(high - low, (foot - left if turn < 0 else right - foot) * slope)
            if last - first > 0.02:
                start, end = (
                    plane(foot + turn * v / slope, low + v, -_BEFORE) for v in (first, last)
                )
                rod(start, end, slim, stuff)


def ironwork(drawn: Random, opening: Rectangle, plane: Plane, stuff: Material) -> None:
    """Upright rods with rings between them."""
    _edges(drawn, opening, plane, stuff)
    (left, low), (right, high) = opening
    count, slim = drawn.randint(3, 14), drawn.uniform(0.003, 0.015)
    step = (right - left) / count
    rings = drawn.choice((0.0, 0.3, 0.8))
    for index in range(count + 1):
        u = left + step * index
        rod(plane(u, low, -_BEFORE), plane(u, high, -_BEFORE), slim, stuff)
        if index < count and drawn.random() < rings:
            ring = torus(plane(u + step / 2, drawn.uniform(low, high), -_BEFORE),
                         max(step / 2 - slim, 2 * slim), slim, stuff)  # fmt: skip
            along = [b - a for a, b in zip(plane(0, 0, 0), plane(1, 0, 0), strict=True)]
            ring.rotation_euler = (math.pi / 2, 0, math.atan2(along[1], along[0]))


def pane(drawn: Random, opening: Rectangle, plane: Plane, stuff: Material) -> None:
    """Nothing but the frame."""
    _edges(drawn, opening, plane, stuff)


def blind(drawn: Random, opening: Rectangle, plane: Plane) -> None:
    """Slats, turned together, over all of the opening or its upper part."""
    (left, low), (right, high) = opening
    step, thick = drawn.uniform(0.03, 0.1), drawn.uniform(0.001, 0.006)
    turn, deep = drawn.uniform(-1.2, 1.2), step * drawn.uniform(0.6, 1.1)
    stuff = Material("slat", color(drawn), Roughness=drawn.uniform(0.3, 0.9))
    bottom = low if drawn.random() < 0.5 else drawn.uniform(low, high)
    across = (deep / 2 * math.cos(turn), deep / 2 * math.sin(turn))
    normal = (-thick / 2 * math.sin(turn), thick / 2 * math.cos(turn))
    for index in range(int((high - bottom) / step)):
        v = high - step * (index + 0.5)
        corners = [
            (a * across[0] + b * normal[0] + 0.06, v + a * across[1] + b * normal[1])
            for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
        points = [plane(u, y, h) for u in (left, right) for h, y in corners]
        sides = [(i, (i + 1) % 4, (i + 1) % 4 + 4, i + 4) for i in range(4)]
        mesh = bpy.data.meshes.new("cloth")
        mesh.from_pydata(points, [], [(0, 1, 2, 3), (4, 5, 6, 7), *sides])
        add(mesh, stuff)


def curtain(drawn: Random, opening: Rectangle, plane: Plane) -> None:
    """Cloth in folds over one side of the opening, or both."""
    (left, low), (right, high) = opening
    cloth = material(drawn, grain=0.3)
    cover = (right - left) * drawn.uniform(0.1, 0.45)
    bottom = drawn.choice((low, 0.02))
    deep, fold = drawn.uniform(0.01, 0.05), drawn.uniform(0.03, 0.12)
    starts = drawn.choice(
        ([left - 0.05], [right - cover + 0.05], [left - 0.05, right - cover + 0.05])
    )
    for start in starts:
        _folded(start, (cover, bottom, high + 0.05), (deep, fold), plane, cloth)


def _folded(start: float, size: Point, waves: tuple[float, float], plane: Plane,
            cloth: Material) -> None:  # fmt: skip
    (cover, bottom, top), (deep, fold) = size, waves
    count = max(8, int(cover / fold * 8))
    points = [
        plane(
            start + cover * i / count,
            v,
            0.08 + deep * math.sin(2 * math.pi * cover * i / count / fold),
        )
        for i in range(count + 1)
        for v in (bottom, top)
    ]
    mesh = bpy.data.meshes.new("cloth")
    mesh.from_pydata(points, [], [(2 * i, 2 * i + 2, 2 * i + 3, 2 * i + 1) for i in range(count)])
    mesh.shade_smooth()
    add(mesh, cloth)


def railing(drawn: Random, opening: Rectangle, plane: Plane) -> None:
    """Balusters and a rail, before the lower part of the opening."""
    (left, low), (right, high) = opening
    top, step = low + (high - low) * drawn.uniform(0.3, 0.7), drawn.uniform(0.06, 0.2)
    slim, out = drawn.uniform(0.003, 0.015), drawn.uniform(0.05, 0.5)
    stuff = Material("rail", color(drawn), Roughness=0.4, Metallic=drawn.choice((0.0, 1.0)))
    for index in range(int((right - left) / step) + 1):
        u = left + index * step
        rod(plane(u, low, out), plane(u, top, out), slim, stuff)
    rod(plane(left, top, out), plane(right, top, out), slim * 2, stuff)


#: What is drawn into an opening, of a frame's material.
LATTICES: tuple[Callable[[Random, Rectangle, Plane, Material], None], ...] = (
    muntins, muntins, leads, ironwork, pane,
)  # fmt: skip

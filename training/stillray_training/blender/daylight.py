"""Sun, sky, and the windows through which they come in."""

from __future__ import annotations

import math

import bpy

from stillray_training.blender.lattices import LATTICES, blind, curtain, railing
from stillray_training.blender.materials import color
from stillray_training.blender.parts import Material, Point, background, box, light
from stillray_training.blender.place import Place


def pierced(
    place: Place, length: float, across: tuple[float, float], wall: Material, *, side: bool
) -> None:
    """A wall with windows along x at y = ``across[0]``, or along y at x if ``side``; and sun."""
    drawn, (offset, height) = place.drawn, across
    low, high = drawn.uniform(0.3, 1.0), height - drawn.uniform(0.2, 0.6)

    def piece(start: float, end: float, bottom: float, top: float, stuff: Material,
              thick: tuple[float, float] = (0.0, 0.12)) -> None:  # fmt: skip
        near, far = offset + thick[0], offset + thick[1]
        if side:
            box((near, start, bottom), (far, end, top), stuff)
        else:
            box((start, near, bottom), (end, far, top), stuff)

    piece(0, length, 0, low, wall)
    piece(0, length, high, height, wall)
    frame = Material("frame", color(drawn), Roughness=drawn.uniform(0.2, 0.7))
    count = drawn.randint(1, 3)
    broad = length / count
    powers = drawn.uniform(8, 60)
    for index in range(count):
        margin = broad * drawn.uniform(0.1, 0.3)
        start, end = index * broad + margin, (index + 1) * broad - margin
        piece(index * broad, start, low, high, wall)
        piece(end, (index + 1) * broad, low, high, wall)
        bar = drawn.uniform(0.015, 0.05)
        bars = drawn.randint(1, 5)
        for part in range(bars + 1):
            z = low + (high - low - bar) * part / bars
            piece(start, end, z, z + bar, frame, (0.03, 0.07))
        uprights = drawn.randint(1, 4)
        for part in range(uprights + 1):
            x = start + (end - start - bar) * part / uprights
            piece(x, x + bar, low, high, frame, (0.03, 0.07))
        if drawn.random() < 0.3:
            slats = int((high - low) / drawn.uniform(0.05, 0.12))
            for part in range(slats):
                z = low + (high - low) * part / slats
                piece(start, end, z, z + 0.012, frame, (-0.05, -0.01))
        if drawn.random() < 0.7:
            middle, z = (start + end) / 2, (low + high) / 2
            at = (offset + 0.2, middle, z) if side else (middle, offset + 0.2, z)
            to = (0, middle, z) if side else (middle, 0, z)
            size = (end - start, high - low)
            place.lamps.append(light(
                "AREA", at, to, powers * size[0] * size[1], shape="RECTANGLE", size=size[0],
                size_y=size[1], color=(0.78, 0.88, 1.0),
            ))  # fmt: skip
    sky(place)
    far = (offset + 6, length * drawn.uniform(0.1, 0.9), 5.0)
    high_up = far if side else (far[1], far[0], far[2])
    sun(place, high_up, (length / 2, length / 2, 0.0))


def sky(place: Place) -> None:
    drawn = place.drawn
    if drawn.random() < 0.4:
        background(color(drawn), drawn.uniform(0.3, 2.5))
        return
    world = bpy.data.worlds.new("world")
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    texture = nodes.new("ShaderNodeTexSky")
    texture.sun_disc, texture.sun_elevation = False, math.radians(drawn.uniform(8, 70))
    nodes["Background"].inputs["Strength"].default_value = drawn.uniform(0.05, 0.4)
    links.new(texture.outputs[0], nodes["Background"].inputs["Color"])
    bpy.context.scene.world = world


def sun(place: Place, at: Point, to: Point) -> None:
    drawn = place.drawn
    if drawn.random() < 0.7:
        angle = math.radians(drawn.choice((0.5, 0.5, drawn.uniform(1, 8))))
        place.lamps.append(
            light("SUN", at, to, drawn.uniform(1, 9), angle=angle, color=(1, 0.93, 0.82))
        )


def bright_wall(
    place: Place, length: float, across: tuple[float, float], wall: Material, *, side: bool
) -> None:
    """A wall with windows far brighter than the room, and thin things before them.

    Parameters
    ----------
    place
        What it is built in, and what draws it.
    length
        Of the wall, along x or y from 0, metres.
    across
        Where it stands on the other axis, and its height, metres.
    wall
        What it is made of.
    side
        Whether it runs along y, at x = ``across[0]``.
    """
    drawn, (offset, height) = place.drawn, across

    def plane(u: float, v: float, h: float) -> Point:
        return (offset - h, u, v) if side else (u, offset - h, v)

    def piece(low: tuple[float, float], high: tuple[float, float]) -> None:
        near, far = plane(*low, 0.0), plane(*high, -drawn.uniform(0.08, 0.3))
        box(near, far, wall)

    low, high = drawn.choice((0.05, drawn.uniform(0.3, 1.1))), height - drawn.uniform(0.1, 0.6)
    piece((0, 0), (length, low))
    piece((0, high), (length, height))
    frame = Material("frame", color(drawn), Roughness=drawn.uniform(0.2, 0.8))
    count = drawn.randint(1, 3)
    broad = length / count
    margin = broad * drawn.uniform(0.04, 0.25)
    radiance = 10 ** drawn.uniform(0.3, 1.7)
    draw = drawn.choice(LATTICES)
    for index in range(count):
        start, end = index * broad + margin, (index + 1) * broad - margin
        piece((index * broad, low), (start, high))
        piece((end, low), ((index + 1) * broad, high))
        opening = ((start, low), (end, high))
        draw(drawn, opening, plane, frame)
        if drawn.random() < 0.4:
            drawn.choice((blind, curtain, railing))(drawn, opening, plane)
        middle = ((start + end) / 2, (low + high) / 2)
        size = (end - start + 0.4, high - low + 0.4)
        # an area lamp's radiance is its power over pi and its size
        lamp = light(
            "AREA", plane(*middle, -0.5), plane(*middle, 1.0),
            math.pi * radiance * size[0] * size[1], shape="RECTANGLE", size=size[0],
            size_y=size[1], color=(drawn.uniform(0.8, 1.0), 0.92, drawn.uniform(0.8, 1.0)),
        )  # fmt: skip
        lamp.visible_camera = True
        place.lamps.append(lamp)

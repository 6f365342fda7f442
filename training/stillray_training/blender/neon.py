"""A look of its own, that no training has seen: an alley of signs at night, in fog, painted flat.

Tubes and signs light coloured haze; what stands there shines, or is shaded in steps as in cartoons.
What a model gains by learning from such a show is measured on it (docs/own-renders.md).
"""

from __future__ import annotations

import colorsys
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
    light,
    rod,
    torus,
)

_WIDE, _LONG, _HIGH = 1.8, 12.0, 4.5  # half the alley's width, its length, its walls; metres


def build(seed: int, frames: int) -> None:
    """An alley of a seed, and what moves over frames -1 to ``frames``.

    Parameters
    ----------
    seed
        Other seeds give other alleys.
    frames
        How many will be rendered.
    """
    drawn = Random(f"neon {seed}")
    tints = [drawn.random() for _ in range(3)]  # a show has few colours
    _alley(drawn, tints)
    for _ in range(drawn.randint(7, 11)):
        _tube(drawn, tints)
    for _ in range(drawn.randint(3, 5)):
        _sign(drawn, tints)
    things = [_figure(drawn, tints) for _ in range(drawn.randint(3, 5))]
    _fog(drawn)
    background(_vivid(drawn, tints, 0.6), 0.03)
    at = (drawn.uniform(-1.0, 1.0), drawn.uniform(0.2, 1.5), drawn.uniform(0.9, 1.9))
    to = (drawn.uniform(-0.8, 0.8), drawn.uniform(5, 8), drawn.uniform(0.8, 1.6))
    eye = camera(at, to, drawn.uniform(22, 38))
    moves = [(eye, (drawn.gauss(0, 0.015), drawn.uniform(0.0, 0.05), drawn.gauss(0, 0.008)))]
    moves += [(thing, (drawn.gauss(0, 0.03), drawn.gauss(0, 0.05), 0.0)) for thing in things[:2]]
    for thing, step in moves:
        key(thing, Vector(step), frames, stands=0)


def _vivid(drawn: Random, tints: list[float], value: float = 1.0) -> Color:
    hue = drawn.choice(tints) + drawn.uniform(-0.04, 0.04)
    return colorsys.hsv_to_rgb(hue % 1.0, drawn.uniform(0.65, 1.0), value)


def _toon(color: Color, *, shiny: bool) -> Material:
    """Light in steps: full or none, but for a narrow edge."""
    made = Material("toon", color)
    flat = made.node("BsdfToon", Color=(*color, 1), Size=0.7, Smooth=0.05)
    output = made.nodes["Material Output"].inputs["Surface"]
    if not shiny:
        made.links.new(flat.outputs[0], output)
        return made
    spot = made.node("BsdfToon", Color=(1, 1, 1, 1), Size=0.25, Smooth=0.05)
    spot.component = "GLOSSY"
    both = made.node("MixShader", Fac=0.2)
    made.links.new(flat.outputs[0], both.inputs[1])
    made.links.new(spot.outputs[0], both.inputs[2])
    made.links.new(both.outputs[0], output)
    return made


def _alley(drawn: Random, tints: list[float]) -> None:
    wet = Material("wet", (0.05, 0.05, 0.06), Roughness=drawn.uniform(0.05, 0.3))
    box((-_WIDE, -1, -0.1), (_WIDE, _LONG, 0), wet)
    for side in (-1, 1):
        y = -1.0
        while y < _LONG:  # houses, each in a colour of its own
            deep, high = drawn.uniform(1.0, 3.0), drawn.uniform(2.5, _HIGH)
            out = _WIDE + drawn.uniform(0.0, 0.35)
            near, far = sorted((side * out, side * (out + 0.5)))
            paint = _toon(_vivid(drawn, tints, drawn.uniform(0.1, 0.7)), shiny=False)
            box((near, y, 0), (far, y + deep, high), paint)
            y += deep
    end = _toon(_vivid(drawn, tints, 0.3), shiny=False)
    box((-3, _LONG, 0), (3, _LONG + 0.2, _HIGH), end)


def _wall(drawn: Random) -> Point:
    """A place before one of the walls."""
    side = drawn.choice((-1, 1))
    return side * (_WIDE - 0.06), drawn.uniform(2.5, _LONG - 1), drawn.uniform(0.5, 3.2)


def _tube(drawn: Random, tints: list[float]) -> None:
    x, y, z = _wall(drawn)
    glow = glowing(_vivid(drawn, tints), drawn.uniform(15, 60))
    if drawn.random() < 0.3:
        ring = torus((x, y, z), drawn.uniform(0.15, 0.4), 0.02, glow)
        ring.rotation_euler = (0, math.pi / 2, 0)
        return
    turn, long = drawn.choice((0.0, math.pi / 2, drawn.uniform(0, 3))), drawn.uniform(0.4, 1.4)
    end = (x, y + long * math.cos(turn), z + long * math.sin(turn))
    rod((x, y, z), end, 0.018, glow)


def _sign(drawn: Random, tints: list[float]) -> None:
    """A box that shines in stripes or squares."""
    x, y, z = _wall(drawn)
    made = glowing(_vivid(drawn, tints), drawn.uniform(2, 8))
    kind = drawn.choice(("TexChecker", "TexBrick"))
    pattern = made.node(kind, Vector=made.coordinates(), Scale=drawn.uniform(4, 14))
    for name in ("Color1", "Color2"):
        pattern.inputs[name].default_value = (*_vivid(drawn, tints), 1)
    made.vary("Emission Color", pattern.outputs["Color"])
    long, high = drawn.uniform(0.3, 0.9), drawn.uniform(0.3, 1.2)
    box((x - 0.04, y, z), (x + 0.04, y + long, z + high), made)


def _figure(drawn: Random, tints: list[float]) -> bpy.types.Object:
    """A body with a head, flat as ink; the body is returned and carries the head."""
    at = (drawn.uniform(-1.2, 1.2), drawn.uniform(3.0, 8.0), 0.0)
    broad, high = drawn.uniform(0.15, 0.4), drawn.uniform(0.5, 1.4)
    paint = _toon(_vivid(drawn, tints, drawn.uniform(0.4, 1.0)), shiny=drawn.random() < 0.5)
    body = rod(at, (at[0], at[1], high), broad, paint)
    head = _toon(_vivid(drawn, tints, 0.9), shiny=True)
    top = ball((0, 0, high / 2 + broad * 0.8), broad * drawn.uniform(0.9, 1.3), head)
    top.parent = body
    return body


def _fog(drawn: Random) -> None:
    haze = Material("fog")
    haze.scatter(Density=drawn.uniform(0.03, 0.12), Anisotropy=drawn.uniform(0.0, 0.6))
    box((-4, -2, -0.5), (4, _LONG + 1, 6), haze)
    light("POINT", (0, drawn.uniform(3, 9), 5.0), (0, 0, 0), drawn.uniform(30, 150),
          shadow_soft_size=0.3, color=colorsys.hsv_to_rgb(drawn.random(), 0.4, 1.0))  # fmt: skip

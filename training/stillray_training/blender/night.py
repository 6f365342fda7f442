"""Night: a sky that gives next to nothing, many lamps, and floors that mirror them."""

from __future__ import annotations

from random import Random

import bpy
from mathutils import Vector

from stillray_training.blender.lamps import shining
from stillray_training.blender.log_uniform import log_uniform
from stillray_training.blender.materials import color
from stillray_training.blender.parts import (
    Material,
    background,
    ball,
    box,
    glowing,
    principled,
    rod,
)
from stillray_training.blender.view import View

_LAMPS = (4, 30)
_BROAD = (0.003, 0.03)  # of a lamp, of the picture's width
_DIMMED = (0.0, 0.05)  # what is left of lights that the scene had
_WET = 0.7  # share of nights after rain
_LIT = 0.45  # share of panes behind which there is light


def fall(drawn: Random) -> None:
    """Dim the scene that is built, and light lamps all about what its camera sees."""
    for data in bpy.data.lights:
        data.energy *= drawn.choice(_DIMMED)
    background(color(drawn), log_uniform(drawn, 0.003, 0.1))
    if drawn.random() < _WET:
        _rain(drawn)
    _light_panes(drawn)
    view = View()
    for point, normal, far in view.places(drawn, drawn.randint(*_LAMPS)):
        broad = far * view.width * log_uniform(drawn, *_BROAD)
        off = far * view.width * log_uniform(drawn, 0.02, 0.4)
        at = point + normal * (broad + off) + off * Vector((0, 0, drawn.uniform(0, 2)))
        if drawn.random() < 0.3:
            rod(tuple(point), tuple(at), broad / 8, Material("pole", color(drawn), Roughness=0.5))
        _lamp(drawn, at, broad)


def _lamp(drawn: Random, at: Vector, broad: float) -> None:
    stuff = shining(drawn)
    kind = drawn.choice(("ball", "ball", "sign", "tube"))
    if kind == "ball":
        ball(tuple(at), broad / 2, stuff)
    elif kind == "tube":
        along = broad * drawn.uniform(1, 8) * Vector([drawn.gauss(0, 1) for _ in range(3)])
        rod(tuple(at - along / 2), tuple(at + along / 2), broad / 6, stuff)
    else:
        x, y, z = (broad * drawn.uniform(0.3, 3) for _ in range(3))
        pattern = stuff.node(
            "TexBrick", Vector=stuff.coordinates(), Scale=4 / broad,
            Color1=(*color(drawn), 1), Color2=(*color(drawn), 1),
        )  # fmt: skip
        stuff.vary("Emission Color", pattern.outputs["Color"])
        box((at.x - x, at.y - y, at.z - z), (at.x + x, at.y + y, at.z + z), stuff)


def _rain(drawn: Random) -> None:
    """Most materials become smoother, the more so in patches, where water stands."""
    for made in principled():
        if drawn.random() < 0.3:
            continue
        smooth, dry = drawn.uniform(0.02, 0.15), drawn.uniform(0.15, 0.6)
        water = made.node("TexNoise", Vector=made.coordinates(), Scale=drawn.uniform(0.4, 3))
        rough = made.node(
            "MapRange", Value=water.outputs[0],
            From_Min=0.4, From_Max=0.6, To_Min=smooth, To_Max=dry,
        )  # fmt: skip
        made.vary("Roughness", rough.outputs[0])


def _light_panes(drawn: Random) -> None:
    for thing in bpy.context.scene.objects:
        used = thing.data.materials if thing.type == "MESH" else ()
        panes = any(each and each.name.startswith("panes") for each in used)
        if panes and drawn.random() < _LIT:
            strength = log_uniform(drawn, 0.2, 8)
            lit = glowing((1, drawn.uniform(0.5, 0.9), drawn.uniform(0.2, 0.8)), strength)
            thing.data.materials[0] = lit.data

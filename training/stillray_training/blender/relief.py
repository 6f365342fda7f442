"""Relief that only normals show, on all that a scene has.

Albedo tells a network where most patterns lie. Plaster, hammered metal, bark and carving have one
color: what shades them stands in their normals alone, and in light that few samples hide.
"""

from __future__ import annotations

from random import Random
from typing import Any

from stillray_training.blender.log_uniform import log_uniform
from stillray_training.blender.parts import Material, principled

_PLAIN = 0.6  # share of the surfaces that lose their pattern
_SMOOTH = 0.15  # and of those that are left as they are
_SIZES = (0.012, 0.25)  # of a bump, metres
_SLOPES = (0.08, 0.8)  # height over size
_KINDS = ("cells", "cells", "dents", "noise", "noise", "bricks", "waves")


def emboss_all(drawn: Random) -> None:
    """Give most surfaces of the scene one color and relief."""
    for made in principled():
        surface = made.surface
        if surface.inputs["Emission Strength"].default_value > 0:
            continue
        if surface.inputs["Transmission Weight"].default_value > 0 or drawn.random() < _SMOOTH:
            continue
        if any(node.type == "TEX_IMAGE" for node in made.nodes):  # with its own relief
            continue
        if drawn.random() < _PLAIN:
            for link in list(surface.inputs["Base Color"].links):
                made.links.remove(link)
        for link in list(surface.inputs["Normal"].links):
            made.links.remove(link)
        size = log_uniform(drawn, *_SIZES)
        made.emboss(_height(made, drawn, size), size * log_uniform(drawn, *_SLOPES))


def _height(made: Material, drawn: Random, size: float) -> Any:
    """A height in [0, 1] over the surface, with bumps of ``size`` metres: an output."""
    turned = (drawn.uniform(0, 3), drawn.uniform(0, 3), drawn.uniform(0, 3))
    at = made.coordinates(rotation=turned)
    kind = drawn.choice(_KINDS)
    if kind in ("cells", "dents"):
        cells = made.node("TexVoronoi", Vector=at, Scale=1 / size)
        cells.feature = "DISTANCE_TO_EDGE" if kind == "cells" else "F1"
        return cells.outputs["Distance"]
    if kind == "bricks":
        bricks = made.node(
            "TexBrick", Vector=at, Scale=0.5 / size, Color1=(1, 1, 1, 1), Color2=(0.8,) * 3 + (1,),
            Mortar=(0, 0, 0, 1), Mortar_Size=drawn.uniform(0.01, 0.06),
        )  # fmt: skip
        return bricks.outputs["Color"]
    if kind == "waves":
        waves = made.node(
            "TexWave", Vector=at, Scale=0.3 / size, Distortion=drawn.choice((0.0, 3.0, 8.0))
        )
        return waves.outputs[1]
    return made.node("TexNoise", Vector=at, Scale=0.7 / size, Detail=drawn.uniform(0, 6)).outputs[0]

"""Smoke: clouds of uneven density that some of the view has before it."""

from __future__ import annotations

from random import Random

import bpy
from mathutils import Vector

from stillray_training.blender.log_uniform import log_uniform
from stillray_training.blender.materials import color
from stillray_training.blender.parts import Material, box
from stillray_training.blender.view import View

_CLOUDS = (1, 3)
_BROAD = (0.1, 0.7)  # of the picture's width
_LOST = (1.0, 15.0)  # optical depth where one is dense
_BOUNCES = 4  # within it, at most


def blow(drawn: Random) -> None:
    """Hang clouds before what the camera of the scene sees."""
    view = View()
    for point, normal, far in view.places(drawn, drawn.randint(*_CLOUDS)):
        broad = far * view.width * log_uniform(drawn, *_BROAD)
        half = (
            broad / 2 * Vector([drawn.uniform(0.5, 1) for _ in range(2)] + [drawn.uniform(0.5, 2)])
        )
        middle = point + 0.5 * broad * normal
        low, high = (tuple(middle + sign * half) for sign in (-1, 1))
        box(low, high, _stuff(drawn, broad))
    settings = bpy.context.scene.cycles
    settings.volume_bounces = drawn.randint(0, _BOUNCES)
    settings.volume_biased = True  # by steps: what is unbiased takes 50 s to set up, every frame


def _stuff(drawn: Random, broad: float) -> Material:
    """Dense where a noise is high, and nowhere near the faces of its box."""
    smoke = Material("smoke")
    swirls = smoke.node(
        "TexNoise", Vector=smoke.coordinates(), Scale=log_uniform(drawn, 1.5, 12) / broad,
        Detail=drawn.choice((1.0, 3.0, 6.0)), Distortion=drawn.uniform(0, 2),
    )  # fmt: skip
    inside = smoke.node("TexGradient", Vector=smoke.coordinates((2 / broad,) * 3))
    inside.gradient_type = "SPHERICAL"
    shape = smoke.node("Math")
    shape.operation = "ADD"
    smoke.links.new(swirls.outputs[0], shape.inputs[0])
    smoke.links.new(inside.outputs[1], shape.inputs[1])
    dense = smoke.node(
        "MapRange", Value=shape.outputs[0], From_Min=0.75, From_Max=drawn.uniform(0.8, 1.3),
        To_Min=0.0, To_Max=log_uniform(drawn, *_LOST) / broad,
    )  # fmt: skip
    tint = color(drawn) if drawn.random() < 0.4 else (0.9, 0.9, 0.9)
    smoke.scatter(Color=(*tint, 1), Density=dense.outputs[0], Anisotropy=drawn.uniform(-0.1, 0.6))
    return smoke

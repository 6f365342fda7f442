"""Small lamps in view: what is as bright as a firefly, and none."""

from __future__ import annotations

from random import Random

import bpy

from stillray_training.blender.log_uniform import log_uniform
from stillray_training.blender.materials import color
from stillray_training.blender.parts import Material, ball, box, rod
from stillray_training.blender.view import View

_COUNT = (1, 6)
_BROAD = (0.7, 12.0)  # pixels
_STRENGTH = (0.5, 300.0)  # radiance


def light_up(drawn: Random) -> None:
    """Put shining balls, plates and tubes where the camera of the scene looks."""
    view, size = View(), bpy.context.scene.render.resolution_x
    for point, normal, far in view.places(drawn, drawn.randint(*_COUNT)):
        broad = far * view.width / size * log_uniform(drawn, *_BROAD)
        at = point + broad * normal
        stuff = shining(drawn)
        kind = drawn.choice(("ball", "plate", "tube"))
        if kind == "ball":
            ball(tuple(at), broad / 2, stuff)
        elif kind == "plate":
            half = [broad / 2 * drawn.choice((0.2, 1.0, 1.0)) for _ in range(3)]
            low, high = (
                (at.x + side * half[0], at.y + side * half[1], at.z + side * half[2])
                for side in (-1, 1)
            )
            box(low, high, stuff)
        else:
            along = broad * drawn.uniform(1, 6) * normal.orthogonal().normalized()
            rod(tuple(at - along / 2), tuple(at + along / 2), broad / 6, stuff)


def shining(drawn: Random) -> Material:
    """A material that shines, of a colour and brightness by chance."""
    stuff = Material("lamp", drawn.choice(((0.0,) * 3, (0.8,) * 3, color(drawn))))
    red, green, blue = color(drawn) if drawn.random() < 0.3 else (1, drawn.uniform(0.6, 1), 0.7)
    stuff.surface.inputs["Emission Color"].default_value = (red, green, blue, 1)
    stuff.surface.inputs["Emission Strength"].default_value = log_uniform(drawn, *_STRENGTH)
    return stuff

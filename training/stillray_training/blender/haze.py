"""Air that scatters light: what lies behind it is paler, and lamps and beams are seen in it."""

from __future__ import annotations

from random import Random

import bpy

from stillray_training.blender.log_uniform import log_uniform
from stillray_training.blender.materials import color
from stillray_training.blender.parts import Material, box
from stillray_training.blender.view import View, usual_distance

_LOST = (0.05, 1.5)  # optical depth of what the camera usually sees
_FAR = 40.0  # metres from the camera to where haze ends
_BOUNCES = 4  # within it, at most


def fill(drawn: Random) -> None:
    """Fill the scene that is built with haze, through which its camera sees."""
    places = View().places(drawn, 9)
    if not places:
        return
    usual = usual_distance(places)
    haze = Material("haze")
    tint = color(drawn) if drawn.random() < 0.3 else (1, 1, 1)
    haze.scatter(
        Color=(*tint, 1),
        Density=log_uniform(drawn, *_LOST) / usual,
        Anisotropy=drawn.uniform(-0.1, 0.7),
    )
    x, y, z = bpy.context.scene.camera.location
    box((x - _FAR, y - _FAR, z - _FAR), (x + _FAR, y + _FAR, z + _FAR), haze)
    bpy.context.scene.cycles.volume_bounces = drawn.randint(0, _BOUNCES)

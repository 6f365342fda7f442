"""Wax, marble, milk, skin: surfaces that light enters, to leave them elsewhere."""

from __future__ import annotations

from random import Random

import bpy

from stillray_training.blender.log_uniform import log_uniform
from stillray_training.blender.parts import principled
from stillray_training.blender.view import View, usual_distance

_SHARE = (0.1, 0.7)  # of the scene's materials
_DEEP = (0.002, 0.06)  # how far light comes, of the usual distance


def soften(drawn: Random) -> None:
    """Let light into some materials of the scene that is built."""
    places = View().places(drawn, 9)
    usual = usual_distance(places) if places else 1.0
    share = drawn.uniform(*_SHARE)
    for made in principled():
        into = made.surface.inputs
        if drawn.random() < share and not into["Metallic"].default_value:
            into["Subsurface Weight"].default_value = drawn.choice((0.3, 1.0, 1.0))
            into["Subsurface Scale"].default_value = usual * log_uniform(drawn, *_DEEP)
            into["Subsurface Radius"].default_value = [drawn.uniform(0.1, 1) for _ in range(3)]
    bpy.context.view_layer.update()

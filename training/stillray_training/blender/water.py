"""Water that stands over what a camera sees: floors refracted, the rest mirrored in its ripples."""

from __future__ import annotations

from random import Random

import bpy
from mathutils import Vector

from stillray_training.blender.log_uniform import log_uniform
from stillray_training.blender.materials import color
from stillray_training.blender.parts import Material, add, primitive
from stillray_training.blender.view import View, usual_distance

_DEEP = (0.0, 0.3)  # above the lowest point seen, of the usual distance
_RIPPLE = (0.01, 0.3)  # their length, of the usual distance
_STEEP = (0.02, 0.4)  # their height, of their length
_CAUSTICS = 0.8  # share of waters whose light is gathered on what lies below
_FAR = 60.0  # metres across


def flood(drawn: Random) -> None:
    """Let water stand in the scene that is built, unless its camera would be under it."""
    scene = bpy.context.scene
    places = View().places(drawn, 15)
    if not places:
        return
    usual = usual_distance(places)
    lowest = min(point.z for point, *_ in places)
    high = lowest + usual * drawn.uniform(*_DEEP)
    eye = scene.camera.location
    if eye.z < high + 0.1 * usual:
        return
    scene.cycles.caustics_refractive = scene.cycles.caustics_reflective = drawn.random() < _CAUSTICS
    red, green, blue = (0.7 + 0.3 * part for part in color(drawn))
    rough = drawn.choice((0.0, 0.0, 0.05))
    water = Material(
        "water", (red, green, blue), Roughness=rough, Transmission_Weight=1.0, IOR=1.33
    )
    long = usual * log_uniform(drawn, *_RIPPLE)
    waves = water.node(
        "TexNoise", Vector=water.coordinates(), Scale=1 / long, Detail=drawn.choice((0.0, 2.0, 5.0))
    )
    water.emboss(waves.outputs[0], long * log_uniform(drawn, *_STEEP))
    mesh = primitive("grid", x_segments=1, y_segments=1, size=_FAR / 2)
    thing = add(mesh, water)
    thing.location = Vector((eye.x, eye.y, high))

"""A lens wide open: what lies before and behind its focus is a disc for every point."""

from __future__ import annotations

from random import Random

import bpy

from stillray_training.blender.log_uniform import log_uniform
from stillray_training.blender.view import View

_DISC = (2.0, 30.0)  # pixels across


def open_lens(distance: float, disc: float) -> None:
    """Focus the scene's camera on a distance, and open its lens.

    Parameters
    ----------
    distance
        In focus, metres.
    disc
        Diameter of the disc that a point infinitely far away becomes, pixels; one at half the
        distance becomes as large a one.
    """
    scene = bpy.context.scene
    eye = scene.camera.data
    eye.dof.use_dof, eye.dof.focus_distance = True, distance
    # a thin lens of diameter a focused on d: a (focal length in pixels) / d of what is far away
    pixels = max(scene.render.resolution_x, scene.render.resolution_y)
    focal = eye.lens / eye.sensor_width * pixels
    diameter = disc * distance / focal
    # the f-stop is the focal length, always in millimetres, over the diameter
    eye.dof.aperture_fstop = eye.lens * 1e-3 / diameter


def open_somewhere(drawn: Random) -> None:
    """Focus on something that the camera sees, and open the lens by chance."""
    places = View().places(drawn, 1)
    if places:
        *_, far = places[0]
        open_lens(far, log_uniform(drawn, *_DISC))

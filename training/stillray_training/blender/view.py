"""What the camera of a scene sees, by rays."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random

import bpy
from mathutils import Vector

_NEAR = 0.3  # metres, before which nothing is stood


def usual_distance(places: Sequence[tuple[Vector, Vector, float]]) -> float:
    """The middle one of distances of `View.places`, of which there must be one."""
    return sorted(far for *_, far in places)[len(places) // 2]


class View:
    """The scene as its camera sees it.

    Attributes
    ----------
    width
        Of the picture, in distances.
    """

    def __init__(self) -> None:
        bpy.context.view_layer.update()
        self._depsgraph = bpy.context.evaluated_depsgraph_get()
        eye = bpy.context.scene.camera
        self._at, self._turned = eye.matrix_world.translation, eye.matrix_world.to_3x3()
        self.width = eye.data.sensor_width / eye.data.lens

    def seen(self, drawn: Random) -> tuple[Vector, Vector, float] | None:
        """A point that a random pixel sees, its normal and distance; None if that is the sky."""
        x, y = (self.width * drawn.uniform(-0.5, 0.5) for _ in range(2))
        way = (self._turned @ Vector((x, y, -1))).normalized()
        scene = bpy.context.scene
        hit, point, normal, *_ = scene.ray_cast(self._depsgraph, self._at, way, distance=50)
        far = (point - self._at).length
        if not hit or far < _NEAR:
            return None
        return point, normal if normal.dot(way) < 0 else -normal, far

    def places(self, drawn: Random, count: int) -> list[tuple[Vector, Vector, float]]:
        """So many of `seen`, or fewer where much is sky."""
        found = [self.seen(drawn) for _ in range(3 * count)]
        return [place for place in found if place][:count]

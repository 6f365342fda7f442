"""Pictures on surfaces and screens."""

from __future__ import annotations

import numpy as np

from stillray_training.simulate.effects.base import Effect
from stillray_training.simulate.node import Node
from stillray_training.simulate.textures import Texture as Picture
from stillray_training.simulate.world import Lamp, Surface, World


class Texture(Effect):
    """Reflectances and screens from pictures in place of one colour."""

    name = "texture"
    summary = "reflectance pictures (checker, wood, marble, print ...) in place of one colour"

    def missing(self, world: World) -> str | None:
        if any(piece.surface.texture for piece in world.pieces):
            return None
        return "a surface with a texture"

    def reflectance(self, surface: Surface, node: object) -> object:
        if surface.texture is None:
            return node
        return bitmap(surface.texture.image(), surface.texture.size, self.name)

    def emitter(self, lamp: Lamp, node: Node) -> Node | None:
        if lamp.picture is None or node.plugin != "area":
            return node
        image = lamp.picture.image()
        # the screen keeps its power
        image = image / max(float(image.mean()), 1e-6) * np.array(lamp.radiance, np.float32)
        return Node(
            plugin="area",
            asked_by=node.asked_by,
            params={"radiance": bitmap(image, lamp.picture.size, self.name)},
        )


def bitmap(image: np.ndarray, size: float, asked_by: str) -> Node:
    """A texture node that spans ``size`` metres of the surface and repeats, row 0 on top."""
    image = np.ascontiguousarray(image[::-1])  # Mitsuba has v = 0 at the first row
    scale = np.diag([1 / size, 1 / size, 1.0, 1.0])
    params = {"bitmap": image, "raw": True, "to_uv": scale}
    return Node(plugin="bitmap", asked_by=asked_by, params=params)


def roughness_bitmap(picture: Picture, asked_by: str) -> Node:
    """A grey picture of alphas."""
    return bitmap(picture.image().mean(axis=-1), picture.size, asked_by)

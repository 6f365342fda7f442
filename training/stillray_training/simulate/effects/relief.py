"""Relief that only normals show."""

from __future__ import annotations

from stillray_training.simulate.effects.base import Effect
from stillray_training.simulate.effects.texture import bitmap
from stillray_training.simulate.node import Node
from stillray_training.simulate.world import Surface, World


class Relief(Effect):
    """Normal maps on the surfaces that have a relief: flat geometry, shaded as if it were not."""

    name = "relief"
    summary = "normal maps: panels, mouldings, planks, bricks, tiles, weave, plaster"

    def missing(self, world: World) -> str | None:
        if any(piece.surface.relief for piece in world.pieces):
            return None
        return "a surface with a relief"

    def bsdf(self, surface: Surface, reflectance: object, node: Node) -> Node:
        if surface.relief is None or surface.special:
            return node
        picture = surface.relief.picture
        normals = bitmap(surface.relief.normals(), picture.size, self.name)
        params = {"normalmap": normals, "bsdf": node}
        return Node(plugin="normalmap", asked_by=self.name, params=params)

"""Mirrors and clear glass."""

from __future__ import annotations

from stillray_training.simulate.effects.base import Effect
from stillray_training.simulate.node import Node, rgb
from stillray_training.simulate.world import Piece, Surface, World


class MirrorGlass(Effect):
    """Smooth conductors and dielectrics; window panes exist only with it."""

    name = "mirror_glass"
    summary = "smooth mirrors, glass bodies, window panes"
    extra_depth = 4  # two bounces into a glass body and two out of it

    def missing(self, world: World) -> str | None:
        if any(piece.surface.special for piece in world.pieces):
            return None
        return "a mirror or a glass surface"

    def keeps(self, piece: Piece) -> bool:
        return piece.surface.special == "pane"

    def bsdf(self, surface: Surface, reflectance: object, node: Node) -> Node:
        tint = rgb(surface.color)
        if surface.special == "mirror":
            params = {"material": "none", "specular_reflectance": tint}
            return Node(plugin="conductor", asked_by=self.name, params=params)
        if surface.special == "glass":
            clear = {"int_ior": 1.5, "specular_transmittance": tint}
            return Node(plugin="dielectric", asked_by=self.name, params=clear)
        if surface.special == "pane":
            return Node(plugin="thindielectric", asked_by=self.name, params={"int_ior": 1.5})
        return node

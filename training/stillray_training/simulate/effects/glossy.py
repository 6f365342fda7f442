"""Glossy reflection: rough coats over a diffuse ground, rough metals."""

from __future__ import annotations

from stillray_training.simulate.effects.base import Effect
from stillray_training.simulate.effects.texture import roughness_bitmap
from stillray_training.simulate.node import Node
from stillray_training.simulate.world import Surface, World


class Glossy(Effect):
    """GGX lobes on the surfaces that have a roughness."""

    name = "glossy"
    summary = "GGX reflection: varnish, polished stone, brushed and cast metal, roughness maps"

    def missing(self, world: World) -> str | None:
        if any(piece.surface.roughness is not None for piece in world.pieces):
            return None
        return "a surface with a roughness"

    def bsdf(self, surface: Surface, reflectance: object, node: Node) -> Node:
        if surface.roughness is None or surface.special:
            return node
        alpha: float | Node = surface.roughness
        if surface.roughness_texture is not None and surface.metal:
            # only conductors take a picture of alphas in Mitsuba 3
            alpha = roughness_bitmap(surface.roughness_texture, self.name)
        params: dict[str, object] = {"distribution": "ggx", "alpha": alpha}
        if surface.metal:
            plugin, params["specular_reflectance"] = "roughconductor", reflectance
            params["material"] = "none"
        else:
            plugin, params["diffuse_reflectance"] = "roughplastic", reflectance
        return Node(plugin=plugin, asked_by=self.name, params=params)

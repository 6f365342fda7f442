"""Depth of field."""

from __future__ import annotations

from stillray_training.simulate.effects.base import Dimension, Effect
from stillray_training.simulate.node import Node
from stillray_training.simulate.world import World


class DepthOfField(Effect):
    """A thin lens in place of the pinhole.

    A point at distance z spreads over a circle of diameter ``2 a f |1/z - 1/d|`` pixels, with the
    aperture radius a, the focus distance d and the focal length f in pixels (Potmesil and
    Chakravarty 1981, thin lens).
    """

    name = "depth_of_field"
    summary = "a thin lens: what lies out of focus spreads over a circle"

    def sensor(self, world: World, node: Node) -> Node:
        # both are set anew for every camera
        params = {**node.params, "aperture_radius": 0.01, "focus_distance": 1.0}
        return Node(plugin="thinlens", asked_by=self.name, params=params)

    def dimensions(self, world: World) -> tuple[Dimension, ...]:
        return (Dimension(name="lens position", size=2, asked_by=self.name),)

"""Lights with an extent."""

from __future__ import annotations

from stillray_training.simulate.effects.base import Effect
from stillray_training.simulate.node import Node, rgb
from stillray_training.simulate.world import Lamp, World


class SoftShadow(Effect):
    """Area emitters: lamps and windows shine from their whole surface."""

    name = "soft_shadow"
    summary = "lamps, panels and screens shine from their whole surface, so shadows have penumbrae"

    def missing(self, world: World) -> str | None:
        return None if world.lamps else "a lamp"

    def emitter(self, lamp: Lamp, node: Node) -> Node | None:
        return Node(plugin="area", asked_by=self.name, params={"radiance": rgb(lamp.radiance)})

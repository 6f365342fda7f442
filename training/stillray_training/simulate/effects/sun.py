"""Direct sunlight."""

from __future__ import annotations

from stillray_training.simulate.effects.base import Effect
from stillray_training.simulate.node import Node, rgb
from stillray_training.simulate.world import World


class SunLight(Effect):
    """Parallel light. differs: the real sun's disc is half a degree wide, this one is a point."""

    name = "sun"
    summary = "parallel light: sun patches through windows, hard shadows outdoors"

    def missing(self, world: World) -> str | None:
        return None if world.sun else "a sun"

    def lights(self, world: World) -> dict[str, Node]:
        assert world.sun is not None
        params = {
            "direction": [float(v) for v in world.sun.direction],
            "irradiance": rgb(world.sun.irradiance),
        }
        return {"sun": Node(plugin="directional", asked_by=self.name, params=params)}

"""Light from infinity: a sky, an overcast day, a studio."""

from __future__ import annotations

import numpy as np

from stillray_training.simulate.effects.base import Effect
from stillray_training.simulate.node import Node
from stillray_training.simulate.textures import sky
from stillray_training.simulate.world import Lamp, Sky, World


class Environment(Effect):
    """An environment map, importance-sampled."""

    name = "environment"
    summary = "light from infinity all around: sky, clouds, dusk, studio"

    def missing(self, world: World) -> str | None:
        return None if world.sky else "a sky"

    def emitter(self, lamp: Lamp, node: Node) -> Node | None:
        # the panel that stands in for the sky would hide it
        return None if lamp.window else node

    def lights(self, world: World) -> dict[str, Node]:
        assert world.sky is not None
        params = {"bitmap": environment_map(world.sky)}
        return {"environment": Node(plugin="envmap", asked_by=self.name, params=params)}


def environment_map(description: Sky, height: int = 128) -> np.ndarray:
    """``(height, 2 height, 3)`` radiance in Mitsuba's layout: +y up, -z in the middle column.

    Where the sky can be seen only through windows on one side, the other side is black: it
    lights nothing, and emitter sampling would waste itself on it.
    """
    image = sky(description.kind, np.random.default_rng(description.seed), height)
    image = image * np.float32(description.radiance)
    if description.facing is not None:
        # Mitsuba 3, envmap.cpp: u = atan2(x, -z) / 2 pi, v = acos(y) / pi
        row, column = np.mgrid[0:height, 0 : 2 * height] + 0.5
        phi, theta = column / height * np.pi, row / height * np.pi
        toward = np.stack(
            [np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)], -1
        )
        seen = toward @ np.asarray(description.facing) > -0.05
        image = image * seen[..., None]
    return np.asarray(image, np.float32)

"""Participating media."""

from __future__ import annotations

from stillray_training.simulate.effects.base import Dimension, Effect
from stillray_training.simulate.node import Node, rgb
from stillray_training.simulate.world import World


class Medium(Effect):
    """A homogeneous medium around everything: haze, smoke, light shafts.

    Transmittance over a distance s is ``exp(-extinction s)`` (Beer and Lambert).
    """

    name = "medium"
    summary = "haze or smoke that absorbs and scatters; needs the volumetric integrator"
    volumetric = True
    extra_depth = 8  # scattering in the medium counts as a bounce

    def missing(self, world: World) -> str | None:
        return None if world.fog else "a fog"

    def medium(self, world: World) -> Node | None:
        assert world.fog is not None
        phase = Node(plugin="isotropic", asked_by=self.name)
        if world.fog.asymmetry:
            phase = Node(plugin="hg", asked_by=self.name, params={"g": world.fog.asymmetry})
        params = {
            "sigma_t": world.fog.extinction,
            "albedo": rgb(world.fog.albedo),
            "phase": phase,
        }
        return Node(plugin="homogeneous", asked_by=self.name, params=params)

    def dimensions(self, world: World) -> tuple[Dimension, ...]:
        return (
            Dimension(name="colour channel", size=1, asked_by=self.name),
            Dimension(name="free flight", size=1, asked_by=self.name, per="bounce"),
            Dimension(name="phase function", size=3, asked_by=self.name, per="bounce"),
        )

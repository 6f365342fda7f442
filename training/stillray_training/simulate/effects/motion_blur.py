"""Motion blur."""

from __future__ import annotations

from stillray_training.simulate.effects.base import Dimension, Effect
from stillray_training.simulate.world import World


class MotionBlur(Effect):
    """Each sample sees camera and objects at its own time while the shutter is open.

    Mitsuba 3 has no animated transforms, so the frame is a sum of poses. A noisy frame has 8
    strata of the shutter, one random time in each, and each sample falls into one of them at
    random; a reference gives each of its passes the time of a stratum. Every sample's time is
    uniform over the shutter, so the picture is unbiased; samples that share a stratum share a time.
    """

    name = "motion_blur"
    summary = "samples are spread over the time the shutter is open"

    def dimensions(self, world: World) -> tuple[Dimension, ...]:
        return (Dimension(name="shutter time", size=1, asked_by=self.name),)

    def shutter(self, world: World) -> float:
        return world.shutter

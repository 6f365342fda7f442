"""Things that move: objects, and lamps."""

from __future__ import annotations

from stillray_training.simulate.effects.base import Buffer, Effect
from stillray_training.simulate.world import Motion, World


class MovingObject(Effect):
    """Groups of pieces on rigid paths; motion vectors follow the point on the object."""

    name = "moving_object"
    summary = "objects that slide, roll, turn or bounce; motion vectors follow them"

    def missing(self, world: World) -> str | None:
        return None if world.moving else "an object that can move"

    def buffers(self, world: World) -> tuple[Buffer, ...]:
        return (Buffer(name="object index", channels=1, asked_by=self.name),)

    def motions(self, world: World) -> dict[str, Motion]:
        return dict(world.moving)


class MovingLight(Effect):
    """Lamps, and what they hang on, on rigid paths."""

    name = "moving_light"
    summary = "lamps that swing or are carried; shadows and highlights move with them"

    def missing(self, world: World) -> str | None:
        return None if world.swinging else "a lamp that can move"

    def buffers(self, world: World) -> tuple[Buffer, ...]:
        return (Buffer(name="object index", channels=1, asked_by=self.name),)

    def motions(self, world: World) -> dict[str, Motion]:
        return dict(world.swinging)

"""Procedural scenes by name: everything in a scene follows from its seed."""

from __future__ import annotations

from collections.abc import Callable

from stillray_training.simulate.generators.corridor import corridor
from stillray_training.simulate.generators.court import court
from stillray_training.simulate.generators.room import room
from stillray_training.simulate.generators.tabletop import tabletop
from stillray_training.simulate.world import World

GENERATORS: dict[str, Callable[[int], World]] = {
    "room": room,
    "corridor": corridor,
    "court": court,
    "tabletop": tabletop,
}


def generate(name: str, seed: int) -> World:
    """The world of a generator for a seed of 0 or more."""
    return GENERATORS[name](seed)

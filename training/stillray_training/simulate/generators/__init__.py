"""Procedural scenes by name: everything in a scene follows from its seed and the assets given."""

from __future__ import annotations

from collections.abc import Callable

from stillray_training.simulate.assets import Library
from stillray_training.simulate.generators.corridor import corridor
from stillray_training.simulate.generators.court import court
from stillray_training.simulate.generators.desk import desk
from stillray_training.simulate.generators.interior import interior
from stillray_training.simulate.generators.room import room
from stillray_training.simulate.generators.shadows import shadows
from stillray_training.simulate.generators.tabletop import tabletop
from stillray_training.simulate.generators.terrace import terrace
from stillray_training.simulate.world import World

_PROCEDURAL: dict[str, Callable[[int], World]] = {
    "room": room,
    "corridor": corridor,
    "court": court,
    "tabletop": tabletop,
}
_FURNISHED: dict[str, Callable[[int, Library | None], World]] = {
    "interior": interior,
    "desk": desk,
    "shadows": shadows,
    "terrace": terrace,
}
GENERATORS = (*_PROCEDURAL, *_FURNISHED)


def generate(name: str, seed: int, library: Library | None = None) -> World:
    """The world of a generator for a seed of 0 or more; some place objects of a library."""
    if name in _FURNISHED:
        return _FURNISHED[name](seed, library)
    return _PROCEDURAL[name](seed)

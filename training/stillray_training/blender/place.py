"""What a generator of scenes has built so far."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

from stillray_training.blender import licensed
from stillray_training.blender.parts import Point


@dataclass
class Place:
    """What a generator has built."""

    drawn: Random
    assets: Path | None = None
    things: list[Any] = field(default_factory=list)  # that may move
    lamps: list[Any] = field(default_factory=list)
    used: set[str] = field(default_factory=set)  # assets

    def asset(self, at: Point, size: float | None = None, kinds: str = "") -> bool:
        """Stand an asset somewhere, if there are any; of those whose names `kinds` lists."""
        if self.assets is None:
            return False
        known = [n for n in licensed.names(self.assets) if not kinds or n in kinds.split()]
        name = self.drawn.choice(known)
        self.things.append(licensed.place(self.assets, name, at, self.drawn, size))
        self.used.add(name)
        return True

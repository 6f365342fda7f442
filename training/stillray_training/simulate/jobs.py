"""A job: one scene, opened once, and the sequences rendered in it. Idempotent: what is finished
is not rendered again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from stillray.errors import InputError
from stillray_training.simulate.effects import EFFECTS, check_names
from stillray_training.simulate.generators import GENERATORS
from stillray_training.simulate.plan import Plan, make_plan
from stillray_training.simulate.sequence import (
    SequenceOptions,
    is_complete,
    open_world,
    render_sequence,
)
from stillray_training.simulate.stage import Stage
from stillray_training.simulate.world import World

_VIEWS = 64  # sequence seeds of one scene seed lie together


@dataclass(frozen=True, kw_only=True)
class Job:
    """What to render in one scene."""

    scene: str  # a generator's name or the path of an XML file
    seed: int = 0  # 0 or more; an XML file has one likeness, its seed draws cameras and lights
    views: int = 1  # sequences, each from another camera, 1 to 64
    effects: tuple[str, ...] | None = None  # exactly these; None: what the scene calls for
    also: tuple[str, ...] = ()  # on top of those, where the scene can show them
    without: tuple[str, ...] = ()  # left out of those
    options: SequenceOptions = field(default_factory=SequenceOptions)

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise InputError(f"seed must be 0 or more, got {self.seed}")
        if not 1 <= self.views <= _VIEWS:
            raise InputError(f"views must be 1 to {_VIEWS}, got {self.views}")
        check_names((*(self.effects or ()), *self.also, *self.without))

    @property
    def label(self) -> str:
        """The scene's name in folders and credits."""
        return self.scene if self.scene in GENERATORS else Path(self.scene).resolve().parent.name

    def folders(self, root: Path) -> list[Path]:
        """The folders of its sequences."""
        return [root / f"{self.label}-{self.seed:04d}-{view}" for view in range(self.views)]

    def missing(self, root: Path) -> Iterator[tuple[int, Path]]:
        """Views that are not finished, and their folders."""
        for view, folder in enumerate(self.folders(root)):
            if not is_complete(folder):
                yield view, folder

    def plan(self, mi: Any) -> Plan:
        """Open the scene and decide what is simulated in it."""
        world = open_world(mi, self.scene, self.seed, self.options.assets)
        return make_plan(world, self.asks(world), self.options.wants())

    def asks(self, world: World) -> tuple[str, ...]:
        """The effects it asks for in its world."""
        names = world.effects if self.effects is None else self.effects
        can = [n for n in self.also if n in names or EFFECTS[n].missing(world) is None]
        return check_names(name for name in (*names, *can) if name not in self.without)


def run_job(
    mi: Any, job: Job, root: Path, *, on_frame: Callable[[], None] = lambda: None
) -> list[str]:
    """Render what is missing of a job.

    Returns
    -------
    list of str
        Names of the folders rendered now.

    Raises
    ------
    InputError
        The scene cannot be opened, or has no place for the camera.
    """
    todo = list(job.missing(root))
    if not todo:
        return []
    stage = Stage(mi, job.plan(mi), job.options.height, job.options.width)
    for view, folder in todo:
        options = replace(job.options, seed=job.seed * _VIEWS + view)
        render_sequence(stage, folder, options, on_frame=on_frame)
    return [folder.name for _, folder in todo]

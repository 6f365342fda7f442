"""Recipes: TOML files that say how many sequences of which scenes with which effects.

::

    [options]                # of SequenceOptions, for all entries
    frames = 8
    reference_spp = 256

    [[sequences]]
    scene = "room"           # a generator or an XML file, relative to the recipe
    count = 60               # scene seeds, from first_seed on
    first_seed = 0
    views = 2                # sequences in each
    also = ["medium"]        # effects on top of those that the scene calls for
    without = ["motion_blur"]  # those that are left out of these
    # effects = ["texture"]  # exactly these instead
    # options = { spp = 4 }
"""

from __future__ import annotations

import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any

from stillray.errors import InputError
from stillray_training.simulate.generators import GENERATORS
from stillray_training.simulate.jobs import Job
from stillray_training.simulate.sequence import SequenceOptions

_BUNDLED = Path(__file__).parent / "recipes"
_ENTRY = {"scene", "count", "first_seed", "views", "effects", "also", "without", "options"}


def read_recipe(path: Path) -> list[Job]:
    """The jobs of a recipe, seed by seed through all entries: a run that is stopped early still
    holds every kind of scene.

    Parameters
    ----------
    path
        A TOML file, or the name of one that comes with stillray: ``counts.toml``.

    Raises
    ------
    InputError
        The file is missing, not TOML, or holds an unknown key or a value against its rule.
    """
    bundled = _BUNDLED / path
    if path.name == str(path) and not path.exists() and bundled.is_file():
        path = bundled
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"recipe must be a readable TOML file, got {path}: {error.strerror}"
        ) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"recipe must be TOML, got {path}: {error}") from None
    _no_others(content, {"options", "sequences"}, str(path))
    entries = content.get("sequences", [])
    if not entries:
        raise InputError(f"{path}: must hold [[sequences]], it has none")
    rounds: list[list[Job]] = []
    for number, entry in enumerate(entries, start=1):
        where = f"{path}: sequences {number}"
        _no_others(entry, _ENTRY, where)
        if "scene" not in entry:
            raise InputError(f"{where}: must name a scene")
        scene = str(entry["scene"])
        if scene not in GENERATORS:
            scene = str((path.parent / scene).resolve())
        options = {**content.get("options", {}), **entry.get("options", {})}
        for index in range(_whole(entry, "count", 1, where)):
            job = Job(
                scene=scene,
                seed=_whole(entry, "first_seed", 0, where) + index,
                views=_whole(entry, "views", 1, where),
                effects=tuple(entry["effects"]) if "effects" in entry else None,
                also=tuple(entry.get("also", ())),
                without=tuple(entry.get("without", ())),
                options=_options(options, where),
            )
            while len(rounds) <= index:
                rounds.append([])
            rounds[index].append(job)
    jobs = [job for one in rounds for job in one]
    names = [name.name for job in jobs for name in job.folders(Path())]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(f"{path}: first_seed must keep entries apart, twice: {twice[0]}")
    return jobs


def _options(values: dict[str, Any], where: str) -> SequenceOptions:
    _no_others(values, {field.name for field in fields(SequenceOptions)} - {"seed"}, where)
    tuples: dict[str, Any] = {
        name: tuple(v) if isinstance(v, list) else v for name, v in values.items()
    }
    try:
        return SequenceOptions(**tuples)
    except TypeError as error:
        raise InputError(f"{where}: options: {error}") from None


def _whole(entry: dict[str, Any], name: str, default: int, where: str) -> int:
    value = entry.get(name, default)
    least = 0 if name == "first_seed" else 1
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        raise InputError(
            f"{where}: {name} must be a whole number of {least} or more, got {value!r}"
        )
    return value


def _no_others(table: dict[str, Any], known: set[str], where: str) -> None:
    if unknown := sorted(set(table) - known):
        raise InputError(f"{where}: keys must be of {', '.join(sorted(known))}, got {unknown[0]}")

"""``python -m stillray.training.simulate``: render training and demo sequences.

Examples
--------
One procedural sequence::

    python -m stillray.training.simulate data/rooms --scene room --count 1

The training set of the bundled models::

    python -m stillray.training.simulate data/train --scene room --count 60 --views 3
    python -m stillray.training.simulate data/train --scene scenes/tire/scene.xml --count 10
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import track

from stillray.cli import program
from stillray.training.simulate.sequence import (
    ROOM,
    SequenceOptions,
    is_complete,
    open_scene,
    render_sequence,
)
from stillray.training.simulate.variant import load_mitsuba

_DEFAULT = SequenceOptions()


def simulate(
    folder: Annotated[Path, typer.Argument(help="Where the sequence folders go.")],
    scene: Annotated[list[str], typer.Option(help="'room' or a Mitsuba XML file; repeatable.")],
    count: Annotated[int, typer.Option(help="How often each scene is opened, a seed each.")] = 1,
    views: Annotated[int, typer.Option(help="Sequences each time, from other cameras.")] = 1,
    first_seed: Annotated[int, typer.Option(help="Seed of the first sequence.")] = 0,
    frames: int = _DEFAULT.frames,
    height: int = _DEFAULT.height,
    width: int = _DEFAULT.width,
    spp: int = _DEFAULT.spp,
    reference_spp: int = _DEFAULT.reference_spp,
    references: int = _DEFAULT.references,
    speed: float = _DEFAULT.speed,
    max_depth: int = _DEFAULT.max_depth,
    variant: Annotated[str | None, typer.Option(help="Mitsuba variant; default: chosen.")] = None,
) -> None:
    """Render noisy 1-spp sequences, their features and references; resumes after a kill."""
    mi, why = load_mitsuba(variant)
    mi.set_log_level(mi.LogLevel.Error)
    print(why, file=sys.stderr)
    options = SequenceOptions(
        frames=frames,
        height=height,
        width=width,
        spp=spp,
        reference_spp=reference_spp,
        references=references,
        max_depth=max_depth,
        speed=speed,
    )
    # seed by seed through all scenes: a run that is stopped early still holds every scene
    jobs = [(name, first_seed + index) for index in range(count) for name in scene]
    for name, seed in track(jobs, "scenes", console=Console(stderr=True)):
        label = ROOM if name == ROOM else Path(name).resolve().parent.name
        folders = {
            view: folder / f"{label}-{seed:04d}-{view}"
            for view in range(views)
            if not is_complete(folder / f"{label}-{seed:04d}-{view}")
        }
        if not folders:
            continue
        source = open_scene(mi, name, seed, height, width)
        for view, target in folders.items():
            render_sequence(mi, source, target, replace(options, seed=seed * 64 + view))


if __name__ == "__main__":
    program.run(simulate)

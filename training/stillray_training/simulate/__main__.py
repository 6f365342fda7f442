"""``stillray-simulate``: render training sequences.

Examples
--------
One procedural scene, with what it calls for, and what that is::

    stillray-simulate --scene room --seed 7 --explain
    stillray-simulate data/rooms --scene room --seed 7

Exactly these effects in a file of one's own::

    stillray-simulate data/mine --scene kitchen/scene.xml \\
        --effects depth_of_field,medium

A whole training set, on all cores or on a Dask scheduler::

    stillray-simulate data/train --recipe train.toml
    stillray-simulate data/train --recipe ... --scheduler tcp://host:8786
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from stillray.cli import program
from stillray.errors import InputError
from stillray_training.simulate.effects import EFFECTS, check_names
from stillray_training.simulate.explain import explain as explain_plan
from stillray_training.simulate.farm import default_workers, run_farm, run_here
from stillray_training.simulate.generators import GENERATORS
from stillray_training.simulate.jobs import Job
from stillray_training.simulate.recipe import read_recipe
from stillray_training.simulate.report import write_report
from stillray_training.simulate.sequence import SequenceOptions, open_world
from stillray_training.simulate.variant import load_mitsuba

_DEFAULT = SequenceOptions()
_OWN = "own"  # the effects that a scene itself calls for


def simulate(
    folder: Annotated[Path | None, typer.Argument(help="Where the sequence folders go.")] = None,
    scene: Annotated[
        list[str] | None,
        typer.Option(help=f"{', '.join(GENERATORS)}, or a Mitsuba XML file; repeatable."),
    ] = None,
    recipe: Annotated[
        Path | None, typer.Option(help="A TOML file of many scenes, or a bundled one's name.")
    ] = None,
    assets: Annotated[
        Path | None, typer.Option(help="Folder of objects for interior, desk, shadows, terrace.")
    ] = None,
    effects: Annotated[
        str,
        typer.Option(help=f"'own': what the scene calls for; 'none'; or of {','.join(EFFECTS)}."),
    ] = _OWN,
    count: Annotated[int, typer.Option(help="How many seeds of each scene.")] = 1,
    views: Annotated[int, typer.Option(help="Sequences each time, from other cameras.")] = 1,
    seed: Annotated[
        int, typer.Option("--seed", "--first-seed", help="Seed of the first scene.")
    ] = 0,
    frames: int = _DEFAULT.frames,
    first: Annotated[int, typer.Option(help="Frames before it are left out.")] = _DEFAULT.first,
    height: int = _DEFAULT.height,
    width: int = _DEFAULT.width,
    spp: Annotated[int, typer.Option(help="Samples a pixel of the noisy frames.")] = _DEFAULT.spp,
    reference_spp: int = _DEFAULT.reference_spp,
    references: Annotated[
        int, typer.Option(help="How many of the last frames have a reference.")
    ] = _DEFAULT.references,
    depth: Annotated[
        int | None, typer.Option(help="Path vertices; default: what the effects ask for.")
    ] = None,
    reference_scale: Annotated[int, typer.Option(help="1 or 2.")] = _DEFAULT.reference_scale,
    move: Annotated[str | None, typer.Option(help="still, dolly, orbit or handheld.")] = None,
    speed: Annotated[
        float, typer.Option(help="Camera move a frame, part of the distance looked at.")
    ] = _DEFAULT.speed,
    origin: Annotated[
        tuple[float, float, float] | None, typer.Option(help="Camera place, metres.")
    ] = None,
    target: Annotated[
        tuple[float, float, float] | None, typer.Option(help="What it looks at, metres.")
    ] = None,
    fov: Annotated[float, typer.Option(help="Horizontal, degrees; with --origin.")] = _DEFAULT.fov,
    cameras: Annotated[
        Path | None, typer.Option(help="JSON with a camera a frame, such as a sequence.json.")
    ] = None,
    second_color: Annotated[bool, typer.Option(help="An independent second colour.")] = False,
    guides: Annotated[str, typer.Option(help="roughness,specular_albedo")] = "",
    jitter: Annotated[bool, typer.Option(help="Sub-pixel offset of each frame.")] = False,
    spread: Annotated[
        float, typer.Option(help="Part of their pixel that samples of frames fill; 0: its centre.")
    ] = _DEFAULT.spread,
    reference_features: Annotated[
        int, typer.Option(help="Samples of albedo and normal in references; 0: none.")
    ] = _DEFAULT.reference_features,
    variant: Annotated[str | None, typer.Option(help="Mitsuba variant; default: chosen.")] = None,
    workers: Annotated[
        int | None, typer.Option(help="Local processes; default: as cores and memory allow.")
    ] = None,
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask scheduler.")] = None,
    explain: Annotated[bool, typer.Option(help="Say what would be simulated; no render.")] = False,
    report: Annotated[bool, typer.Option(help="Write report.html and contact.png after.")] = False,
) -> None:
    """Render noisy sequences, their features and references; resumes after a kill."""
    if (recipe is None) == (not scene):
        raise InputError(
            "one of scene and recipe must be given, got " + ("both" if scene else "none")
        )
    if workers is not None and workers < 1:
        raise InputError(f"workers must be 1 or more, got {workers}")
    if count < 1:
        raise InputError(f"count must be 1 or more, got {count}")
    if recipe is not None:
        jobs = read_recipe(recipe)
        if assets is not None:
            jobs = [replace(job, options=replace(job.options, assets=str(assets))) for job in jobs]
    else:
        options = SequenceOptions(
            frames=frames, first=first, height=height, width=width, spp=spp,
            reference_spp=reference_spp, references=references, depth=depth,
            reference_scale=reference_scale, move=move, speed=speed, origin=origin, target=target,
            fov=fov, cameras=str(cameras) if cameras else None, second_color=second_color,
            guides=_list(guides), jitter=jitter, spread=spread,
            reference_features=reference_features, assets=str(assets) if assets else None,
        )  # fmt: skip
        # seed by seed through all scenes: a run that is stopped early still holds every scene
        jobs = [
            Job(
                scene=name,
                seed=seed + index,
                views=views,
                effects=_effects(effects),
                options=options,
            )
            for index in range(count)
            for name in scene or ()
        ]
    if explain:
        _explain(jobs, variant)
        return
    if folder is None:
        raise InputError("folder must be given, got none (only --explain goes without)")
    _check(jobs, variant)
    folder.mkdir(parents=True, exist_ok=True)
    todo = [job for job in jobs if any(job.missing(folder))]
    failures = _run(todo, folder, variant, workers, scheduler)
    if report:
        write_report(folder)
    for name, reason in failures.items():
        print(f"not rendered: {name}: {reason}", file=sys.stderr)
    if failures:
        sys.exit(program.complain(f"{len(failures)} of {len(jobs)} scenes failed", program.FAILED))


def _run(
    jobs: list[Job], folder: Path, variant: str | None, workers: int | None, scheduler: str | None
) -> dict[str, str]:
    if not jobs:
        return {}
    count = workers or default_workers(len(jobs))
    here = scheduler is None and count == 1
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    )  # fmt: skip
    with Progress(*columns, console=Console(stderr=True)) as progress:
        if here:
            total = sum(
                len(list(job.missing(folder))) * (job.options.frames - job.options.first)
                for job in jobs
            )
            bar = progress.add_task("frames", total=total)
            return run_here(jobs, folder, variant, lambda job: progress.advance(bar))
        bar = progress.add_task("scenes", total=len(jobs))
        return run_farm(
            jobs, folder, variant, lambda job: progress.advance(bar),
            workers=count, scheduler=scheduler,
        )  # fmt: skip


def _check(jobs: list[Job], variant: str | None) -> None:
    """Say which variant runs; complain about the first scene before anything is written."""
    mi, why = load_mitsuba(variant)
    print(why, file=sys.stderr)
    for name in dict.fromkeys(job.scene for job in jobs):
        next(job for job in jobs if job.scene == name).plan(mi)


def _explain(jobs: list[Job], variant: str | None) -> None:
    mi, why = load_mitsuba(variant)
    console = Console(soft_wrap=True)
    console.print(why)
    if len(jobs) == 1:
        console.print(explain_plan(jobs[0].plan(mi)))
        return
    counts: Counter[str] = Counter()
    for job in jobs:
        world = open_world(mi, job.scene, job.seed, job.options.assets)
        counts.update({name: job.views for name in job.asks(world)})
    total = sum(job.views for job in jobs)
    console.print(f"{total} sequences of {len(jobs)} scenes; sequences per effect:")
    for name in EFFECTS:
        console.print(f"  {name:16s}{counts[name]:6d}")


def _effects(text: str) -> tuple[str, ...] | None:
    if text == _OWN:
        return None
    return () if text == "none" else check_names(_list(text))


def _list(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


if __name__ == "__main__":
    program.run(simulate)

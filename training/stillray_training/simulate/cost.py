"""What each effect costs: ``python -m stillray_training.simulate.cost``.

For each effect a frame with it and one without, in turn in the same process, and the ratio of
their times: the time of the first frame (loading and compiling) is shown apart.
"""

from __future__ import annotations

import statistics
import sys
import time
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from stillray.cli import program
from stillray.errors import InputError
from stillray_training.simulate.buffers import Moment, render_noisy
from stillray_training.simulate.effects import EFFECTS
from stillray_training.simulate.jobs import Job
from stillray_training.simulate.plan import make_plan
from stillray_training.simulate.sequence import SequenceOptions, open_world
from stillray_training.simulate.stage import Stage
from stillray_training.simulate.variant import load_mitsuba
from stillray_training.simulate.viewpoint import find_path
from stillray_training.simulate.world import World


@dataclass(frozen=True, kw_only=True)
class Cost:
    """Times of one effect in seconds a frame, medians."""

    effect: str
    without: float
    with_it: float
    ratio: float  # median over rounds of with / without in the same round
    first: float  # seconds until the first frame with it: load, compile, render


def main(
    scene: Annotated[str, typer.Option(help="A generator or an XML file.")] = "tabletop",
    seed: int = 2,
    size: Annotated[int, typer.Option(help="Pixels a side.")] = 128,
    spp: int = 8,
    rounds: Annotated[int, typer.Option(help="Frames of each kind.")] = 5,
    variant: Annotated[str | None, typer.Option(help="Mitsuba variant; default: chosen.")] = None,
) -> None:
    """Print the cost of each effect on one scene: without, with, ratio, samples a second."""
    if rounds < 1:
        raise InputError(f"rounds must be 1 or more, got {rounds}")
    options = SequenceOptions(height=size, width=size, spp=spp, seed=seed)
    Job(scene=scene, seed=seed, options=options)  # checks them
    mi, why = load_mitsuba(variant)
    print(why, file=sys.stderr)
    world = open_world(mi, scene, seed)
    table = Table(box=None, header_style="bold", title=f"{scene} {seed}, {size}x{size}, {spp} spp")
    for name in ("effect", "without ms", "with ms", "ratio", "Msamples/s with", "first frame s"):
        table.add_column(name, justify="left" if name == "effect" else "right")
    for name, effect in EFFECTS.items():
        if lack := effect.missing(world):
            table.add_row(name, "", "", "", "", f"needs {lack}")
            continue
        cost = measure(mi, world, name, options, rounds)
        table.add_row(
            name, f"{1e3 * cost.without:.0f}", f"{1e3 * cost.with_it:.0f}", f"{cost.ratio:.2f}",
            f"{size * size * spp / cost.with_it / 1e6:.3f}", f"{cost.first:.1f}",
        )  # fmt: skip
    Console().print(table)


def measure(mi: Any, world: World, name: str, options: SequenceOptions, rounds: int) -> Cost:
    """Time frames with and without one effect, in turn.

    Both scenes have the light they need beside it: lamps as points, nothing else that the effect
    does not bring. Camera and samples are the same.
    """
    start = time.perf_counter()
    with_it = Stage(mi, make_plan(world, (name,)), options.height, options.width)
    path, distance = find_path(
        with_it, np.random.default_rng(options.seed), frames=2, move="dolly", speed=0.005
    )
    moment = Moment(frame=0, path=path, focus=distance, jitter=np.zeros(2))
    render_noisy(with_it, moment, spp=options.spp, seed=0)
    first = time.perf_counter() - start
    without = Stage(mi, make_plan(world, ()), options.height, options.width)
    render_noisy(without, moment, spp=options.spp, seed=0)
    times: list[tuple[float, float]] = []
    for index in range(1, rounds + 1):
        # a new frame each time, so that what moves is moved
        moment = Moment(frame=index, path=path, focus=distance, jitter=np.zeros(2))
        pair = []
        for stage in (without, with_it):
            start = time.perf_counter()
            render_noisy(stage, moment, spp=options.spp, seed=index)
            pair.append(time.perf_counter() - start)
        times.append((pair[0], pair[1]))
    return Cost(
        effect=name,
        without=statistics.median(a for a, _ in times),
        with_it=statistics.median(b for _, b in times),
        ratio=statistics.median(b / a for a, b in times),
        first=first,
    )


if __name__ == "__main__":
    program.run(main)

"""``stillray tradeoff``: what a millisecond buys, beside what else could be run.

The one doorway from the installed program to the evaluation: nothing that denoises goes through it.
"""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stillray.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from stillray_training.tradeoff import Tradeoff


def tradeoff(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="Folder of sequences: <scene>/frame_*.exr and ref_*.exr."
        ),
    ],
    model: Annotated[
        list[str] | None,
        typer.Option("--model", "-m", help="Model; repeatable; all unless given."),
    ] = None,
    peer: Annotated[
        list[str] | None,
        typer.Option(help="Peer by name; repeatable; all that are installed unless given."),
    ] = None,
    peers: Annotated[bool, typer.Option(help="Run peers at all.")] = True,
    plot: Annotated[Path | None, typer.Option(help="Draw into this PNG file.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Show quality against time for every model, option and peer."""
    _require_evaluation()
    from rich.console import Console
    from rich.progress import track

    from stillray.cli.output import console
    from stillray.models.registry import list_models
    from stillray.profiling.machine import describe
    from stillray.profiling.plot import require_drawable
    from stillray_training.evaluate.methods import choose_peers, left_out
    from stillray_training.pareto import advice
    from stillray_training.tradeoff import measure, model_options, peer_options

    if plot is not None:
        require_drawable(plot)
    named = peer if peers else []
    options = [
        option
        for name in model or [info.name for info in list_models()]
        for option in model_options(name)
    ] + peer_options(choose_peers(named))
    if line := left_out(named):
        print(line, file=sys.stderr)
    found = measure(
        folder,
        options,
        progress=lambda scenes: track(scenes, "scenes", console=Console(stderr=True)),
    )
    if plot is not None:
        from stillray_training.tradeoff_plot import draw_tradeoff

        draw_tradeoff(found, plot)
    if as_json:
        print(found.to_json())
        return
    out = console()
    machine = describe()
    out.print(f"{machine['processor']}, {machine['threads']} threads")
    out.print(_table(found))
    out.print()
    for metric in found.measured():
        out.print(advice(found.methods, metric))


def _require_evaluation() -> None:
    if find_spec("skimage") is None or find_spec("stillray_training") is None:
        raise InputError("tradeoff needs the evaluation: pip install 'stillray[compare]'")


def _table(found: Tradeoff) -> Table:
    from rich.table import Table

    from stillray_training.pareto import pareto_front
    from stillray_training.tradeoff import NOISY

    measured = found.measured()
    fronts = {metric.name: pareto_front(found.methods, metric) for metric in measured}
    height, width = found.size
    table = Table(
        title=f"{width} x {height}, mean of {found.scenes} sequences; "
        "* no other method is as fast and better",
        title_justify="left",
        box=None,
        pad_edge=False,
    )
    table.add_column("method")
    for heading in ("ms", *(metric.title for metric in measured)):
        table.add_column(heading, justify="right")
    for method in sorted(found.methods, key=lambda one: one.milliseconds):
        table.add_row(
            f"{method.label} (peer)" if method.label in found.peers else method.label,
            f"{method.milliseconds:.0f}",
            *(
                format(method.scores[m.name], m.format) + ("*" if method in fronts[m.name] else " ")
                for m in measured
            ),
        )
    table.add_row(NOISY, "", *(format(found.noisy[m.name], m.format) + " " for m in measured))
    return table

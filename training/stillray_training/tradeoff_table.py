"""``stillray tradeoff``: what a millisecond buys, beside what else could be run.

The installed program finds this by the entry point ``tradeoff`` of the group
``stillray.commands``.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import track
from rich.table import Table

from stillray.cli.output import console
from stillray.models.registry import list_models
from stillray.profiling.machine import describe
from stillray.profiling.plot import require_drawable
from stillray_training.evaluate.methods import choose_peers, left_out
from stillray_training.pareto import advice, pareto_front
from stillray_training.tradeoff import NOISY, Tradeoff, measure, model_options, peer_options


def show(
    folder: Path,
    *,
    models: Sequence[str],
    peers: Sequence[str] | None,
    plot: Path | None,
    as_json: bool,
) -> None:
    """Measure and print, as `stillray tradeoff` does.

    Parameters
    ----------
    folder
        Of sequences with references.
    models
        Names; all for none.
    peers
        Names; None for all that are installed.
    plot
        PNG file to draw into.
    as_json
        Print JSON and no table.

    Raises
    ------
    InputError
        A model, a peer or the folder cannot be used.
    """
    if plot is not None:
        require_drawable(plot)
    options = [
        option
        for name in models or [info.name for info in list_models()]
        for option in model_options(name)
    ] + peer_options(choose_peers(peers))
    found = measure(
        folder,
        options,
        progress=lambda scenes: track(scenes, "scenes", console=Console(stderr=True)),
    )
    if line := left_out(peers):
        print(line, file=sys.stderr)
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


def _table(found: Tradeoff) -> Table:
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

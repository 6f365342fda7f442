"""``stillray tradeoff``: what a millisecond buys, beside what else could be run.

Training, if it is installed, offers the command's work as an entry point of `GROUP`; the runtime
imports nothing of it.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from stillray.errors import InputError

#: Entry points of the commands whose work another package does.
GROUP = "stillray.commands"


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
    show = _evaluation()
    named = peer if peers else []
    show(folder, models=model or [], peers=named, plot=plot, as_json=as_json)


def _evaluation() -> Callable[..., None]:
    from importlib.metadata import entry_points

    offered = entry_points(group=GROUP, name="tradeoff")
    # the metrics are of this library
    if not offered or find_spec("skimage") is None:
        raise InputError("tradeoff needs the evaluation: pip install 'stillray[compare]'")
    show: Callable[..., None] = next(iter(offered)).load()
    return show

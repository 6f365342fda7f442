"""``stillray profile``: what every stage of a frame costs on this machine."""

from __future__ import annotations

import itertools
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stillray.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from stillray.profiling.measure import Setting

_SIZE = re.compile(r"(\d+)[x×](\d+)")
_MOST_SIDE = 1 << 15  # pixels; OpenCV addresses no more


def profile(
    source: Annotated[
        str | None,
        typer.Argument(
            metavar="[INPUT]",
            help="An EXR file, or a sequence as 'shot.####.exr'; frames are made up without.",
        ),
    ] = None,
    model: Annotated[
        list[str] | None,
        typer.Option(
            "--model",
            "-m",
            help="Model, .onnx file, also of a frame graph, or 'all'; repeatable; those of the "
            "qualities unless given.",
        ),
    ] = None,
    size: Annotated[
        list[str] | None,
        typer.Option(help="WIDTHxHEIGHT that frames are tiled or cut to; repeatable."),
    ] = None,
    threads: Annotated[
        list[int] | None,
        typer.Option(help="Threads; repeatable; all available processors unless given."),
    ] = None,
    provider: Annotated[
        list[str] | None,
        typer.Option(help="ONNX Runtime execution provider; repeatable; the CPU unless given."),
    ] = None,
    ensemble: Annotated[
        list[int] | None,
        typer.Option(help="Pictures of a frame that are averaged; repeatable; 1 unless given."),
    ] = None,
    temporal: Annotated[
        bool, typer.Option("--temporal/--no-temporal", help="Accumulate over frames.")
    ] = True,
    scaling: Annotated[
        bool,
        typer.Option("--scaling", help="Time and memory against pixels, kernels and threads."),
    ] = False,
    seconds: Annotated[
        float, typer.Option(min=0, help="How long to measure; at least a few frames are run.")
    ] = 10,
    memory: Annotated[
        bool, typer.Option("--memory/--no-memory", help="Peak memory, in processes of their own.")
    ] = True,
    plot: Annotated[Path | None, typer.Option(help="Draw into this PNG file.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Show what every stage costs: milliseconds, memory, and the least that it could take."""
    if plot is not None:
        from stillray.profiling.plot import require_drawable

        require_drawable(plot)
    if scaling:
        if source is not None:
            raise InputError(f"--scaling makes its own frames up, got the input {source}")
        _scaling(model, size, threads, plot, as_json)
    else:
        settings = _settings(source, model, size, threads, provider, temporal)
        settings = _as_ensembles(settings, ensemble or [1])
        _profile(source, settings, seconds, memory, plot, as_json)


def _settings(
    source: str | None,
    models: Sequence[str] | None,
    sizes: Sequence[str] | None,
    threads: Sequence[int] | None,
    providers: Sequence[str] | None,
    temporal: bool,
) -> list[Setting]:
    from stillray.arrays.strips import available_threads
    from stillray.models.registry import list_models
    from stillray.pipeline.opening import engine_of_model, model_of
    from stillray.profiling.clip import DEFAULT_SIZE, open_clip
    from stillray.profiling.measure import Setting

    if models and "all" not in models:
        names, infos = list(models), [model_of(name) for name in models]
    else:  # all of them take minutes, which has to be asked for
        infos = [info for info in list_models() if models or info.aliases]
        names = [info.name for info in infos]
    for count in threads or ():
        if count < 1:
            raise InputError(f"threads must be 1 or more, got {count}")
    for provider in providers or ():  # an unknown one is refused before anything is measured
        engine_of_model(infos[0], 1, (provider,)).close()
    if sizes:
        shapes = [_parse_size(text) for text in sizes]
    else:
        shapes = [DEFAULT_SIZE if source is None else open_clip(source).shape]
    engines: Sequence[str | None] = providers or [None]
    return [
        Setting(
            model=name,
            height=height,
            width=width,
            threads=count,
            provider=provider,
            temporal=temporal,
        )
        for (height, width), name, count, provider in itertools.product(
            shapes, names, threads or [available_threads()], engines
        )
    ]


def _as_ensembles(settings: Sequence[Setting], sizes: Sequence[int]) -> list[Setting]:
    """Each setting with ensembles of every size."""
    from stillray.models.registry import with_overrides
    from stillray.pipeline.opening import model_of

    for name in dict.fromkeys(setting.model for setting in settings):
        for size in set(sizes) - {1}:
            with_overrides(model_of(name), ensemble=size)
    return [replace(setting, ensemble=size) for setting in settings for size in sizes]


def _parse_size(text: str) -> tuple[int, int]:
    match = _SIZE.fullmatch(text)
    if match is None or not all(1 <= int(side) <= _MOST_SIDE for side in match.groups()):
        raise InputError(f"size must be WIDTHxHEIGHT in pixels, 1 to {_MOST_SIDE} each, got {text}")
    return int(match[2]), int(match[1])


def _profile(
    source: str | None,
    settings: Sequence[Setting],
    seconds: float,
    memory: bool,
    plot: Path | None,
    as_json: bool,
) -> None:
    from stillray.cli.output import console, status
    from stillray.profiling.clip import MADE_UP
    from stillray.profiling.machine import describe
    from stillray.profiling.report import as_dict, remarks, table
    from stillray.profiling.results import profile_settings

    with status("measuring") as progress:
        results = profile_settings(
            settings, source=source, seconds=seconds, memory=memory, progress=progress
        )
    machine, frames = describe(), source or MADE_UP
    if plot is not None:
        from stillray.profiling.plot import draw_profile

        draw_profile(results, plot)
    if as_json:
        print(json.dumps(as_dict(results, machine, frames), indent=2))
        return
    out = console()
    out.print(", ".join(f"{name} {value}" for name, value in machine.items()))
    out.print(f"frames: {frames}")
    for result in results:
        out.print()
        out.print(table(result))
        for line in remarks(result):
            out.print(line)


def _scaling(
    models: Sequence[str] | None,
    sizes: Sequence[str] | None,
    threads: Sequence[int] | None,
    plot: Path | None,
    as_json: bool,
) -> None:
    from stillray.arrays.strips import available_threads
    from stillray.cli.output import console, status
    from stillray.profiling.machine import describe
    from stillray.profiling.report import curve_table, curves_as_dict
    from stillray.profiling.scaling import SIZES, in_words, scaling_curves

    if models and len(models) > 1:
        raise InputError(f"--scaling takes one model, got {', '.join(models)}")
    with status("measuring") as progress:
        curves = scaling_curves(
            models[0] if models else "fast",
            threads=max(threads or [available_threads()]),
            sizes=sorted(_parse_size(text) for text in sizes) if sizes else SIZES,
            progress=progress,
        )
    if plot is not None:
        from stillray.profiling.plot import draw_curves

        draw_curves(curves, plot)
    if as_json:
        print(json.dumps(curves_as_dict(curves, describe()), indent=2))
        return
    out = console()
    for curve in curves:
        out.print(in_words(curve))
        out.print(curve_table(curve))
        out.print()

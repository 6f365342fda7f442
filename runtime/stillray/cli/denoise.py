"""``stillray denoise``: one file or a sequence, in order, through one denoiser."""

from __future__ import annotations

from typing import Annotated

import typer

from stillray.cli import dry_run, reports
from stillray.errors import InputError

_CHUNK_FRAMES = 64  # as `stillray.batch.api` has it, which is not loaded for a help text
_FILE = "EXR or PFM file that holds the {}, or a pattern, glob or folder for a sequence."


def _complete_model(incomplete: str) -> list[str]:
    from stillray.models.registry import list_models

    models = list_models()
    names = [alias for model in models for alias in model.aliases] + [m.name for m in models]
    return [name for name in names if name.startswith(incomplete)]


def denoise(
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="INPUT...",
            help="An EXR or PFM file; a sequence as 'shot.####.exr', 'shot.%04d.exr', "
            "'shot.$F4.exr' or 'shot.*.exr'; or the files of one sequence.",
        ),
    ] = None,
    hdr: Annotated[
        str | None, typer.Option("--hdr", "-hdr", help="INPUT, as oidnDenoise names it.")
    ] = None,
    output: Annotated[
        str,
        typer.Option(
            "--output",
            "-o",
            help="An EXR or PFM file, a pattern as 'clean.####.exr', or a folder, which gets files "
            "of the inputs' names; 'new/', with a slash, is made.",
        ),
    ] = "",
    model: Annotated[
        str,
        typer.Option(
            "--model",
            "--quality",
            "-m",
            autocompletion=_complete_model,
            help="fast, balanced, high, a model name or .onnx file, also of a frame graph; or -q "
            "high, as oidnDenoise has it.",
        ),
    ] = "high",
    albedo: Annotated[
        str | None, typer.Option("--albedo", "--alb", "-alb", help=_FILE.format("albedo"))
    ] = None,
    normal: Annotated[
        str | None, typer.Option("--normal", "--nrm", "-nrm", help=_FILE.format("normal"))
    ] = None,
    depth: Annotated[str | None, typer.Option(help=_FILE.format("depth"))] = None,
    motion: Annotated[str | None, typer.Option(help=_FILE.format("motion"))] = None,
    color_b: Annotated[
        str | None,
        typer.Option(
            "--color-b",
            help="The frames rendered again with another seed, for models that learn from both: "
            "an EXR file, or a pattern, glob or folder for a sequence.",
        ),
    ] = None,
    layer: Annotated[
        list[str] | None,
        typer.Option("--layer", help="ROLE=NAME: take this layer, or channels, for a role."),
    ] = None,
    view: Annotated[
        str | None,
        typer.Option(
            help="Of files with several views, as left and right: the only one to denoise, the "
            "others are kept as they are. Without, all are, each with a history of its own."
        ),
    ] = None,
    samples: Annotated[
        float | None,
        typer.Option(help="Samples a pixel of the input, whatever the files say of it."),
    ] = None,
    pixel_filter: Annotated[
        str | None,
        typer.Option(
            help="The renderer's pixel filter: box, triangle, gaussian or blackman-harris, with a "
            "width in pixels as in gaussian:2 or without, or its standard deviation in pixels. "
            "Files of Cycles are taken to have Blender's usual one."
        ),
    ] = None,
    clean_features: Annotated[
        bool,
        typer.Option(
            "--clean-features",
            help="Albedo has no noise, as of many samples: take it as it is.",
        ),
    ] = False,
    aovs: Annotated[
        str | None,
        typer.Option(
            help="Layers of light to filter as the beauty, as diffuse,specular; or all that are "
            "known. They keep adding up."
        ),
    ] = None,
    only_color: Annotated[
        bool,
        typer.Option(
            "--only-color", help="Write R, G, B and no other channels, of the color's type."
        ),
    ] = False,
    frames: Annotated[
        str | None, typer.Option(help="Frames to write, as 10-80, 10-80x2 or 1,5,10-20.")
    ] = None,
    on_missing: Annotated[
        str,
        typer.Option(
            help="error, or skip: go on without frames that have no file, with a new history."
        ),
    ] = "error",
    warm_up: Annotated[
        int | None,
        typer.Option(
            help="Run so many frames before the first one too, without writing them, so that it "
            "has a history: for a part of a shot. In chunks, and where a run is resumed, 32 unless "
            "given; with 16 or fewer, a step may be seen where chunks meet."
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Dask scheduler, as tcp://host:8786, whose workers take a chunk of the sequence "
            "each; they must see the files under the same names. Finished frames are kept, as "
            "with --resume.",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(help="The same in so many processes of this machine, without a scheduler."),
    ] = None,
    chunk: Annotated[
        int | None,
        typer.Option(
            help=f"Frames of a chunk, {_CHUNK_FRAMES} unless given; those of --warm-up come on top."
        ),
    ] = None,
    threads: Annotated[
        int | None,
        typer.Option(
            help="Threads of each process; all available processors, shared among local workers, "
            "unless given."
        ),
    ] = None,
    provider: Annotated[
        list[str] | None,
        typer.Option(
            help="ONNX Runtime execution provider, repeatable; the CPU unless given. It runs the "
            "network; given a frame graph, NAME.frame.onnx, as model, all stages."
        ),
    ] = None,
    precision: Annotated[
        str,
        typer.Option(
            help="Numbers that the network computes in: float32; int8, where the model has it; "
            "auto takes that on processors that are faster with it, but not with --scheduler."
        ),
    ] = "auto",
    ensemble: Annotated[
        int,
        typer.Option(
            help="How many pictures of a frame are averaged, 1 to 4, for each of which the network "
            "sees it mirrored otherwise: the mean is better. Each takes about as long as the first."
        ),
    ] = 1,
    max_memory: Annotated[
        str | None,
        typer.Option(
            help="What the process may take, as 2G or 800M: larger frames are denoised in tiles, "
            "slower, with the same pixels but for rounding."
        ),
    ] = None,
    state: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="Of a model that learns as it runs: go on from what this file holds, if it is "
            "there, and write it in the end.",
        ),
    ] = None,
    temporal: Annotated[
        bool, typer.Option("--temporal/--no-temporal", help="Accumulate over frames.")
    ] = True,
    cuts: Annotated[
        bool,
        typer.Option(
            "--cuts/--no-cuts", help="Look for cuts and begin a new history where one is found."
        ),
    ] = True,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="Keep outputs that were made from the same inputs with the same model and "
            "options, known by digests that they hold.",
        ),
    ] = False,
    dry: Annotated[
        bool,
        typer.Option("--dry-run", help="Say what would be done, and why; write nothing."),
    ] = False,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="Print a JSON object a line: one a frame, then a summary."),
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", help="Print errors only; also -q before another option.")
    ] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="A line a frame with all its times.")
    ] = False,
) -> None:
    """Denoise an EXR or PFM file or a numbered sequence.

    Models that enlarge, as munet-x2, look where samples lie in their pixels, which the EXR
    attribute stillray:jitter says: docs/command-line.md has its convention.

    Flags of oidnDenoise that mean the same are taken: --hdr, --alb, --nrm, -o, -q, with one dash
    or two.
    """
    if hdr is not None:
        if sources:
            raise InputError(f"INPUT must be given once, got {sources[0]} and --hdr {hdr}")
        sources = [hdr]
    if not sources:
        raise InputError("INPUT must be given: an EXR file or a sequence as 'shot.####.exr'")
    if not output:
        raise InputError("output must be given: -o FILE, PATTERN or FOLDER")
    from stillray.batch.api import ShotOptions, plan_run
    from stillray.io.channels.roles import parse_overrides
    from stillray.io.exr.views import VIEW
    from stillray.pipeline.tiles import parse_memory
    from stillray.pixel_filter import parse_filter

    companions = {
        "albedo": albedo, "normal": normal, "depth": depth, "motion": motion, "color_b": color_b,
    }  # fmt: skip
    options = ShotOptions(
        companions={role: pattern for role, pattern in companions.items() if pattern is not None},
        layers=parse_overrides(layer or []) | ({} if view is None else {VIEW: view}),
        samples=samples,
        filter_spread=None if pixel_filter is None else parse_filter(pixel_filter),
        clean_features=clean_features,
        aovs=None if aovs is None else () if aovs == "all" else tuple(aovs.split(",")),
        only_color=only_color,
        frames=frames,
        on_missing=on_missing,
        warm_up=warm_up,
        temporal=temporal,
        cuts=cuts,
        resume=resume,
        threads=threads,
        providers=tuple(provider) if provider else None,
        precision=precision,
        ensemble=ensemble,
        max_memory=None if max_memory is None else parse_memory(max_memory),
        state=state,
        workers=workers,
        scheduler=scheduler,
        chunk=chunk,
    )
    planned = plan_run(sources, output, model, options, look=dry)
    if dry:
        dry_run.show(dry_run.collect(planned), as_json=as_json)
        return
    kind = "json" if as_json else "quiet" if quiet else "text"
    with reports.report_to(kind, planned.count, verbose=verbose) as report:
        report.end(reports.summarise(planned.run(report)))

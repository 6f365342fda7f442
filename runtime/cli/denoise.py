"""``stillray denoise``: one file or a sequence, in order, through one denoiser."""

from __future__ import annotations

import statistics
import sys
import time
from typing import TYPE_CHECKING, Annotated

import typer

from stillray.cli.jobs import finished, plan_jobs, steps_to_run

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from stillray.cli.jobs import Step
    from stillray.denoiser import Denoiser
    from stillray.layout import Layout

_FILE = "EXR file that holds the {}, or a pattern for a sequence."


def denoise(
    source: Annotated[
        str,
        typer.Argument(metavar="INPUT", help="An EXR file, or a sequence as 'shot.####.exr'."),
    ],
    output: Annotated[
        str, typer.Option("--output", "-o", help="An EXR file, or a pattern as 'clean.####.exr'.")
    ],
    model: Annotated[
        str,
        typer.Option("--model", "-m", help="fast, balanced, high, a model name or .onnx file."),
    ] = "balanced",
    albedo: Annotated[str | None, typer.Option(help=_FILE.format("albedo"))] = None,
    normal: Annotated[str | None, typer.Option(help=_FILE.format("normal"))] = None,
    depth: Annotated[str | None, typer.Option(help=_FILE.format("depth"))] = None,
    motion: Annotated[str | None, typer.Option(help=_FILE.format("motion"))] = None,
    layer: Annotated[
        list[str] | None,
        typer.Option("--layer", help="ROLE=NAME: take this layer, or channels, for a role."),
    ] = None,
    aovs: Annotated[
        str | None,
        typer.Option(
            help="Layers of light to filter as the beauty, as diffuse,specular; or all that are "
            "known. They keep adding up."
        ),
    ] = None,
    only_color: Annotated[
        bool, typer.Option("--only-color", help="Write R, G, B and no other channels.")
    ] = False,
    threads: Annotated[
        int | None, typer.Option(help="Threads; all available processors unless given.")
    ] = None,
    temporal: Annotated[
        bool, typer.Option("--temporal/--no-temporal", help="Accumulate over frames.")
    ] = True,
    resume: Annotated[
        bool, typer.Option("--resume", help="Keep outputs that are newer and complete.")
    ] = False,
) -> None:
    """Denoise an EXR file or a numbered sequence."""
    companions = {"albedo": albedo, "normal": normal, "depth": depth, "motion": motion}
    from stillray.layers import parse_overrides

    chosen = parse_overrides(layer or [])
    given = {role: p for role, p in companions.items() if p is not None}
    jobs = plan_jobs(source, output, given, chosen)
    done = [resume and finished(job) for job in jobs]
    from stillray.denoiser import Denoiser
    from stillray.layout import Layout

    names = None if aovs is None else () if aovs == "all" else tuple(aovs.split(","))
    layout = Layout.of(
        [job.source for job in jobs],
        layers=chosen,
        aovs=names,
        only_color=only_color,
        temporal=temporal and motion is None,
    )
    if layout.detection is not None:
        verdict = "proven" if layout.detection.convention else "not used"
        print(f"motion {verdict}: {layout.detection.reason}", flush=True)
    with Denoiser(model, threads=threads, temporal=temporal) as denoiser:
        steps = steps_to_run(jobs, done, temporal=temporal)
        if not steps:
            print(f"{_frames(len(jobs))} done already, nothing to do")
            return
        run = _run_with_progress if sys.stderr.isatty() else _run_with_lines
        milliseconds = run(denoiser, layout, steps)
    skipped = f", {sum(done)} done already" if any(done) else ""
    print(
        f"{_frames(len(milliseconds))}, median {statistics.median(milliseconds):.1f} ms per frame"
        f" with {denoiser.model.name}{skipped}"
    )


def _run(
    denoiser: Denoiser,
    layout: Layout,
    steps: Sequence[Step],
    report: Callable[[Step, float], None],
) -> list[float]:
    """Denoise every step; milliseconds of those written, without reading and writing."""
    from stillray.layers import holds_irradiance

    milliseconds = []
    before: Path | None = None
    for step in steps:
        job = step.job
        frame, lights = layout.read(
            job.source, job.companions, None if step.starts_anew else before
        )
        if step.starts_anew:
            denoiser.reset()
        start = time.perf_counter()
        if lights:
            bare = [name for name in lights if holds_irradiance(name)]
            clean, lights = denoiser.denoise_layers(frame, lights, irradiance=bare)
        else:
            clean = denoiser.denoise(frame)
        elapsed = 1e3 * (time.perf_counter() - start)
        if step.writes:
            tags = {"stillray:model": denoiser.model.name}
            clamped = layout.write(job.output, clean, lights, like=job.source, attributes=tags)
            if clamped:
                print(f"{job.output}: {clamped} values beyond the half range, clamped to 65504")
            milliseconds.append(elapsed)
        before = job.source
        report(step, elapsed)
    return milliseconds


def _run_with_lines(denoiser: Denoiser, layout: Layout, steps: Sequence[Step]) -> list[float]:
    def report(step: Step, elapsed: float) -> None:
        target = str(step.job.output) if step.writes else "(warm-up, not written)"
        # the very first frame has no history either, and that needs no saying
        cut = "  history starts anew" if step.starts_anew and step is not steps[0] else ""
        print(f"{step.job.source} -> {target}  {elapsed:.1f} ms{cut}", flush=True)

    return _run(denoiser, layout, steps, report)


def _run_with_progress(denoiser: Denoiser, layout: Layout, steps: Sequence[Step]) -> list[float]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[last]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("denoising", total=len(steps), last="")

        def report(step: Step, elapsed: float) -> None:
            progress.update(
                task, advance=1, description=step.job.source.name, last=f"{elapsed:.0f} ms"
            )

        return _run(denoiser, layout, steps, report)


def _frames(count: int) -> str:
    return "1 frame" if count == 1 else f"{count} frames"

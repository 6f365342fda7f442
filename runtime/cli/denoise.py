"""``stillray denoise``: one file or a sequence, in order, through one denoiser."""

from __future__ import annotations

import statistics
import sys
import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stillray.cli.jobs import finished, plan_jobs, steps_to_run

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from stillray.cli.jobs import Step
    from stillray.denoiser import Denoiser

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
    jobs = plan_jobs(source, output, {role: p for role, p in companions.items() if p is not None})
    done = [resume and finished(job) for job in jobs]
    from stillray.denoiser import Denoiser

    with Denoiser(model, threads=threads, temporal=temporal) as denoiser:
        steps = steps_to_run(jobs, done, temporal=temporal)
        if not steps:
            print(f"{_frames(len(jobs))} done already, nothing to do")
            return
        run = _run_with_progress if sys.stderr.isatty() else _run_with_lines
        milliseconds = run(denoiser, steps)
    skipped = f", {sum(done)} done already" if any(done) else ""
    print(
        f"{_frames(len(milliseconds))}, median {statistics.median(milliseconds):.1f} ms per frame"
        f" with {denoiser.model.name}{skipped}"
    )


def _run(
    denoiser: Denoiser, steps: Sequence[Step], report: Callable[[Step, float], None]
) -> list[float]:
    """Denoise every step; milliseconds of those written, without reading and writing."""
    from stillray.exr import read_exr, write_exr

    milliseconds = []
    for step in steps:
        job = step.job
        frame = read_exr(job.source, **dict[str, Any](job.companions))
        if step.starts_anew:
            denoiser.reset()
        start = time.perf_counter()
        clean = denoiser.denoise(frame)
        elapsed = 1e3 * (time.perf_counter() - start)
        if step.writes:
            write_exr(job.output, clean, like=job.source)
            milliseconds.append(elapsed)
        report(step, elapsed)
    return milliseconds


def _run_with_lines(denoiser: Denoiser, steps: Sequence[Step]) -> list[float]:
    def report(step: Step, elapsed: float) -> None:
        target = str(step.job.output) if step.writes else "(warm-up, not written)"
        # the very first frame has no history either, and that needs no saying
        cut = "  history starts anew" if step.starts_anew and step is not steps[0] else ""
        print(f"{step.job.source} -> {target}  {elapsed:.1f} ms{cut}", flush=True)

    return _run(denoiser, steps, report)


def _run_with_progress(denoiser: Denoiser, steps: Sequence[Step]) -> list[float]:
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

        return _run(denoiser, steps, report)


def _frames(count: int) -> str:
    return "1 frame" if count == 1 else f"{count} frames"

"""What ``stillray denoise`` says while it runs: lines, a bar, JSON, or nothing."""

from __future__ import annotations

import json
import statistics
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from stillray.batch.api import ShotResult
    from stillray.batch.run import FrameReport
    from stillray.io.channels.motion_detection import Detection


class Report(Protocol):
    """Told of the motion, of notes and waiting, of every frame that is done, and of the end."""

    def motion(self, detection: Detection) -> None:
        """The convention of the motion had to be proven, and this came of it."""

    def note(self, line: str) -> None:
        """Something about the outputs that a user should know."""

    def wait(self, reason: str) -> None:
        """Nothing happens until somebody else does something."""

    def frame(self, done: FrameReport) -> None:
        """One frame is done."""

    def end(self, summary: dict[str, Any]) -> None:
        """All are; see `summarise`."""


def summarise(result: ShotResult) -> dict[str, Any]:
    """Figures of a whole run."""
    done = result.frames
    written = [d.denoise_ms for d in done if d.step.writes]
    return {
        "frames_written": len(written),
        "frames_warm_up": len(done) - len(written),
        "frames_done_already": result.already,
        "cuts": [d.step.job.number for d in done if d.cut is not None],
        "model": result.model,
        "denoise_ms_median": statistics.median(written) if written else None,
        "denoise_seconds": sum(d.denoise_ms for d in done) / 1e3,
        "seconds": result.seconds,
    }


@contextmanager
def report_to(kind: str, frames: int, *, verbose: bool) -> Iterator[Report]:
    """The reporter of a kind: ``"json"``, ``"quiet"`` or ``"text"``, for so many frames."""
    if kind == "json":
        yield _Json()
    elif kind == "quiet":
        yield _Quiet()
    elif sys.stderr.isatty() and not verbose:
        with _bar(frames) as bar:
            yield bar
    else:
        yield _Lines(verbose=verbose)


class _Quiet:
    def motion(self, detection: Detection) -> None:
        pass

    def note(self, line: str) -> None:
        pass

    def wait(self, reason: str) -> None:
        pass

    def frame(self, done: FrameReport) -> None:
        pass

    def end(self, summary: dict[str, Any]) -> None:
        pass


class _Json:
    """One JSON object a line: ``"event"`` is ``"frame"``, at the end ``"summary"``; ``"motion"``
    comes first where its convention had to be proven, ``"note"`` where outputs cannot keep all of
    the structure of inputs, or, after the frames, have other layers written anew, ``"wait"`` where
    workers are waited for."""

    def motion(self, detection: Detection) -> None:
        facts = {
            "event": "motion",
            "used": detection.convention is not None,
            "reason": detection.reason,
        }
        print(json.dumps(facts), flush=True)

    def note(self, line: str) -> None:
        print(json.dumps({"event": "note", "text": line}), flush=True)

    def wait(self, reason: str) -> None:
        print(json.dumps({"event": "wait", "reason": reason}), flush=True)

    def frame(self, done: FrameReport) -> None:
        job = done.step.job
        facts = {
            "event": "frame",
            "number": job.number,
            "source": str(job.source),
            "output": str(job.output) if done.step.writes else None,
            "starts_anew": done.step.starts_anew or done.cut is not None,
            "cut": None if done.cut is None else str(done.cut),
            "clamped": done.clamped,
            "broken": done.broken,
            "read_ms": round(done.read_ms, 3),
            "denoise_ms": round(done.denoise_ms, 3),
            "write_ms": round(done.write_ms, 3),
        }
        print(json.dumps(facts), flush=True)

    def end(self, summary: dict[str, Any]) -> None:
        print(json.dumps({"event": "summary", **summary}), flush=True)


class _Lines:
    def __init__(self, *, verbose: bool) -> None:
        self._first = True
        self._verbose = verbose

    def motion(self, detection: Detection) -> None:
        print(_motion(detection), flush=True)

    def note(self, line: str) -> None:
        print(f"note: {line}", flush=True)

    def wait(self, reason: str) -> None:
        print(reason, flush=True)

    def frame(self, done: FrameReport) -> None:
        print(_line(done, first=self._first, verbose=self._verbose), flush=True)
        self._first = False

    def end(self, summary: dict[str, Any]) -> None:
        print(_last_line(summary, verbose=self._verbose))


class _Bar:
    def __init__(self, progress: Any, task: Any) -> None:
        self._progress = progress
        self._task = task

    def motion(self, detection: Detection) -> None:
        self._progress.console.print(_motion(detection), markup=False)

    def note(self, line: str) -> None:
        self._progress.console.print(f"note: {line}", markup=False)

    def wait(self, reason: str) -> None:
        self._progress.console.print(reason, markup=False)

    def frame(self, done: FrameReport) -> None:
        name = done.step.job.source.name
        self._progress.update(
            self._task, advance=1, description=name, last=f"{done.denoise_ms:.0f} ms"
        )
        if done.cut is not None:
            self._progress.console.print(f"{name}: cut, {done.cut}", markup=False)
        if done.clamped:
            self._progress.console.print(f"{name}: {_clamped(done)}", markup=False)
        if done.broken:
            self._progress.console.print(f"{name}: {_broken(done)}", markup=False)

    def end(self, summary: dict[str, Any]) -> None:
        self._progress.stop()
        print(_last_line(summary, verbose=False))


@contextmanager
def _bar(total: int) -> Iterator[_Bar]:
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
        yield _Bar(progress, progress.add_task("denoising", total=total, last=""))


def _line(done: FrameReport, *, first: bool, verbose: bool) -> str:
    step = done.step
    target = str(step.job.output) if step.writes else "(warm-up, not written)"
    line = f"{step.job.source} -> {target}  {done.denoise_ms:.1f} ms"
    if verbose:
        line += f" (read {done.read_ms:.1f}, write {done.write_ms:.1f})"
    if done.clamped:
        line += f"  {_clamped(done)}"
    if done.broken:
        line += f"  {_broken(done)}"
    if done.cut is not None:
        return f"{line}  cut, history starts anew: {done.cut}"
    # the very first frame has no history either, and that needs no saying
    return f"{line}  history starts anew" if step.starts_anew and not first else line


def _broken(done: FrameReport) -> str:
    if done.broken == 1:
        return "no pixel's color is a finite number: the picture is black"
    return f"{100 * done.broken:.3g} % of pixels are no finite numbers, filled from those around"


def _clamped(done: FrameReport) -> str:
    return f"{done.clamped} values beyond the half range, clamped to 65504"


def _motion(detection: Detection) -> str:
    verdict = "proven" if detection.convention is not None else "not used"
    return f"motion {verdict}: {detection.reason}"


def _last_line(summary: dict[str, Any], *, verbose: bool) -> str:
    already = summary["frames_done_already"]
    if not summary["frames_written"]:
        return f"{frames(already)} done already, nothing to do"
    line = (
        f"{frames(summary['frames_written'])}, median {summary['denoise_ms_median']:.1f} ms "
        f"per frame with {summary['model']}"
    )
    if already:
        line += f", {already} done already"
    if verbose:
        line += (
            f"; {summary['seconds']:.1f} s in all, "
            f"{summary['denoise_seconds']:.1f} s of them in the denoiser"
        )
    return line


def frames(count: int) -> str:
    """A number of frames in words."""
    return "1 frame" if count == 1 else f"{count} frames"

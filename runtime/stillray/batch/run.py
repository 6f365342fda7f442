"""Frames from files to files: read ahead, denoised in order, written behind."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stillray.batch.file_layout import CleanPicture, Layout, ViewFrame
from stillray.batch.lights import denoise_lights
from stillray.batch.read_ahead import AHEAD, run_overlapped
from stillray.batch.resume import Recipe, file_digest, is_finished
from stillray.batch.scene_cuts import Agreement, CutDetector
from stillray.batch.shot import RunStep, ShotFrame, window
from stillray.families.contract import State
from stillray.pipeline.denoiser import Denoiser


@dataclass(frozen=True, kw_only=True)
class FrameReport:
    """What came of one step.

    Attributes
    ----------
    step
        What was asked for.
    cut
        How the frame disagrees with the last, where that was taken for a cut.
    clamped
        Values that half precision could not hold, written as its largest.
    broken
        Share of its pixels whose color is no finite number, [0, 1]: they were filled from those
        around, and are black where none is.
    read_ms, denoise_ms, write_ms
        Milliseconds; the three overlap those of other frames.
    """

    step: RunStep
    cut: Agreement | None
    clamped: int
    broken: float
    read_ms: float
    denoise_ms: float
    write_ms: float


class _Read(NamedTuple):
    views: tuple[ViewFrame, ...]
    cut: Agreement | None
    digest: str
    broken: float
    milliseconds: float


class _Denoised(NamedTuple):
    views: tuple[CleanPicture, ...]
    read: _Read
    milliseconds: float


def finished(
    jobs: Sequence[ShotFrame],
    recipe: Recipe,
    *,
    memory: int,
    layers: Sequence[Mapping[str, str]] = ({},),
) -> list[bool]:
    """Which frames have been written already, from these inputs and by this recipe.

    Parameters
    ----------
    jobs
        From `stillray.batch.shot.plan_shot`.
    recipe
        Model and options.
    memory
        Frames that a history goes back.
    layers
        Of each view, see `Layout.of_views`.
    """
    # the work is that of libraries which let other threads run
    with ThreadPoolExecutor(thread_name_prefix="stillray-check") as pool:
        inputs = list(pool.map(_input_digests, jobs))

        def check(index: int) -> bool:
            output = jobs[index].output
            digest = recipe.digest([inputs[i] for i in window(jobs, index, memory)])
            return output is not None and is_finished(output, digest, layers)

        return list(pool.map(check, range(len(jobs))))


def remove_leftovers(jobs: Sequence[ShotFrame]) -> None:
    """Delete what runs that were killed have left of the outputs of these frames.

    Another run that writes the same frames at this moment would fail for it.
    """
    outputs = [job.output for job in jobs if job.output is not None]
    for folder in {output.parent for output in outputs}:
        # as `stillray.io.atomic.atomic_path` names them: .NAME.RANDOM.part
        prefixes = tuple(f".{output.name}." for output in outputs if output.parent == folder)
        for path in folder.glob(".*.part"):
            if path.name.startswith(prefixes):
                with suppress(OSError):  # of somebody else's, or gone already
                    path.unlink()


@dataclass(frozen=True, kw_only=True)
class Handling:
    """How the frames of a shot are read, told apart and written.

    Attributes
    ----------
    layout
        What is taken from the files and put back.
    recipe
        What goes into the files' provenance.
    memory
        Frames that a history goes back, of which the provenance tells.
    cuts
        Whether cuts are looked for.
    ahead
        Frames read ahead and written behind, see `stillray.batch.read_ahead.run_overlapped`.
    """

    layout: Layout
    recipe: Recipe
    memory: int
    cuts: bool = True
    ahead: int = AHEAD


def run_steps(
    denoiser: Denoiser,
    steps: Iterable[RunStep],
    how: Handling,
    report: Callable[[FrameReport], None],
) -> None:
    """Denoise frames in order.

    Parameters
    ----------
    denoiser
        Its history is dropped where a step says so, and at cuts.
    steps
        From `stillray.batch.shot.steps_to_run`.
    how
        How they are read and written.
    report
        Called as each frame is done, in order.

    Raises
    ------
    InputError
        A frame cannot be read or written. Those before it are complete.
    """
    run = _Run(denoiser, how)
    run_overlapped(
        steps, run.read, run.work, run.write, lambda _, done: report(done), ahead=how.ahead
    )


class _Run:
    """The three things that happen to a frame, each in a thread of its own."""

    def __init__(self, denoiser: Denoiser, how: Handling) -> None:
        self._denoiser, self._how = denoiser, how
        # the reader's alone
        spec, views = denoiser.model.spec, how.layout.of_views
        self._detectors = [CutDetector(spec) for _ in views] if how.cuts else []
        self._inputs: deque[dict[str, str]] = deque(maxlen=how.memory + 1)
        self._before: Path | None = None
        # the worker's alone: the past of each view
        self._pasts: list[State | None] = [None] * len(views)

    def read(self, step: RunStep) -> _Read:
        start, job, how = time.perf_counter(), step.job, self._how
        if step.starts_anew:
            self._inputs.clear()
            self._before = None
        self._inputs.append(_input_digests(job))
        views = how.layout.read(job.source, job.companions, self._before)
        self._before = job.source
        cut = self._cut(views, step)
        digest = how.recipe.digest(list(self._inputs))
        broken = float(np.mean([_broken(view.frame.color) for view in views]))
        return _Read(views, cut, digest, broken, _since(start))

    def _cut(self, views: Sequence[ViewFrame], step: RunStep) -> Agreement | None:
        """Why the frame is taken for a cut, if it is: what cuts one eye cuts the other."""
        if not self._detectors:
            return None
        if step.starts_anew:
            for detector in self._detectors:
                detector.reset()
        found = [
            detector.compare(view.frame)
            for detector, view in zip(self._detectors, views, strict=True)
        ]
        return next((one for one in found if one is not None and one.is_cut), None)

    def work(self, step: RunStep, read: _Read) -> _Denoised:
        start, clean = time.perf_counter(), []
        for place, view in enumerate(read.views):
            if len(self._pasts) > 1:
                self._denoiser.state = self._pasts[place]
            if step.starts_anew or read.cut is not None:
                self._denoiser.reset()
            clean.append(self._denoise(view))
            if len(self._pasts) > 1:
                self._pasts[place] = self._denoiser.state
        return _Denoised(tuple(clean), read, _since(start))

    def _denoise(self, view: ViewFrame) -> CleanPicture:
        if not view.lights:
            return CleanPicture(self._denoiser.denoise(view.frame), {})
        return CleanPicture(*denoise_lights(self._denoiser, view.frame, view.lights))

    def write(self, step: RunStep, denoised: _Denoised) -> FrameReport:
        start, clamped = time.perf_counter(), 0
        if step.writes:
            assert step.job.output is not None
            images = [picture.image for picture in denoised.views]
            clamped = self._how.layout.write(
                step.job.output,
                denoised.views,
                like=step.job.source,
                attributes=self._how.recipe.attributes(denoised.read.digest, *images),
            )
        return FrameReport(
            step=step,
            cut=denoised.read.cut,
            clamped=clamped,
            broken=denoised.read.broken,
            read_ms=denoised.read.milliseconds,
            denoise_ms=denoised.milliseconds,
            write_ms=_since(start),
        )


def _input_digests(job: ShotFrame) -> dict[str, str]:
    return {role: file_digest(path) for role, path in job.inputs.items()}


def _broken(color: np.ndarray) -> float:
    """Share of pixels that hold what is no finite number."""
    finite = np.isfinite(color)
    # pixel by pixel takes thirty times as long
    return 0.0 if finite.all() else 1 - float(finite.all(axis=-1).mean())


def _since(start: float) -> float:
    return 1e3 * (time.perf_counter() - start)

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

from stillray.batch.file_layout import Layout
from stillray.batch.read_ahead import AHEAD, run_overlapped
from stillray.batch.resume import Recipe, file_digest, is_finished
from stillray.batch.scene_cuts import Agreement, CutDetector
from stillray.batch.shot import Job, Step, window
from stillray.frame import Frame
from stillray.io.channels.roles import holds_irradiance
from stillray.pipeline.denoiser import Denoiser


@dataclass(frozen=True, kw_only=True)
class Done:
    """What came of one step.

    Attributes
    ----------
    step
        What was asked for.
    cut
        How the frame disagrees with the last, where that was taken for a cut.
    clamped
        Values that half precision could not hold, written as its largest.
    read_ms, denoise_ms, write_ms
        Milliseconds; the three overlap those of other frames.
    """

    step: Step
    cut: Agreement | None
    clamped: int
    read_ms: float
    denoise_ms: float
    write_ms: float


class _Read(NamedTuple):
    frame: Frame
    lights: dict[str, np.ndarray]
    cut: Agreement | None
    digest: str
    milliseconds: float


class _Denoised(NamedTuple):
    picture: np.ndarray
    lights: dict[str, np.ndarray]
    cut: Agreement | None
    digest: str
    read_ms: float
    milliseconds: float


def finished(
    jobs: Sequence[Job],
    recipe: Recipe,
    *,
    memory: int,
    layers: Mapping[str, str] | None = None,
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
        As for `plan_shot`.
    """
    # the work is that of libraries which let other threads run
    with ThreadPoolExecutor(thread_name_prefix="stillray-check") as pool:
        inputs = list(pool.map(_input_digests, jobs))

        def check(index: int) -> bool:
            output = jobs[index].output
            digest = recipe.digest([inputs[i] for i in window(jobs, index, memory)])
            return output is not None and is_finished(output, digest, layers)

        return list(pool.map(check, range(len(jobs))))


def remove_leftovers(jobs: Sequence[Job]) -> None:
    """Delete what runs that were killed have left of the outputs of these frames.

    Another run that writes the same frames at this moment would fail for it.
    """
    outputs = [job.output for job in jobs if job.output is not None]
    for folder in {output.parent for output in outputs}:
        # as `stillray.io.exr.read_write.atomic_path` names them: .NAME.RANDOM.part
        prefixes = tuple(f".{output.name}." for output in outputs if output.parent == folder)
        for path in folder.glob(".*.part"):
            if path.name.startswith(prefixes):
                with suppress(OSError):  # of somebody else's, or gone already
                    path.unlink()


def run_steps(
    denoiser: Denoiser,
    steps: Iterable[Step],
    layout: Layout,
    recipe: Recipe,
    report: Callable[[Done], None],
    *,
    memory: int,
    cuts: bool = True,
    ahead: int = AHEAD,
) -> None:
    """Denoise frames in order.

    Parameters
    ----------
    denoiser
        Its history is dropped where a step says so, and at cuts.
    steps
        From `stillray.batch.shot.steps_to_run`.
    layout
        What is taken from the files and put back.
    recipe
        What goes into the files' provenance.
    report
        Called as each frame is done, in order.
    memory
        Frames that a history goes back, of which the provenance tells.
    cuts
        Whether cuts are looked for.
    ahead
        Frames read ahead and written behind, see `stillray.batch.read_ahead.run_overlapped`.

    Raises
    ------
    InputError
        A frame cannot be read or written. Those before it are complete.
    """
    detector = CutDetector(denoiser.model.spec) if cuts else None
    inputs: deque[dict[str, str]] = deque(maxlen=memory + 1)
    before: Path | None = None  # the reader's alone

    def read(step: Step) -> _Read:
        nonlocal before
        start = time.perf_counter()
        job = step.job
        if step.starts_anew:
            inputs.clear()
            before = None
        inputs.append(_input_digests(job))
        frame, lights = layout.read(job.source, job.companions, before)
        before = job.source
        cut = _cut(detector, frame, step)
        return _Read(frame, lights, cut, recipe.digest(list(inputs)), _since(start))

    def work(step: Step, read: _Read) -> _Denoised:
        if step.starts_anew or read.cut is not None:
            denoiser.reset()
        start = time.perf_counter()
        lights = read.lights
        if lights:
            bare = [name for name in lights if holds_irradiance(name)]
            picture, lights = denoiser.denoise_layers(read.frame, lights, irradiance=bare)
        else:
            picture = denoiser.denoise(read.frame)
        return _Denoised(picture, lights, read.cut, read.digest, read.milliseconds, _since(start))

    def write(step: Step, denoised: _Denoised) -> Done:
        start = time.perf_counter()
        clamped = 0
        if step.writes:
            assert step.job.output is not None
            clamped = layout.write(
                step.job.output,
                denoised.picture,
                denoised.lights,
                like=step.job.source,
                attributes=recipe.attributes(denoised.digest, denoised.picture),
            )
        return Done(
            step=step,
            cut=denoised.cut,
            clamped=clamped,
            read_ms=denoised.read_ms,
            denoise_ms=denoised.milliseconds,
            write_ms=_since(start),
        )

    run_overlapped(steps, read, work, write, lambda _, done: report(done), ahead=ahead)


def _input_digests(job: Job) -> dict[str, str]:
    return {role: file_digest(path) for role, path in job.inputs.items()}


def _cut(detector: CutDetector | None, frame: Frame, step: Step) -> Agreement | None:
    if detector is None:
        return None
    if step.starts_anew:
        detector.reset()
    agreement = detector.compare(frame)
    return agreement if agreement is not None and agreement.is_cut else None


def _since(start: float) -> float:
    return 1e3 * (time.perf_counter() - start)

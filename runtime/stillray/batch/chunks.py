"""A shot in chunks, each with the frames before it that its history needs: for several machines."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path

from stillray.batch.farm import run_tasks
from stillray.batch.file_layout import Layout
from stillray.batch.read_ahead import AHEAD
from stillray.batch.resume import Recipe, file_digest
from stillray.batch.run import FrameReport, Handling, finished, remove_leftovers, run_steps
from stillray.batch.shot import RunStep, ShotFrame, steps_to_run, window
from stillray.errors import InputError
from stillray.io.frame_range import format_frames
from stillray.models.registry import ModelInfo
from stillray.models.session import Provider
from stillray.pipeline.denoiser import Denoiser
from stillray.pipeline.opening import model_of, network_path
from stillray.version import __version__


@dataclass(frozen=True, kw_only=True)
class ShotSettings:
    """How the frames of a shot are denoised, on whatever machine.

    Attributes
    ----------
    model
        Name, or absolute path of an .onnx file: how it is called on every machine.
    recipe
        Of all frames; its digest of the model must be that of the machine's.
    layout
        What is taken from the files and put back.
    memory
        Frames that a history goes back.
    temporal
        Whether frames are accumulated.
    cuts
        Whether cuts are looked for.
    threads
        Of the denoiser; None for all that there are.
    providers
        Of the denoiser; None for the CPU.
    precision, ensemble
        Of the denoiser.
    max_memory
        Bytes, see `stillray.Denoiser`.
    state
        File to go on from, if it is there, and to write in the end, see `Denoiser.save`.
    """

    model: str
    recipe: Recipe
    layout: Layout
    memory: int
    temporal: bool = True
    cuts: bool = True
    threads: int | None = None
    providers: tuple[Provider, ...] | None = None
    precision: str = "float32"
    ensemble: int = 1
    max_memory: int | None = None
    state: Path | None = None

    def run(
        self, model: ModelInfo, steps: Iterable[RunStep], report: Callable[[FrameReport], None]
    ) -> None:
        """Denoise frames in order, here.

        Parameters
        ----------
        model
            The model itself, as it is on this machine.
        steps
            From `stillray.batch.shot.steps_to_run`.
        report
            Called as each is done.

        Raises
        ------
        InputError
            A frame cannot be read or written. Those before it are complete.
        """
        todo = iter(steps)
        first = next(todo, None)
        if first is None:  # opens no model
            return
        how = Handling(
            layout=self.layout,
            recipe=self.recipe,
            memory=self.memory,
            cuts=self.cuts,
            # in little memory no more frames than needed are held at a time
            ahead=AHEAD if self.max_memory is None else 1,
        )
        with self.opened(model) as denoiser:
            run_steps(denoiser, chain([first], todo), how, report)
            if self.state is not None:
                denoiser.save(self.state)

    def opened(self, model: ModelInfo) -> Denoiser:
        """The denoiser of the frames, with what it learned before; the caller closes it.

        Raises
        ------
        InputError
            There is no such provider or number of threads here, or the state is not the model's.
        """
        denoiser = Denoiser(
            model,
            threads=self.threads,
            providers=self.providers,
            precision=self.precision,
            ensemble=self.ensemble,
            temporal=self.temporal,
            max_memory=self.memory_of_view,
        )
        try:
            if self.state is not None and self.state.exists():
                denoiser.load(self.state)
        except BaseException:
            denoiser.close()
            raise
        return denoiser

    @property
    def memory_of_view(self) -> int | None:
        """Bytes for each view, which has a past of its own; None for whole frames."""
        return None if self.max_memory is None else self.max_memory // len(self.layout.of_views)

    def find_model(self) -> ModelInfo:
        """The model on this machine.

        Raises
        ------
        InputError
            There is none, or this machine would make other pictures.
        """
        if self.recipe.version != __version__:
            raise InputError(f"workers must have stillray {self.recipe.version}, got {__version__}")
        model = model_of(self.model)
        network = network_path(model, self.precision, self.providers)
        if file_digest(network) != self.recipe.model_digest:
            raise InputError(
                f"workers must have the same file of the model {self.model}, got another one"
            )
        return model


@dataclass(frozen=True, kw_only=True)
class ChunkDone:
    """What came of a chunk.

    Attributes
    ----------
    done
        The frames that were run.
    already
        How many frames had been written before.
    error
        Why the chunk ended early; None if it did not.
    """

    done: list[FrameReport]
    already: int
    error: str | None = None


def split(jobs: Sequence[ShotFrame], frames: int, *, memory: int) -> dict[str, list[ShotFrame]]:
    """A shot in chunks, each of them a short shot of its own.

    Parameters
    ----------
    jobs
        From `stillray.batch.shot.plan_shot`.
    frames
        That a chunk writes, at most; 1 or more.
    memory
        Frames that a history goes back: so many before a chunk belong to it too, unwritten.

    Returns
    -------
    dict
        The chunks by the numbers of the frames that they write, with absolute paths.
    """
    if frames < 1:
        raise InputError(f"chunk must be 1 frame or more, got {frames}")
    written = [index for index, job in enumerate(jobs) if job.output is not None]
    chunks: dict[str, list[ShotFrame]] = {}
    for start in range(0, len(written), frames):
        own = written[start : start + frames]
        needed = sorted({i for index in own for i in window(jobs, index, memory)})
        numbers = [number for i in own if (number := jobs[i].number) is not None]
        name = format_frames(numbers) if numbers else jobs[own[0]].source.name
        chunks[name] = [_absolute(jobs[i], writes=i in own) for i in needed]
    return chunks


def denoise_chunk(jobs: Sequence[ShotFrame], threads: int, *, work: ShotSettings) -> ChunkDone:
    """What a worker runs: the frames of a chunk that are not finished.

    Parameters
    ----------
    jobs
        One of `split`'s.
    threads
        To use, unless ``work`` says.
    work
        How.
    """
    model = work.find_model()
    if work.threads is None:
        work = replace(work, threads=threads)
    kept = finished(jobs, work.recipe, memory=work.memory, layers=work.layout.of_views)
    ran: list[FrameReport] = []
    error: str | None = None
    try:
        work.run(model, steps_to_run(jobs, kept, memory=work.memory), ran.append)
    except InputError as reason:  # what was done before it is done, and will be told of
        error = f"{reason} (on {socket.gethostname()})"
    return ChunkDone(done=ran, already=sum(kept), error=error)


def run_chunks(
    chunks: dict[str, list[ShotFrame]],
    work: ShotSettings,
    report: Callable[[FrameReport], None],
    *,
    workers: int | None = 2,
    scheduler: str | None = None,
    hooks: tuple[Callable[[str], None], Callable[[], bool]] = (lambda line: None, lambda: True),
) -> int:
    """Denoise the chunks of a shot wherever there is room.

    Frames that are finished already, by what their files hold, are kept; the chunk of a worker
    that is lost goes to another one, which keeps the frames that the first has finished.

    Parameters
    ----------
    chunks
        From `split`.
    work
        How.
    report
        Called with each frame that was run, chunk by chunk as they end.
    workers, scheduler
        As `stillray.batch.farm.run_tasks` takes them.
    hooks
        Called with a line for the user where there is nothing to do but to wait; and asked after
        each chunk whether to go on.

    Returns
    -------
    int
        How many frames had been written already.

    Raises
    ------
    InputError
        Some frames could not be done, all others are; or Dask cannot be used.
    """
    already, errors = 0, {}

    def end(name: str, result: ChunkDone | None) -> None:
        nonlocal already
        if result is None:
            return
        already += result.already
        for done in result.done:
            report(done)
        if result.error is not None:
            errors[name] = result.error
        if not hooks[1]():
            raise _Cancelled

    failures: dict[str, str] = {}
    with suppress(_Cancelled):
        failures = run_tasks(
            partial(denoise_chunk, work=work),
            chunks,
            end,
            workers=workers or 1,
            scheduler=scheduler,
            wait=hooks[0],
        )
    for jobs in chunks.values():  # of workers that were killed
        remove_leftovers(jobs)
    errors |= failures
    if errors:
        name, reason = next(iter(errors.items()))
        others = f"; and {len(errors) - 1} more chunks failed" if len(errors) > 1 else ""
        raise InputError(f"frames {name}: {reason}{others}; what is done is kept")
    return already


class _Cancelled(Exception):  # noqa: N818  no error
    pass


def _absolute(job: ShotFrame, *, writes: bool) -> ShotFrame:
    def absolute(path: Path) -> Path:
        return path.absolute()

    return replace(
        job,
        source=absolute(job.source),
        companions={role: absolute(path) for role, path in job.companions.items()},
        output=absolute(job.output) if writes and job.output is not None else None,
    )

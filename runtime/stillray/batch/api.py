"""A shot from files to files, as one call: `stillray denoise` without its words."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from pathlib import Path
from typing import Protocol, runtime_checkable

from stillray.batch.chunks import ShotSettings, run_chunks, split
from stillray.batch.file_layout import Layout, Told
from stillray.batch.resume import Recipe, file_digest
from stillray.batch.run import FrameReport, finished, remove_leftovers
from stillray.batch.shot import (
    RunStep,
    Selection,
    ShotFrame,
    first_run,
    make_folders,
    plan_shot,
    steps_to_run,
)
from stillray.errors import InputError
from stillray.families.contract import Family, Keeps
from stillray.frame import check_samples
from stillray.io.channels.motion_detection import Detection
from stillray.io.image_file import is_float_map
from stillray.models.registry import (
    DEFAULT_MODEL,
    ModelInfo,
    for_single_frames,
    with_overrides,
)
from stillray.models.session import Provider
from stillray.pipeline.opening import family_of_model, model_of, network_path
from stillray.pipeline.tiles import check_memory
from stillray.pixel_filter import check_spread

#: Frames of a chunk unless told otherwise: twice as many as are run before it for its history.
CHUNK_FRAMES = 64


@dataclass(frozen=True, kw_only=True)
class ShotOptions:
    """How a shot is denoised; every default is that of the command line.

    Attributes
    ----------
    companions
        Feature files, patterns, globs or folders by role: albedo, normal, depth, motion.
    layers
        Role to the layer, or channels, to take for it; and ``"view"`` to the one view to denoise
        of files that hold several, all of which are denoised else, each with its own history.
    samples
        Samples a pixel of the frames, above 0; None for what the files say.
    filter_spread
        Standard deviation of the renderer's pixel filter, in pixels; None for what the files say.
    clean_features
        Whether the albedo of the frames has no noise, as in `stillray.Frame`.
    aovs
        Layers of light to filter as the color; empty for all that are known, None for none.
    only_color
        Whether R, G and B are written and no other channels; not with ``aovs``.
    frames
        Frames to write, as ``"10-80"``, ``"10-80x2"`` or ``"1,5,10-20"``; None for all.
    on_missing
        ``"error"``, or ``"skip"``: go on without frames that have no file, with a new history.
    warm_up
        Frames before the first that are run too, unwritten, so that it has a history; None for 0,
        and in chunks and resumed runs for as many as the model remembers.
    temporal
        Whether frames are accumulated.
    cuts
        Whether cuts are looked for, which begin a new history.
    resume
        Whether outputs that were made from the same inputs in the same way are kept.
    threads
        Of each process, 1 or more; None for all processors, shared among local workers.
    providers
        ONNX Runtime execution providers, as `stillray.Denoiser` takes them, of each process;
        None for the CPU.
    precision
        Numbers that the network computes in, as `stillray.Denoiser` takes it. ``"auto"`` is
        ``"float32"`` with a scheduler, whose machines may differ.
    ensemble
        How many pictures of a frame are averaged, as `stillray.Denoiser` takes it.
    max_memory
        Bytes that the process should stay below; None for whole frames. Of files with several
        views each takes its share.
    state
        File that keeps what a model has learned: the run goes on from it if it is there, and
        writes it in the end. None for none.
    workers
        Local processes that take a chunk of the shot each; None for this process alone.
    scheduler
        Address of a Dask scheduler whose workers take a chunk each.
    chunk
        Frames of a chunk; None for `CHUNK_FRAMES`.
    """

    companions: Mapping[str, str] = field(default_factory=dict)
    layers: Mapping[str, str] = field(default_factory=dict)
    samples: float | None = None
    filter_spread: float | None = None
    clean_features: bool = False
    aovs: tuple[str, ...] | None = None
    only_color: bool = False
    frames: str | None = None
    on_missing: str = "error"
    warm_up: int | None = None
    temporal: bool = True
    cuts: bool = True
    resume: bool = False
    threads: int | None = None
    providers: tuple[Provider, ...] | None = None
    precision: str = "auto"
    ensemble: int = 1
    max_memory: int | None = None
    state: str | None = None
    workers: int | None = None
    scheduler: str | None = None
    chunk: int | None = None

    @property
    def told(self) -> Told:
        """What is said of every frame."""
        return Told(
            samples=self.samples,
            filter_spread=self.filter_spread,
            clean_features=self.clean_features,
        )

    def __post_init__(self) -> None:
        if self.samples is not None:
            check_samples(self.samples)
        if self.filter_spread is not None:
            check_spread(self.filter_spread)
        check_memory(self.max_memory)
        if self.aovs is not None and self.only_color:
            raise InputError(
                "aovs must not be given with only-color, which writes no other layers, got "
                f"{','.join(self.aovs) or 'all'}"
            )
        if self.workers is not None and self.workers < 1:
            raise InputError(f"workers must be 1 or more, got {self.workers}")
        if self.workers is not None and self.scheduler is not None:
            raise InputError(f"workers must not be given with a scheduler, got {self.workers}")
        if self.state is not None and (self.in_chunks or self.resume):
            raise InputError(
                f"state must be given without workers, a scheduler or resume, got {self.state}"
            )
        if self.chunk is not None and not self.in_chunks:
            raise InputError(
                f"chunk must be given with --scheduler or --workers, got {self.chunk} alone"
            )

    @property
    def in_chunks(self) -> bool:
        """Whether the shot is split in chunks."""
        return self.scheduler is not None or (self.workers or 1) > 1


@runtime_checkable
class Progress(Protocol):
    """Told of what happens, in the caller's thread."""

    def motion(self, detection: Detection) -> None:
        """The convention of the motion had to be proven, and this came of it."""

    def note(self, line: str) -> None:
        """Something about the outputs that a user should know."""

    def wait(self, reason: str) -> None:
        """Nothing happens until somebody else does something."""

    def frame(self, done: FrameReport) -> None:
        """One frame is done."""


@dataclass(frozen=True, kw_only=True)
class ShotResult:
    """What came of a shot.

    Attributes
    ----------
    model
        Its name.
    frames
        Every frame that was run, as they were done.
    already
        Frames that needed no work.
    cancelled
        Whether the run was ended early.
    seconds
        From the first look at the files to the last one's end.
    """

    model: str
    frames: tuple[FrameReport, ...]
    already: int
    cancelled: bool
    seconds: float


def denoise_shot(
    sources: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    output: str | Path,
    *,
    model: str | Path = DEFAULT_MODEL,
    options: ShotOptions | None = None,
    progress: Progress | Callable[[FrameReport], None] | None = None,
    cancel: Callable[[], bool] = lambda: False,
) -> ShotResult:
    """Denoise an EXR file or a sequence, from files to files.

    Frames are read ahead and written behind; cuts are found and the meaning of motion is proven;
    finished frames are kept where that is asked for. Files appear whole or not at all.

    Parameters
    ----------
    sources
        An EXR file; a sequence as ``"shot.####.exr"``, ``"shot.%04d.exr"`` or a glob; or the files
        of one sequence. Texts or paths.
    output
        An EXR file, a pattern, or a folder, which gets files of the inputs' names.
    model
        A quality, a model's name, or the path of an .onnx file: a model's or a frame graph's.
    options
        How; None for the defaults.
    progress
        Told of every frame that is done; or an object that is told of more.
    cancel
        Asked before each frame, in chunks after each chunk: True ends the run. The few frames that
        are in work then are finished, and what is written stays.

    Raises
    ------
    InputError
        Something cannot be read, written or used; frames before it are complete.

    Examples
    --------
    >>> import stillray
    >>> stillray.denoise_shot("shot.####.exr", "clean.####.exr")  # doctest: +SKIP
    """
    if not isinstance(options, ShotOptions | None):
        raise InputError(f"options must be a stillray.ShotOptions, got {options!r}")
    given = [sources] if isinstance(sources, str | os.PathLike) else sources
    named = [os.fspath(source) for source in given]
    planned = plan_run(named, str(output), str(model), options or ShotOptions())
    return planned.run(_as_progress(progress), cancel)


@dataclass(frozen=True, kw_only=True)
class PlannedShot:
    """A shot of which all is known but the pixels.

    Attributes
    ----------
    jobs
        All frames.
    steps
        Those that are run here; where the shot is split, workers find out.
    model
        The model.
    family
        What decides and steps for it.
    layout
        How files are read and written.
    already
        Frames that are finished.
    """

    options: ShotOptions
    jobs: list[ShotFrame]
    steps: list[RunStep]
    model: ModelInfo
    family: Family
    layout: Layout
    already: int
    work: ShotSettings
    started: float

    @property
    def count(self) -> int:
        """Frames that will be run, warm-up included."""
        return sum(map(len, self._chunks().values())) or len(self.steps)

    def _chunks(self) -> dict[str, list[ShotFrame]]:
        if not self.options.in_chunks:
            return {}
        size = CHUNK_FRAMES if self.options.chunk is None else self.options.chunk
        return split(self.jobs, size, memory=self.work.memory)

    def check(self) -> None:
        """Open what a run opens before its first frame; what other machines have is not known.

        Raises
        ------
        InputError
            As `run` would, of threads, providers, chunks or the state.
        """
        self._chunks()
        if self.steps and self.options.scheduler is None:
            self.work.opened(self.model).close()

    def run(self, progress: Progress, cancel: Callable[[], bool] = lambda: False) -> ShotResult:
        """Denoise the frames; see `denoise_shot`."""
        chunks = self._chunks()
        make_folders(self.jobs)
        remove_leftovers(self.jobs)
        if self.layout.detection is not None:
            progress.motion(self.layout.detection)
        outputs = [job.output for job in self.jobs if job.output is not None]
        scale = self.family.traits.scale
        for line in self.layout.changes(self.jobs[0].source, outputs[0], scale):
            progress.note(line)
        ran: list[FrameReport] = []
        already, cancelled = self.already, False

        def tell(frame: FrameReport) -> None:
            ran.append(frame)
            progress.frame(frame)

        def go_on(_: object = None) -> bool:
            nonlocal cancelled
            cancelled = cancelled or cancel()
            return not cancelled

        if chunks:
            already = run_chunks(
                chunks,
                self.work,
                tell,
                workers=None if self.options.scheduler else self.options.workers,
                scheduler=self.options.scheduler,
                hooks=(progress.wait, go_on),
            )
        else:
            self.work.run(self.model, takewhile(go_on, self.steps), tell)
        if any(frame.step.writes for frame in ran):
            for line in self.layout.rewritten(self.jobs[0].source, outputs[0]):
                progress.note(line)
        return ShotResult(
            model=self.model.name,
            frames=tuple(ran),
            already=already,
            cancelled=cancelled,
            seconds=time.perf_counter() - self.started,
        )


def plan_run(
    sources: Sequence[str], output: str, model: str, options: ShotOptions, *, look: bool = False
) -> PlannedShot:
    """Find out all about a shot but its pixels.

    Parameters
    ----------
    sources, output, model, options
        As for `denoise_shot`.
    look
        Whether finished frames are looked for here even where workers do so.

    Raises
    ------
    InputError
        As `denoise_shot`.
    """
    started = time.perf_counter()
    temporal, layers = options.temporal, options.layers
    jobs = plan_shot(
        sources,
        output,
        options.companions,
        selection=Selection(
            frames=options.frames,
            on_missing=options.on_missing,
            warm_up=(options.warm_up or 0) if temporal else 0,
        ),
        layers=layers,
    )
    layout = _layout(jobs, options)
    _check_outputs(jobs, layout, resume=options.resume)
    if not temporal or len(jobs) == 1 or not layout.has_motion:
        model = for_single_frames(model, guided=layout.guided)
    chosen, family = _opened(model, options)
    layout = replace(layout, knows_jitter=chosen.spec.knows_jitter)
    memory = _memory(family, options, len(jobs))
    cuts = options.cuts and temporal and chosen.spec.knows_past
    precision = _precision(chosen, options)
    recipe = _recipe(chosen, precision, layout, options)
    done = [False] * len(jobs)
    if options.resume and (look or not options.in_chunks):
        done = finished(jobs, recipe, memory=memory, layers=layout.of_views)
    work = ShotSettings(
        model=str(chosen.path.absolute()) if model.endswith(".onnx") else chosen.name,
        recipe=recipe,
        layout=layout,
        memory=memory,
        temporal=temporal,
        cuts=cuts,
        threads=options.threads,
        providers=options.providers,
        precision=precision,
        ensemble=options.ensemble,
        max_memory=options.max_memory,
        state=None if options.state is None else _state(options.state, chosen, family, layout),
    )
    return PlannedShot(
        options=options,
        jobs=jobs,
        steps=steps_to_run(jobs, done, memory=memory),
        model=chosen,
        family=family,
        layout=layout,
        already=sum(done),
        work=work,
        started=started,
    )


def _layout(jobs: Sequence[ShotFrame], options: ShotOptions) -> Layout:
    """How files are read and written; what buffers frames have, in whatever file."""
    layout = Layout.of(
        first_run(jobs),
        layers=options.layers,
        aovs=options.aovs,
        only_color=options.only_color,
        temporal=options.temporal and "motion" not in options.companions,
        told=options.told,
    )
    return replace(layout, roles=layout.roles | options.companions.keys())


def _check_outputs(jobs: Sequence[ShotFrame], layout: Layout, *, resume: bool) -> None:
    """Raise `InputError` where a float map cannot hold what is asked of it."""
    maps = [job.output for job in jobs if job.output is not None and is_float_map(job.output)]
    if maps and resume:
        raise InputError(f"resume must have .exr outputs, which hold digests, got {maps[0]}")
    if maps and layout.views:
        raise InputError(
            f"output must be an .exr file for the views {', '.join(layout.views)}, or --view must "
            f"choose one, got {maps[0]}"
        )


def _opened(name: str, options: ShotOptions) -> tuple[ModelInfo, Family]:
    """A model and its family; what it can never do is refused before a frame is run."""
    model = model_of(name)
    if options.ensemble != 1:
        model = with_overrides(model, ensemble=options.ensemble)
    family = family_of_model(model, options.providers)
    if options.aovs is not None and not family.traits.linear:
        raise InputError(
            f"aovs must not be given with {model.name}, which denoises the beauty alone"
        )
    return model, family


def _recipe(model: ModelInfo, precision: str, layout: Layout, options: ShotOptions) -> Recipe:
    """What goes into the files' provenance, and tells whether they are finished."""
    network = network_path(model, precision, options.providers)
    changing = {
        "temporal": options.temporal,
        "cuts": options.cuts and options.temporal,
        **layout.options(),
        **_unusual(precision, options.ensemble),
    }
    return Recipe(model=model.name, model_digest=file_digest(network), options=changing)


def _unusual(precision: str, ensemble: int) -> dict[str, str | int]:
    """What makes other pictures than a model does as it is, to be found in their recipe."""
    found: dict[str, str | int] = {}
    if precision != "float32":
        found["precision"] = precision
    if ensemble != 1:
        found["ensemble"] = ensemble
    return found


def _precision(model: ModelInfo, options: ShotOptions) -> str:
    """What every process of a run computes in: pictures of one shot have one rounding."""
    apart = options.scheduler is not None and options.precision == "auto"
    asked = "float32" if apart else options.precision
    return "float32" if network_path(model, asked, options.providers) == model.path else "int8"


def _state(name: str, model: ModelInfo, family: Family, layout: Layout) -> Path:
    """The file of a state; whether a model has one to keep is found out before frames are run."""
    if not isinstance(family, Keeps):
        raise InputError(f"state must be that of a model that learns as it runs, got {model.name}")
    if layout.views:
        raise InputError(f"state must be of one view, got {', '.join(layout.views)}")
    if not Path(name).absolute().parent.is_dir():
        raise InputError(f"{name}: the folder must exist")
    return Path(name)


def _memory(family: Family, options: ShotOptions, frames: int) -> int:
    """Frames that a history is taken to go back."""
    if not options.temporal:
        return 0
    if options.warm_up is not None:
        return options.warm_up
    memory = family.traits.memory
    return frames if memory is None else memory


def _as_progress(progress: Progress | Callable[[FrameReport], None] | None) -> Progress:
    if isinstance(progress, Progress):
        return progress
    return _Calls(progress or (lambda done: None))


class _Calls:
    """Progress of which a function is told the frames."""

    def __init__(self, function: Callable[[FrameReport], None]) -> None:
        self._function = function

    def motion(self, detection: Detection) -> None:
        pass

    def note(self, line: str) -> None:
        pass

    def wait(self, reason: str) -> None:
        pass

    def frame(self, done: FrameReport) -> None:
        self._function(done)

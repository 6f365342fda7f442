"""The way of one frame: from a renderer's buffers to a clean picture and the next history."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from numbers import Integral
from types import TracebackType

import numpy as np
from numpy.typing import DTypeLike

from stillray.arrays.encoding import Encoding, decoded, encoded, encoding_of
from stillray.arrays.strips import Strips, available_threads
from stillray.arrays.watch import Progress
from stillray.arrays.workspace import Workspace
from stillray.errors import InputError
from stillray.families.contract import Context, Engine, Family, Keeps, Layer, State
from stillray.families.registry import FAMILIES
from stillray.families.saved_state import read_arrays, write_arrays
from stillray.frame import Frame
from stillray.model_spec.loader import ModelSpec
from stillray.models.network import WatchedEngine
from stillray.models.registry import (
    DEFAULT_MODEL,
    ModelInfo,
    for_single_frames,
    with_overrides,
)
from stillray.models.session import Provider
from stillray.pipeline.layers import validated
from stillray.pipeline.opened import OpenedModel
from stillray.pipeline.opening import model_of
from stillray.pipeline.output import Target
from stillray.pipeline.plan import Asked, plan_frame, require_memory
from stillray.pipeline.prefilter import PREFILTER, foretold, prefilter_stages
from stillray.pipeline.tiles import check_memory
from stillray.pipeline.turns import Turns
from stillray.stages.plan import Plan, Stage
from stillray.stages.repair import repair_alpha
from stillray.timing import share_done, timed


class Denoiser:
    """A stream of frames through one model; holds the history between them.

    Parameters
    ----------
    model
        A quality (``"fast"``, ``"balanced"``, ``"high"``), a model's name, the path of an
        .onnx file, or what `stillray.models.registry.with_overrides` gives. The path of a frame
        graph, NAME.frame.onnx, runs all stages in that: on a device, with the state kept there.
    threads
        Threads to use, 1 or more, of which no more than this machine has processors are started;
        None for every processor that this process may use.
    providers
        ONNX Runtime execution providers: names, or names with their options; None for the CPU.
        They run the network, and of a frame graph all.
    temporal
        Whether frames are accumulated; without, each is denoised alone: a quality is then a model
        that has learned nothing else, ``"high"`` kpyr-5-still, and for frames that have neither
        albedo nor normals kpyr-5-color.
    max_memory
        Bytes that the process should stay below: larger frames are denoised in tiles, which
        takes longer and differs by rounding. None for whole frames.
    engine
        Where the network runs, instead of ONNX Runtime on ``threads`` and ``providers``.
    precision
        In what numbers: ``"float32"``; ``"int8"``, integers of 8 bits; ``"auto"``, those if the
        model has them and this processor multiplies them faster. Pictures differ by rounding: ask
        for one where several machines make a shot.
    ensemble
        How many pictures of a frame are averaged, for each of which the network sees it mirrored
        otherwise: the mean is better, and each takes about as long as the first. 1 to 4 with
        ``"high"``, ``"balanced"`` and ``"fast"``, 1 with models that cannot.

    Raises
    ------
    InputError
        Unknown model, provider, precision or number of threads, or too large an ensemble; or
        ``max_memory`` is no number.

    Examples
    --------
    >>> import numpy as np, stillray
    >>> with stillray.Denoiser("fast") as denoiser:
    ...     clean = denoiser.denoise(stillray.Frame(color=np.ones((4, 6, 3))))
    >>> clean.shape
    (4, 6, 3)
    """

    #: What makes a model of a specification, by the name of its family.
    families: Mapping[str, Callable[[ModelSpec], Family]] = FAMILIES

    def __init__(
        self,
        model: str | os.PathLike[str] | ModelInfo = DEFAULT_MODEL,
        *,
        threads: int | None = None,
        providers: Sequence[Provider] | None = None,
        temporal: bool = True,
        max_memory: int | None = None,
        engine: Engine | None = None,
        precision: str = "auto",
        ensemble: int = 1,
    ) -> None:
        threads = _checked_threads(threads)
        check_memory(max_memory)
        if not isinstance(temporal, bool):
            raise InputError(f"temporal must be True or False, got {temporal!r}")
        if isinstance(providers, str):
            raise InputError(f"providers must be a sequence of names, got the string '{providers}'")
        quality = model if isinstance(model, str) and not temporal else None
        if quality is not None:
            model = for_single_frames(quality)

        def opened(model: str | os.PathLike[str] | ModelInfo, given: Engine | None) -> OpenedModel:
            info = model_of(model)
            if ensemble != 1 or isinstance(ensemble, bool):
                info = with_overrides(info, ensemble=ensemble)
            return OpenedModel.of(
                info,
                threads=threads,
                providers=tuple(providers) if providers else None,
                precision=precision,
                engine=given,
                families=self.families,
            )

        self._opened = opened(model, engine)
        # of frames without guides: opened where one first comes
        self._unguided: OpenedModel | None = None
        self._open_unguided: Callable[[], OpenedModel] | None = None
        if quality is not None and engine is None:
            other = for_single_frames(quality, guided=False)
            if other != model:
                self._open_unguided = partial(opened, other, None)
        #: Whether frames are accumulated.
        self.temporal = temporal and self.model.spec.knows_past
        self.max_memory = max_memory
        #: Stage name to milliseconds, of the last frame; stages that did not run are absent.
        self.last_timings: dict[str, float] = {}
        self._turns = Turns()
        self._workspace = Workspace()
        self._strips = Strips(threads)
        self._state: State | None = None
        self._back_buffer: State | None = None  # what the next state may overwrite
        self._shared = False  # whether somebody may hold the current state

    def __enter__(self) -> Denoiser:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop the worker threads; an engine that was given stays open. May be called again.

        Raises
        ------
        InputError
            A frame is in work, on another thread or in whose ``progress`` this is.
        """
        self._turns.close()
        self._opened.close()
        if self._unguided is not None:
            self._unguided.close()
        self._strips.close()

    @property
    def model(self) -> ModelInfo:
        """The model; of a quality, that of frames with albedo or normals."""
        return self._opened.model

    @property
    def precision(self) -> str:
        """In what numbers its network computes, unless ``engine`` was given: ``"float32"`` or
        ``"int8"``.
        """
        return self._opened.precision

    @property
    def engine(self) -> Engine:
        """Where its network runs."""
        return self._opened.engine

    @engine.setter
    def engine(self, engine: Engine) -> None:
        self._opened.engine = engine

    @property
    def scale(self) -> int:
        """Pixels of the picture for one of the frame, along each axis."""
        return self._opened.family.traits.scale

    @property
    def state(self) -> State | None:
        """The past: a value that can be kept, and put back later; None before the first frame.

        While a frame is in work it is what was before that; one that is put back then, or after
        `close`, is refused with an `InputError`.
        """
        self._shared = True
        return self._state

    @state.setter
    def state(self, value: State | None) -> None:
        with self._turns.take():  # a frame in work would remember over it
            self._state, self._shared = value, True

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the past to a file, .npz of plain arrays, from which `load` goes on exactly.

        Raises
        ------
        InputError
            The model's past is not kept in files, or there is none, or the file cannot be written.
        """
        keeps = self._keeps()
        if self._state is None:
            raise InputError("state must be saved after a frame, got none yet")
        write_arrays(path, keeps.pack(self._state))

    def load(self, path: str | os.PathLike[str]) -> None:
        """Go on from what `save` wrote.

        Raises
        ------
        InputError
            The file is not one, or is of a model of another name; of files that hold no name, as
            they once did not, only the sizes are looked at. Or a frame is in work.
        """
        keeps = self._keeps()
        self.state = keeps.unpack(read_arrays(path))

    def _keeps(self) -> Keeps:
        family = self._opened.family
        if not isinstance(family, Keeps):
            raise InputError(
                f"state must be that of a model that learns while it denoises, got "
                f"{self.model.name}, whose past is made anew from a few frames"
            )
        return family

    def reset(self) -> None:
        """Forget the past: call it at a cut. What was learned from frames outlives cuts.

        Raises
        ------
        InputError
            A frame is in work, on another thread or in whose ``progress`` this is; or the denoiser
            is closed.
        """
        with self._turns.take():  # a frame in work would remember over it
            self._state = None if self._state is None else self._state.after_cut()

    def stages(self, frame: Frame, layers: Collection[str] = ()) -> list[Stage]:
        """What will run for this frame, and why; nothing but a look at its values is run.

        Parameters
        ----------
        frame
            The buffers.
        layers
            Names of other layers that are to be filtered, as `denoise_layers` takes them.

        Raises
        ------
        InputError
            As `denoise` and `denoise_layers`.
        """
        _require_frame(frame)
        with self._turns.take():
            opened = self._opened_for(frame)
            before, frame = foretold(frame, opened.model.spec)
            plan = self._plan(frame, layers, Context(strips=self._strips), opened)
            return [*before, *plan.stages]

    def denoise(
        self,
        frame: Frame,
        *,
        out: np.ndarray | None = None,
        dtype: DTypeLike | None = None,
        encoding: str = "hdr",
        denoise_alpha: bool = False,
        progress: Progress | None = None,
    ) -> np.ndarray:
        """Denoise the next frame.

        Parameters
        ----------
        frame
            The buffers. A frame of another size than the last starts a new history.
        out : (height * scale, width * scale, 3) float, optional
            Where the picture is put, strided or not; in half precision clamped to its range. Of 4
            channels where the frame has alpha.
        dtype
            Type of floats of the picture, if not float32; not with ``out``.
        encoding
            What the numbers of color are, and those of the picture: ``"hdr"``, scene-linear
            radiance; ``"ldr"``, linear in [0, 1]; ``"srgb"``, sRGB values in [0, 1];
            ``"signed"``, in [-1, 1]. What lies beyond a range is clipped.
        denoise_alpha
            Whether alpha is filtered as color is, or handed over as it was given. What is not
            finite is filled in from around, either way. It has a past of its own: where the frame
            before was denoised without, both begin a new history; ask for it from the first frame.
        progress
            Called in this thread with the share of the frame that is done, every few hundredths
            of a second, and with 1 when all is done. False ends the frame, also then: the history
            is as before the call, and part of the picture, or all, may be in ``out``. What it
            raises comes out likewise.

        Returns
        -------
        (height * scale, width * scale, 3) float32, or ``out``
            Scene-linear radiance: finite, >= 0; a mean of the accumulated irradiance of each
            window, since kernels cannot invent light, times a mean of the albedo around. With
            alpha ``(height, width, 4)``: finite, and where it was filtered in [0, 1].

        Raises
        ------
        InputError
            The frame does not fit into ``max_memory``, not even in tiles; an argument cannot be
            used; the denoiser is closed, or used elsewhere, see `stillray.pipeline.turns`.
        Cancelled
            ``progress`` returned False.
        """
        _require_frame(frame)
        channels, scale = 3 if frame.alpha is None else 4, self.scale
        height, width = (extent * scale for extent in frame.shape)
        if frame.alpha is not None and scale != 1:
            raise InputError(f"alpha must not be given with {self.model.name}, which enlarges")
        if frame.alpha is None and denoise_alpha:
            raise InputError("denoise_alpha must be False for a frame without alpha, got True")
        target = Target.of(out, dtype, (height, width, channels))
        values = encoding_of(encoding)
        with self._turn(progress, frame) as opened:
            if values is not Encoding.HDR:
                frame = replace(frame, color=decoded(frame.color, values, self._strips))
            alpha = None if frame.alpha is None else repair_alpha(frame.alpha, self._strips)
            layers = {}
            if denoise_alpha and alpha is not None:
                layers["alpha"] = _grey(alpha, self._strips)
            image, filtered, state = self._frame(frame, layers, opened)
            image = encoded(image, values, self._strips)
            if denoise_alpha:
                alpha = np.clip(filtered["alpha"][..., 0], 0, 1)
            image = target.put(image, alpha, self._strips)
            self._remember(state)
        return image

    def denoise_layers(
        self,
        frame: Frame,
        layers: Mapping[str, np.ndarray],
        *,
        irradiance: Collection[str] = (),
        progress: Progress | None = None,
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Denoise the next frame, and filter other layers of it exactly as its color.

        Layers that add up to the color, such as diffuse and specular or groups of lights, add up
        to the denoised color, to float rounding; but not where color was negative and taken for 0.

        Parameters
        ----------
        frame
            The buffers, as for `denoise`.
        layers
            Name to ``(height, width, 3)`` radiance, of any sign; not finite counts as 0. The same
            names in every frame: others than in the last frame start a new history.
        irradiance
            Names of layers that are without the colour of surfaces, as Blender's diffuse direct
            light: filtered as they are, where the others are divided by albedo meanwhile.
        progress
            As `denoise` takes it.

        Returns
        -------
        image : (height, width, 3) float32
            As `denoise` gives it, without alpha.
        layers
            By name: ``(height, width, 3)`` float32, finite.

        Raises
        ------
        InputError
            As `denoise`; or a layer has a wrong shape or type.
        Cancelled
            ``progress`` returned False.
        """
        _require_frame(frame)
        given = {
            name: Layer(radiance=layer, irradiance=name in irradiance)
            for name, layer in validated(layers, frame).items()
        }
        with self._turn(progress, frame) as opened:
            image, filtered, state = self._frame(frame, given, opened)
            self._remember(state)
        return image, filtered

    @contextmanager
    def _turn(self, progress: Progress | None, frame: Frame) -> Iterator[OpenedModel]:
        """A frame's turn, looked at; gives the model that denoises it."""
        if progress is not None and not callable(progress):
            raise InputError(f"progress must be something to call, or None, got {progress!r}")
        with self._turns.take():
            before, self.last_timings = self.last_timings, {}
            watch, opened = self._strips.watch, self._opened_for(frame)
            if progress is not None:
                opened = replace(opened, engine=WatchedEngine(opened.engine, watch))
            with watch.over(progress, partial(share_done, self.last_timings, before)):
                yield opened

    def _opened_for(self, frame: Frame) -> OpenedModel:
        """The model that denoises a frame: there may be one that learned without its guides."""
        if self._open_unguided is None or frame.guided:
            return self._opened
        if self._unguided is None:
            self._unguided = self._open_unguided()
        return self._unguided

    def _frame(
        self,
        frame: Frame,
        layers: Mapping[str, Layer],
        opened: OpenedModel,
    ) -> tuple[np.ndarray, dict[str, np.ndarray], State]:
        """The picture, layers by name, and what is to be remembered."""
        context = Context(
            strips=self._strips,
            engine=opened.engine,
            workspace=self._workspace,
            timings=self.last_timings,
            back_buffer=self._back_buffer,
        )
        first = prefilter_stages(frame, opened.model.spec)
        if opened.prefilter is not None and any(stage.runs for stage in first):
            asked = self._asked(layers, opened)
            require_memory(frame, opened.family, asked)  # more than a prefilter's
            with timed(self.last_timings, PREFILTER):
                frame = opened.prefilter.denoised(frame, context, self.max_memory)
        step = opened.family.step(self._plan(frame, layers, context, opened), context)
        images: dict[str, np.ndarray] = {}
        if step.filter_layer is not None:
            with timed(self.last_timings, "layers"):
                for name, layer in layers.items():
                    images[name] = step.filter_layer(name, layer)
        return step.image, images, step.finish()

    def _plan(
        self, frame: Frame, layers: Collection[str], context: Context, opened: OpenedModel
    ) -> Plan:
        asked = self._asked(layers, opened)
        return plan_frame(frame, self._state, opened.family, asked, context)

    def _asked(self, layers: Collection[str], opened: OpenedModel) -> Asked:
        return Asked(
            model=opened.model.name,
            temporal=self.temporal,
            layers=layers,
            max_memory=self.max_memory,
            integers=opened.precision == "int8",
        )

    def _remember(self, state: State) -> None:
        self._strips.watch.last()  # first: a frame that is not wanted leaves no trace
        # two states change places, unless somebody may still look at the older
        self._back_buffer = None if self._shared else self._state
        self._state, self._shared = state, False
        if not self.temporal:
            self._state, self._back_buffer = None, state


def _grey(alpha: np.ndarray, strips: Strips) -> Layer:
    """Alpha as a layer, in its range: else one wrong pixel would cover all that a kernel sees."""
    layer = np.empty((*alpha.shape, 3), np.float32)

    def work(rows: slice) -> None:
        layer[rows] = np.clip(alpha[rows], 0, 1)[..., None]

    strips.run(work, *layer.shape[:2])
    return Layer(radiance=layer, irradiance=True, is_light=False)


def _require_frame(frame: object) -> None:
    if not isinstance(frame, Frame):
        kind = type(frame).__name__
        raise InputError(f"frame must be a stillray.Frame, as Frame(color=...), got {kind}")


def _checked_threads(threads: int | None) -> int:
    if threads is None:
        return available_threads()
    if isinstance(threads, bool) or not isinstance(threads, Integral) or threads < 1:
        raise InputError(f"threads must be an integer, 1 or more, got {threads!r}")
    return min(int(threads), max(os.cpu_count() or 1, available_threads()))


def denoise(
    color: np.ndarray,
    albedo: np.ndarray | None = None,
    normal: np.ndarray | None = None,
    *,
    depth: np.ndarray | None = None,
    samples: float | np.ndarray | None = None,
    filter_spread: float | None = None,
    clean_features: bool = False,
    model: str | os.PathLike[str] | ModelInfo = DEFAULT_MODEL,
    threads: int | None = None,
    ensemble: int = 1,
) -> np.ndarray:
    """Denoise one image.

    Parameters
    ----------
    color : (h, w, 3)
        Noisy scene-linear radiance.
    albedo, normal : (h, w, 3), optional
        Features; each makes the result better.
    depth : (h, w), optional
        Camera z or distance.
    samples : number or (h, w), optional
        Samples a pixel of color, see `Frame`.
    filter_spread : number, optional
        Standard deviation of the renderer's pixel filter, in pixels, see `Frame`.
    clean_features
        Whether the albedo has no noise, see `Frame`.
    model, threads, ensemble
        As `Denoiser`'s.

    Returns
    -------
    (h, w, 3) float32

    Raises
    ------
    InputError
        A buffer or the model cannot be used.
    """
    frame = Frame(
        color=color,
        albedo=albedo,
        normal=normal,
        depth=depth,
        samples=samples,
        filter_spread=filter_spread,
        clean_features=clean_features,
    )
    if isinstance(model, str):  # the only one that is opened
        model = for_single_frames(model, guided=frame.guided)
    with Denoiser(model, threads=threads, temporal=False, ensemble=ensemble) as denoiser:
        return denoiser.denoise(frame)

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
from stillray.families.contract import Context, Engine, Family, Keeps, Layer, Request, State
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
from stillray.pipeline.opening import engine_of_model, family_of_model, model_of, network_path
from stillray.pipeline.output import Target
from stillray.pipeline.tiles import plan_tiles
from stillray.pipeline.turns import Turns
from stillray.stages.plan import Plan, Stage
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
        Whether frames are accumulated; without, each is denoised alone: ``"high"`` is then a model
        that has learned nothing else, kpyr-5-still or kpyr-5s-still.
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
        Unknown model, provider, precision or number of threads, or too large an ensemble.

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
        if isinstance(providers, str):
            raise InputError(f"providers must be a sequence of names, got the string '{providers}'")
        chosen = tuple(providers) if providers else None
        if isinstance(model, str) and not temporal:
            model = for_single_frames(model)
        self.model = model_of(model)
        if ensemble != 1:
            self.model = with_overrides(self.model, ensemble=ensemble)
        #: Whether frames are accumulated.
        self.temporal = temporal and not self.model.spec.training.alone
        self.max_memory = max_memory
        #: Stage name to milliseconds, of the last frame; stages that did not run are absent.
        self.last_timings: dict[str, float] = {}
        self._family = family_of_model(self.model, chosen, self.families)
        network = network_path(self.model, precision, chosen)
        #: In what numbers the network computes, unless ``engine`` was given: ``"float32"`` or
        #: ``"int8"``.
        self.precision = "float32" if network == self.model.path else "int8"
        #: Where the network runs.
        self.engine: Engine = engine or engine_of_model(self.model, threads, chosen, network)
        self._owns_engine = engine is None
        self._turns = Turns()
        self._strips = Strips(threads)
        self._workspace = Workspace()
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
        """Stop the worker threads; an engine that was given stays open. May be called again."""
        self._turns.close()
        if self._owns_engine:
            self.engine.close()
        self._strips.close()

    @property
    def scale(self) -> int:
        """Pixels of the picture for one of the frame, along each axis."""
        return self._family.traits.scale

    @property
    def state(self) -> State | None:
        """The past: a value that can be kept, and put back later; None before the first frame."""
        self._shared = True
        return self._state

    @state.setter
    def state(self, value: State | None) -> None:
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
            they once did not, only the sizes are looked at.
        """
        keeps = self._keeps()
        self.state = keeps.unpack(read_arrays(path))

    def _keeps(self) -> Keeps:
        if not isinstance(self._family, Keeps):
            raise InputError(
                f"state must be that of a model that learns while it denoises, got "
                f"{self.model.name}, whose past is made anew from a few frames"
            )
        return self._family

    def reset(self) -> None:
        """Forget the past: call it at a cut. What was learned from frames outlives cuts."""
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
        with self._turns.take():
            return list(self._plan(frame, layers, Context(strips=self._strips)).stages)

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
            Whether alpha is filtered as color is, or handed over as it was given.
        progress
            Called in this thread with the share of the frame that is done, every few hundredths
            of a second. False ends the frame: the history is then as before the call, and part
            of the picture may be in ``out``.

        Returns
        -------
        (height * scale, width * scale, 3) float32, or ``out``
            Scene-linear radiance: finite, >= 0; a mean of the accumulated irradiance of each
            window, since kernels cannot invent light, times a mean of the albedo around. With
            alpha ``(height, width, 4)``.

        Raises
        ------
        InputError
            The frame does not fit into ``max_memory``, not even in tiles; an argument cannot be
            used; the denoiser is closed, or used elsewhere, see `stillray.pipeline.turns`.
        Cancelled
            ``progress`` returned False.
        """
        channels, scale = 3 if frame.alpha is None else 4, self.scale
        height, width = (extent * scale for extent in frame.shape)
        if frame.alpha is not None and scale != 1:
            raise InputError(f"alpha must not be given with {self.model.name}, which enlarges")
        if frame.alpha is None and denoise_alpha:
            raise InputError("denoise_alpha must be False for a frame without alpha, got True")
        target = Target.of(out, dtype, (height, width, channels))
        values = encoding_of(encoding)
        with self._turn(progress) as engine:
            if values is not Encoding.HDR:
                frame = replace(frame, color=decoded(frame.color, values, self._strips))
            layers = {"alpha": _grey(frame.alpha, self._strips)} if denoise_alpha else {}
            image, filtered, state = self._frame(frame, layers, engine)
            image = encoded(image, values, self._strips)
            alpha = np.clip(filtered["alpha"][..., 0], 0, 1) if denoise_alpha else frame.alpha
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
            A layer has a wrong shape or type.
        Cancelled
            ``progress`` returned False.
        """
        given = {
            name: Layer(radiance=layer, irradiance=name in irradiance)
            for name, layer in validated(layers, frame).items()
        }
        with self._turn(progress) as engine:
            image, filtered, state = self._frame(frame, given, engine)
            self._remember(state)
        return image, filtered

    @contextmanager
    def _turn(self, progress: Progress | None) -> Iterator[Engine]:
        """A frame's turn, looked at; gives what runs networks."""
        with self._turns.take():
            before, self.last_timings = self.last_timings, {}
            watch = self._strips.watch
            with watch.over(progress, partial(share_done, self.last_timings, before)):
                yield self.engine if progress is None else WatchedEngine(self.engine, watch)
            if progress is not None:
                progress(1.0)

    def _frame(
        self,
        frame: Frame,
        layers: Mapping[str, Layer],
        engine: Engine,
    ) -> tuple[np.ndarray, dict[str, np.ndarray], State]:
        """The picture, layers by name, and what is to be remembered."""
        context = Context(
            strips=self._strips,
            engine=engine,
            workspace=self._workspace,
            timings=self.last_timings,
            back_buffer=self._back_buffer,
        )
        step = self._family.step(self._plan(frame, layers, context), context)
        images: dict[str, np.ndarray] = {}
        if step.filter_layer is not None:
            with timed(self.last_timings, "layers"):
                for name, layer in layers.items():
                    images[name] = step.filter_layer(name, layer)
        return step.image, images, step.finish()

    def _plan(self, frame: Frame, layers: Collection[str], context: Context) -> Plan:
        traits = self._family.traits
        if missing := sorted(traits.required - frame.given):
            how = _HOW.get(missing[0], "")
            raise InputError(
                f"{self.model.name} needs the buffer {missing[0]}, which is not given{how}"
            )
        tiles = plan_tiles(frame.shape, traits, self.max_memory, self.model.name)
        if layers and not traits.linear:
            raise InputError(f"layers must be none with {self.model.name}, got {', '.join(layers)}")
        if layers and len(tiles) > 1:
            raise InputError(
                f"max-memory must hold the whole frame where other layers are filtered too, got "
                f"{self.max_memory} bytes for {frame.shape[1]} x {frame.shape[0]} pixels"
            )
        request = Request(
            temporal=self.temporal, layers=frozenset(layers), tiles=tuple(tiles[1:] and tiles)
        )
        return self._family.plan(frame, self._state, request, context)

    def _remember(self, state: State) -> None:
        # two states change places, unless somebody may still look at the older
        self._back_buffer = None if self._shared else self._state
        self._state, self._shared = state, False
        if not self.temporal:
            self._state, self._back_buffer = None, state


#: How a buffer that is missing comes about, where that is not plain.
_HOW = {"color_b": ": render the same frame again with another seed (--color-b)"}


def _grey(alpha: np.ndarray | None, strips: Strips) -> Layer:
    """Alpha as a layer."""
    assert alpha is not None
    given, layer = alpha, np.empty((*alpha.shape, 3), np.float32)

    def work(rows: slice) -> None:
        layer[rows] = np.nan_to_num(given[rows])[..., None]

    strips.run(work, *layer.shape[:2])
    return Layer(radiance=layer, irradiance=True, shaded=False)


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
    )
    with Denoiser(model, threads=threads, temporal=False, ensemble=ensemble) as denoiser:
        return denoiser.denoise(frame)

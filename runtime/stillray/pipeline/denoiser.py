"""The way of one frame: from a renderer's buffers to a clean picture and the next history."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from types import TracebackType

import numpy as np

from stillray.arrays.strips import Strips, available_threads
from stillray.arrays.workspace import Scratch
from stillray.errors import InputError
from stillray.families.registry import FAMILIES
from stillray.frame import Frame
from stillray.model_spec.loader import ModelSpec
from stillray.models.registry import ModelInfo, find_model
from stillray.models.session import Network
from stillray.pipeline import layers as aovs
from stillray.pipeline import plan as stages
from stillray.pipeline.tiles import Tile, crop, plan_tiles
from stillray.stages import features as encode
from stillray.stages import previous_output as recall
from stillray.stages.prepare import History, LayerPast, Prepared, prepare
from stillray.timing import timed


class Denoiser:
    """A stream of frames through one model; holds the history between them.

    Parameters
    ----------
    model
        A quality (``"fast"``, ``"balanced"``, ``"high"``), a model's name, the path of an
        .onnx file, or what `stillray.models.registry.tuned` gives.
    threads
        Threads to use, 1 or more; None for every processor that this process may use.
    providers
        ONNX Runtime execution providers; None for the CPU.
    temporal
        Whether frames are accumulated; without, each is denoised alone.
    max_memory
        Bytes that the process should stay below: larger frames are denoised in tiles, which
        takes longer and differs by rounding. None for whole frames.

    Raises
    ------
    InputError
        Unknown model, provider or number of threads.

    Examples
    --------
    >>> import numpy as np, stillray
    >>> with stillray.Denoiser("fast") as denoiser:
    ...     clean = denoiser.denoise(stillray.Frame(color=np.ones((4, 6, 3))))
    >>> clean.shape
    (4, 6, 3)
    """

    def __init__(
        self,
        model: str | os.PathLike[str] | ModelInfo = "balanced",
        *,
        threads: int | None = None,
        providers: Sequence[str] | None = None,
        temporal: bool = True,
        max_memory: int | None = None,
    ) -> None:
        if threads is not None and threads < 1:
            raise InputError(f"threads must be 1 or more, got {threads}")
        threads = threads or available_threads()
        self.model = model if isinstance(model, ModelInfo) else find_model(model)
        self.temporal = temporal
        self.max_memory = max_memory
        self._history: History | None = None
        #: Stage name to milliseconds, of the last frame; stages that did not run are absent.
        self.last_timings: dict[str, float] = {}
        self._network = Network(
            self.model.path, threads=threads, providers=tuple(providers) if providers else None
        )
        self._strips = Strips(threads)
        self._kept = Scratch()
        self._spare: History | None = None  # what the next history may overwrite
        self._lent = False  # whether somebody may hold the current history

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
        """Stop the worker threads."""
        self._network.close()
        self._strips.close()

    @property
    def history(self) -> History | None:
        """The past: a value that can be kept, and put back later; None before the first frame."""
        self._lent = True
        return self._history

    @history.setter
    def history(self, value: History | None) -> None:
        self._history, self._lent = value, True

    def reset(self) -> None:
        """Forget the past: call it at a cut."""
        self._history = None

    def stages(self, frame: Frame) -> list[stages.Stage]:
        """What will run for this frame, and why; nothing is run."""
        past = self._history
        same_size = past is not None and past.mean.shape[:2] == frame.shape
        return stages.plan(
            frame,
            self.model.spec,
            has_history=same_size,
            temporal=self.temporal,
            had_albedo=past is not None and past.divisor is not None,
        )

    def denoise(self, frame: Frame) -> np.ndarray:
        """Denoise the next frame.

        Parameters
        ----------
        frame
            The buffers. A frame of another size than the last starts a new history.

        Returns
        -------
        (height, width, 3) float32
            Scene-linear radiance: finite, >= 0; a mean of the accumulated irradiance of each
            window, since kernels cannot invent light, times a mean of the albedo around.

        Raises
        ------
        InputError
            The frame does not fit into ``max_memory``, not even in tiles.
        """
        return self._run(frame, {})[0]

    def denoise_layers(
        self,
        frame: Frame,
        layers: Mapping[str, np.ndarray],
        *,
        irradiance: Collection[str] = (),
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

        Returns
        -------
        image : (height, width, 3) float32
            As `denoise` gives it.
        layers
            By name: ``(height, width, 3)`` float32, finite.

        Raises
        ------
        InputError
            A layer has a wrong shape or type.
        """
        return self._run(frame, aovs.validated(layers, frame), irradiance)

    def _run(
        self, frame: Frame, layers: Mapping[str, np.ndarray], irradiance: Collection[str] = ()
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        self.last_timings = {}
        spec = self.model.spec
        tiles = plan_tiles(frame.shape, spec, self.max_memory)
        if layers and len(tiles) > 1:
            raise InputError(
                f"max-memory must hold the whole frame where other layers are filtered too, got "
                f"{self.max_memory} bytes for {frame.shape[1]} x {frame.shape[0]} pixels"
            )
        family = FAMILIES[spec.family]
        history = self._history if self.temporal else None
        # a layer without a past would not add up with those that have one
        if history is not None and layers and history.layers.keys() != layers.keys():
            history = None
        if history is not None and history.mean.shape[:2] != frame.shape:
            history = None
        prepared = prepare(
            frame,
            spec,
            history,
            self._strips,
            self.last_timings,
            temporal=self.temporal,
            wants_sample=family.renews or bool(layers),
            recalls=family.recalls,
            kept=self._kept,
            spare=self._spare,
        )
        previous: np.ndarray | None = None
        if family.recalls and self.temporal:
            previous = recall.recalled(
                history, prepared, spec, self._strips, self.last_timings, self._kept
            )
        images: dict[str, np.ndarray] = {}
        pasts: dict[str, LayerPast] = {}
        if len(tiles) == 1:
            image, outputs = self._filter(prepared, previous)
        else:
            image = self._filter_tiles(prepared, previous, tiles)
        if layers:
            with timed(self.last_timings, "layers"):
                images, pasts = aovs.filter_layers(
                    layers, frame, prepared, history, outputs, spec, family, self._strips,
                    irradiance=irradiance, temporal=self.temporal,
                )  # fmt: skip
        output: np.ndarray | None = None
        if family.recalls and self.temporal:
            output = recall.remember(image, self._strips, self._spare)
        self._remember(replace(prepared.history, output=output, layers=pasts))
        return image, images

    def _filter_tiles(
        self, prepared: Prepared, previous: np.ndarray | None, tiles: list[Tile]
    ) -> np.ndarray:
        image = np.empty((*prepared.luminance.shape, 3), np.float32)
        for tile in tiles:
            past = None if previous is None else np.ascontiguousarray(previous[tile.outer])
            image[tile.inner] = self._filter(crop(prepared, tile), past)[0][tile.within]
        return image

    def _filter(
        self, prepared: Prepared, previous: np.ndarray | None
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """The picture, and what the network gave for it."""
        spec = self.model.spec
        features = self._encode(spec, prepared, previous)
        with timed(self.last_timings, "network"):
            outputs = self._network.run(features)
        image = FAMILIES[spec.family].reconstruct(
            prepared, previous, outputs, spec, self._strips, self.last_timings
        )
        return image, outputs

    def _remember(self, history: History) -> None:
        # two histories change places, unless somebody may still look at the older
        self._spare = None if self._lent else self._history
        self._history, self._lent = history, False
        if not self.temporal:
            self._history, self._spare = None, history

    def _encode(
        self, spec: ModelSpec, prepared: Prepared, previous: np.ndarray | None
    ) -> np.ndarray:
        height, width = prepared.luminance.shape
        multiple = FAMILIES[spec.family].multiple(spec)
        full = (-(-height // multiple) * multiple, -(-width // multiple) * multiple)
        features_nchw = self._kept.array("features", (1, len(spec.network.features), *full))
        mean, normal, depth = prepared.history.mean, prepared.normal, prepared.depth

        def pack(rows: slice) -> None:
            planes = features_nchw[0, :, rows, :width]
            encode.feature_planes(
                mean[rows],
                prepared.local[rows],
                prepared.history.exposure,
                spec.temporal,
                spec.network.features,
                sample=prepared.luminance[rows],
                albedo=None if prepared.albedo is None else prepared.albedo[rows],
                normal=None if normal is None else normal[rows],
                depth=None if depth is None else depth[rows],
                depth_unit=prepared.depth_unit,
                out=planes,
                scratch=self._strips.scratch,
            )
            encode.previous_planes(
                None if previous is None else previous[rows],
                None if prepared.modulator is None else prepared.modulator[rows],
                prepared.history.exposure,
                spec.network.features,
                out=planes,
                scratch=self._strips.scratch,
            )

        with timed(self.last_timings, "encode"):
            self._strips.run(pack, height, width)
            # to a multiple by repeating the last column and row
            features_nchw[..., :height, width:] = features_nchw[..., :height, width - 1 : width]
            features_nchw[..., height:, :] = features_nchw[..., height - 1 : height, :]
        return features_nchw


def denoise(
    color: np.ndarray,
    albedo: np.ndarray | None = None,
    normal: np.ndarray | None = None,
    *,
    depth: np.ndarray | None = None,
    quality: str | os.PathLike[str] = "balanced",
    threads: int | None = None,
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
    quality
        As `Denoiser`'s ``model``.
    threads
        As `Denoiser`'s.

    Returns
    -------
    (h, w, 3) float32

    Raises
    ------
    InputError
        A buffer or the model cannot be used.
    """
    with Denoiser(quality, threads=threads, temporal=False) as denoiser:
        return denoiser.denoise(Frame(color=color, albedo=albedo, normal=normal, depth=depth))

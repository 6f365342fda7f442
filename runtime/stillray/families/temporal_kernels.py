"""The step that families of kernels share: accumulate the past, ask the network, filter.

A family adds how its network's outputs filter what was accumulated (`TemporalKernels.reconstruct`)
and how far that looks.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np

from stillray.arrays.strips import Strips
from stillray.arrays.tiles import Tile
from stillray.arrays.watch import Watch
from stillray.families.contract import Context, Request, State, Step, Traits
from stillray.families.layer_filter import FilteredLayers, Outputs, Shading
from stillray.families.network_input import NetworkInput
from stillray.families.views import VIEWS, View, mean_picture
from stillray.frame import Frame
from stillray.model_spec.loader import ModelSpec
from stillray.models.steps import in_numbers
from stillray.stages import features, lamps, previous_output, rare_light, relief, texture
from stillray.stages.decide import TemporalPlan, Wants, decide
from stillray.stages.means import Means
from stillray.stages.plan import Plan, Stage
from stillray.stages.prepare import prepare_planned
from stillray.stages.put_back import put_back
from stillray.stages.recall import Compared, Recall, believed
from stillray.stages.sample_counts import SampleCounts, mean_samples
from stillray.stages.state import Filterable, History, Prepared, filterable
from stillray.timing import timed

#: Frames that a frame's history is taken to go back; measured, see docs/decisions.md.
MEMORY_FRAMES = 32


@dataclass(frozen=True, kw_only=True)
class Looks:
    """What kernels look at.

    Attributes
    ----------
    reach
        Pixels from which light can come to a pixel, to each side, in one frame.
    receptive_field
        Pixels that one output of the network looks to each side; None where a frame cannot be cut
        into tiles, because what it is built from spans all of it.
    alignment
        Height and width of the network's input must be multiples of this, pixels.
    sample
        Whether this frame's own sample is used beside what was accumulated.
    previous_output
        Whether the previous output is used, and remodulation done before it is.
    sharp
        Whether the previous output is resampled by cubic convolution.
    """

    reach: int
    receptive_field: int | None
    alignment: int = 1
    sample: bool = False
    previous_output: bool = False
    sharp: bool = False

    @property
    def overlap(self) -> int | None:
        """Pixels that a pixel of the result can see, to each side, rounded up to whole blocks."""
        if self.receptive_field is None:
            return None
        return -(-(self.reach + self.receptive_field) // self.alignment) * self.alignment


class TemporalKernels(ABC):
    """A model that filters what was accumulated by kernels that its network chose.

    Parameters
    ----------
    spec
        The model's specification.
    looks
        What the kernels look at.
    """

    def __init__(self, spec: ModelSpec, looks: Looks) -> None:
        self.spec, self.looks, self.sharp = spec, looks, looks.sharp
        self.traits = Traits(
            required=frozenset(spec.inputs.required),
            optional=frozenset(spec.inputs.optional),
            tile_alignment=looks.alignment,
            tile_overlap=looks.overlap,
            memory=MEMORY_FRAMES if spec.knows_past else 0,
            integers=self.takes_integers,
            views=self.ensemble,
        )

    #: What the reconstruction does, in a few words.
    method: str
    #: Operations and float32 planes moved by the reconstruction, a pixel.
    cost: tuple[float, float]
    #: See `Traits.integers`.
    takes_integers = False
    #: Views of a frame whose pictures are averaged; more than one where there is `seen_from`.
    ensemble = 1

    @abstractmethod
    def reconstruct(
        self,
        light: Filterable,
        outputs: Outputs,
        strips: Strips,
        timings: dict[str, float],
    ) -> np.ndarray:
        """The radiance ``(h, w, 3)`` of what was accumulated, filtered and remodulated.

        Parameters
        ----------
        light
            What is filtered.
        outputs
            Of the network, without their batch axis.
        strips
            Where the work runs.
        timings
            ``"reconstruct"``, and ``"remodulate"`` where that is a pass of its own.
        """

    def seen_from(self, view: View, outputs: Outputs, strips: Strips, name: str) -> list[Any]:
        """The network's outputs for a frame, of those for what a view of it is.

        They lie in the workspace of this thread, by a name of their own.
        """
        raise NotImplementedError

    def frozen(self, light: Filterable, outputs: Outputs, strips: Strips) -> Outputs:
        """Outputs by which other layers are filtered as a frame's light was.

        The same, where the outputs say it all, whatever light they meet.
        """
        return outputs

    def recall(self, counts: SampleCounts) -> Recall | None:
        """By what a frame takes of the past; None: as the network says."""
        return None

    def wants(self, request: Request) -> Wants:
        """What is wanted of the stages before the network."""
        return Wants(
            temporal=request.temporal,
            sample=self.looks.sample or bool(request.layers),
            previous_output=self.looks.previous_output and request.temporal,
            layers=request.layers,
        )

    def plan(
        self, frame: Frame, before: State | Plan | None, request: Request, context: Context
    ) -> KernelPlan:
        """Decide what runs for a frame, and why; see `Family`."""
        past = before.before_network if isinstance(before, KernelPlan) else history_of(before)
        wants = self.wants(request)
        early = decide(frame, self.spec, past, context.strips, context.timings, wants)
        return KernelPlan(
            stages=(*early.stages, *self._later(frame, request, early)),
            before_network=early,
            tiles=request.tiles,
        )

    def _later(self, frame: Frame, request: Request, early: TemporalPlan) -> list[Stage]:
        modulates = frame.albedo is not None and not self.looks.previous_output
        why = "albedo is given" if frame.albedo is not None else "no albedo given"
        if frame.albedo is not None and not modulates:
            why = "the reconstruction does it, before it resolves"
        layers = len(request.layers)
        remembers = request.temporal and self.looks.previous_output
        why_remember = "the next frame looks at this one's output"
        if not remembers:
            why_remember = "no next frame looks at this one's output"
        return [
            Stage("encode", True, f"{len(self.spec.network.features)} planes for the network"),
            Stage("network", True, self.spec.name + _views_told(self.ensemble)),
            Stage("reconstruct", True, self.method),
            Stage("upscale", False, "the model's scale is 1"),
            Stage("remodulate", modulates, why),
            *self._relief(frame),
            *self._texture(early),
            *put_back(self.spec.lamps, self.spec.rare_light),
            Stage("layers", layers > 0, f"{layers} other layers" if layers else "none are given"),
            Stage("keep_output", remembers, why_remember),
        ]

    def _relief(self, frame: Frame) -> list[Stage]:
        if not self.spec.relief.window:
            return []
        if frame.normal is None:
            return [Stage("relief", False, "no normal given")]
        return [Stage("relief", True, "what was filtered away is shaded again, as normals tell")]

    def _texture(self, early: TemporalPlan) -> list[Stage]:
        if not self.spec.texture.window:
            return []
        if early.buffers.albedo is None:
            return [Stage("texture", False, "no albedo given")]
        before = None if early.past is None else early.past.frame_samples
        samples = mean_samples(early.buffers.samples, before)
        if samples is None or samples < texture.FEWEST_SAMPLES:
            few = f"of {texture.FEWEST_SAMPLES:g} samples a pixel and more, where they are told"
            return [Stage("texture", False, few)]
        return [Stage("texture", True, "what was filtered away is put back, as albedo tells")]

    def step(self, plan: Plan, context: Context) -> Step:
        """Run a frame as it was planned; see `Family`."""
        assert isinstance(plan, KernelPlan)
        early = plan.before_network
        prepared, previous = self.prepare(plan, context)
        outputs: list[list[Any]] = []
        if len(plan.tiles) > 1:
            image = self._tiled(prepared, previous, plan.tiles, context)
        else:
            keep = outputs if plan.runs("layers") else None
            image = self._picture(prepared, previous, context, keep)
        shading = self._shading(plan, image, prepared, context)
        layers: FilteredLayers | None = None
        if outputs:
            layers = FilteredLayers(self, early, prepared, outputs, shading, context)

        def finish() -> State:
            return self._remember(plan, prepared, (image, shading), layers, context)

        return Step(image=image, finish=finish, filter_layer=layers)

    def _shading(
        self, plan: KernelPlan, image: np.ndarray, prepared: Prepared, context: Context
    ) -> Shading:
        """What is put back into a picture, which is changed."""
        gain: np.ndarray | None = None
        textured: np.ndarray | None = None
        restored: tuple[lamps.Restored, np.ndarray] | None = None
        rare: np.ndarray | None = None
        strips, workspace = context.strips, context.workspace
        weights: np.ndarray | None = None
        if plan.runs("relief"):
            if plan.runs("texture"):
                weights = workspace.array("surface weights", image.shape[:2])
            window = self.spec.relief.window
            with timed(context.timings, "relief"):
                gain = relief.shade(image, prepared, window, strips, workspace, weights)
        if plan.runs("texture"):
            with timed(context.timings, "texture"):
                textured = texture.put_back(image, prepared, self.spec, weights, strips, workspace)
        if plan.runs("lamps"):
            with timed(context.timings, "lamps"):
                restored = lamps.restore(image, prepared, strips, workspace)
        if plan.runs("rare_light"):
            color, exposure = plan.before_network.buffers.color, prepared.history.exposure
            with timed(context.timings, "rare_light"):
                rare = rare_light.restore(image, color, exposure, strips, workspace)
            if rare is not None and restored is not None:
                found, before = restored
                before *= found.of(rare)[..., None]
        return Shading(gain=gain, texture=textured, restored=restored, rare=rare)

    def prepare(self, plan: KernelPlan, context: Context) -> tuple[Prepared, np.ndarray | None]:
        """A frame as it is before the network, and the previous output at its pixels."""
        early = plan.before_network
        means = Means(
            spec=self.spec,
            strips=context.strips,
            timings=context.timings,
            workspace=context.workspace,
            back_buffer=history_of(context.back_buffer),
        )
        prepared = prepare_planned(early, means)
        if not plan.runs("resample_output") or early.past is None:
            return prepared, None
        with timed(context.timings, "resample_output"):
            previous = previous_output.resampled(
                early.past, prepared, context.strips, context.workspace, sharp=self.looks.sharp
            )
            recall = self.recall(prepared.counts)
            if previous is not None and recall is not None:
                prepared = recalling(recall, prepared, previous, early.buffers.color, context)
        return prepared, previous

    def _tiled(
        self,
        prepared: Prepared,
        previous: np.ndarray | None,
        tiles: Sequence[Tile],
        context: Context,
    ) -> np.ndarray:
        image = np.empty((*prepared.luminance.shape, 3), np.float32)
        for tile in tiles:
            past = None if previous is None else np.ascontiguousarray(previous[tile.outer])
            part = crop(prepared, tile, context.strips.watch)
            found = self._picture(part, past, context)
            image[tile.inner] = found[tile.within]
        return image

    def _picture(
        self,
        prepared: Prepared,
        previous: np.ndarray | None,
        context: Context,
        keep: list[list[Any]] | None = None,
    ) -> np.ndarray:
        """A prepared frame's radiance; what the network says of each view of it is put in a list.

        No two views' outputs are held at a time unless they are kept.
        """
        light = filterable(prepared, previous)
        planes = self._encode(prepared, previous, context)

        def pictures() -> Iterator[np.ndarray]:
            for index, view in enumerate(VIEWS[: self.ensemble]):
                place = "a view" if keep is None else f"view {index}"
                outputs = self._outputs(planes, view, context, place)
                if keep is not None:
                    keep.append(outputs)
                yield self.reconstruct(light, outputs, context.strips, context.timings)

        return mean_picture(pictures())

    def _outputs(self, planes: np.ndarray, view: View, context: Context, place: str) -> list[Any]:
        """What the network says of its input, given to it as a view of it; lies at a place."""
        assert context.engine is not None
        with timed(context.timings, "network"):
            seen = _seen(planes, view, context) if view.changes else planes
            outputs = list(context.engine.run("network", {"features": seen}).values())
            if not self.traits.integers:
                outputs = in_numbers(outputs)
            if not view.changes:
                return outputs
            return self.seen_from(view, outputs, context.strips, place)

    def _encode(
        self, prepared: Prepared, previous: np.ndarray | None, context: Context
    ) -> np.ndarray:
        """The network's input, of a size that it takes, see `NetworkInput`."""
        height, width = prepared.luminance.shape
        multiple, names = self.looks.alignment, self.spec.network.features
        full = (-(-height // multiple) * multiple, -(-width // multiple) * multiple)
        assert context.engine is not None
        found = NetworkInput(context.engine, len(names), full, context.workspace, context.strips)
        exposure, remodulation = prepared.history.exposure, prepared.remodulation_albedo
        albedo, normal, depth = prepared.albedo, prepared.normal, prepared.depth
        by = prepared.demodulation_albedo
        # to a network that has seen one sample a pixel alone, more look like a long past
        told = 1.0
        if self.spec.knows_samples:
            told = prepared.counts.told(self.spec.told_samples.share)

        def fill(rows: slice, target: np.ndarray) -> None:
            workspace = context.strips.workspace
            given = features.FeatureInputs(
                mean=prepared.mean[rows],
                local=prepared.local[rows],
                exposure=exposure,
                sample=prepared.luminance[rows],
                albedo=None if albedo is None else albedo[rows],
                normal=None if normal is None else normal[rows],
                depth=None if depth is None else depth[rows],
                depth_unit=prepared.depth_unit,
                frame_samples=told,
                filter_spread=prepared.filter_spread,
                demodulation_albedo=None if by is None else by[rows],
            )
            features.feature_planes(
                given, self.spec.temporal, names, out=target, workspace=workspace
            )
            features.previous_planes(
                None if previous is None else previous[rows],
                None if remodulation is None else remodulation[rows],
                exposure,
                names,
                out=target,
                workspace=workspace,
            )

        def pack(rows: slice) -> None:
            found.fill(rows, width, partial(fill, rows))

        with timed(context.timings, "encode"):
            context.strips.run(pack, height, width)
            found.mirror(height, width)
        return found.array

    def _remember(
        self,
        plan: KernelPlan,
        prepared: Prepared,
        shaded: tuple[np.ndarray, Shading],
        layers: FilteredLayers | None,
        context: Context,
    ) -> State:
        image, shading = shaded
        output: np.ndarray | None = None
        if plan.runs("keep_output"):
            with timed(context.timings, "keep_output"):
                back_buffer = history_of(context.back_buffer)
                output = previous_output.keep(image, context.strips, back_buffer)
                if shading.restored is not None:
                    restored, before = shading.restored
                    restored.take_back(output, before)
                if shading.texture is not None:
                    texture.take_back(output, shading.texture, context.strips)
        pasts = {} if layers is None else layers.pasts
        history = replace(prepared.history, output=output, layers=pasts)
        return State(shape=plan.before_network.shape, temporal=history)


def recalling(
    recall: Recall, prepared: Prepared, previous: np.ndarray, color: np.ndarray, context: Context
) -> Prepared:
    """A frame that takes of its past what single pixels agree with.

    Parameters
    ----------
    recall
        The rule.
    prepared
        The frame.
    previous : (h, w, 4) float32
        The last output at its pixels, and how much of it is valid.
    color : (h, w, 3) float32
        The frame's, repaired.
    context
        Where the work runs.
    """
    strips, workspace = context.strips, context.workspace
    worth = None if prepared.sample is None else prepared.sample[3]
    seen = Compared(previous, previous, color, prepared.history.exposure, worth)
    found = recall.share(seen, strips, workspace)
    left: np.ndarray | None = None
    if prepared.sample is not None:
        mean = prepared.history.mean
        out = workspace.array("believed", mean.shape)
        left = believed(mean, prepared.sample, found.agreed, strips, out)
    return replace(prepared, recalled=found.output, agreed=found.agreed, believed=left)


@dataclass(frozen=True, kw_only=True, eq=False)
class KernelPlan(Plan):
    """The decisions on one frame.

    Attributes
    ----------
    before_network
        Those on the stages before the network, with what they were taken on.
    tiles
        In which the picture is made; none for the whole frame at once.
    """

    before_network: TemporalPlan
    tiles: tuple[Tile, ...] = ()


def _seen(planes: np.ndarray, view: View, context: Context) -> np.ndarray:
    """A network's input, pixels in steps or planes, as a view of it."""
    if planes.dtype == np.uint8:
        return view.of_pixels(planes[0])[None]
    seen = context.workspace.array("features of a view", planes.shape)
    view.of_planes(planes[0], range(planes.shape[1]), context.strips, seen[0])
    return seen


def _views_told(ensemble: int) -> str:
    return "" if ensemble == 1 else f", {ensemble} times, the frame mirrored otherwise each time"


def history_of(state: object) -> History | None:
    """What a state of these families remembers; None for no state."""
    history = state.temporal if isinstance(state, State) else None
    return history if isinstance(history, History) else None


def crop(prepared: Prepared, tile: Tile, watch: Watch) -> Prepared:
    """The part of a prepared frame that a tile sees, in arrays of its own; looked at between."""

    def cut(value: Any) -> Any:
        watch.look()
        if isinstance(value, np.ndarray) and value.ndim >= 2:
            return np.ascontiguousarray(value[tile.outer])
        return value

    # a tile's picture is made of what is believed; layers, which ask for more, are not cut in tiles
    left: dict[str, Any] = {"believed": None, "agreed": None}
    names = [field.name for field in fields(prepared) if field.name not in left]
    values: dict[str, Any] = {name: cut(getattr(prepared, name)) for name in names}
    if prepared.sample is not None:
        values["sample"] = np.ascontiguousarray(prepared.sample[:, *tile.outer])
    values["history"] = replace(prepared.history, mean=cut(prepared.mean), surface_guides=None)
    values["counts"] = replace(prepared.counts, share=cut(prepared.counts.share))
    return replace(prepared, **values, **left)

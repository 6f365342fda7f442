"""Joint denoising and upscaling: a network of two branches says how light is filtered.

Kazmierczyk et al. 2025. Everything is at the picture's pixels, of which there may be twice as many
along each axis as in the frame: the frame's samples lie where its jitter puts them, and what was
accumulated, the last picture among it, is brought there by motion. Pixels at which nothing is
remembered begin anew, and so do those whose light has changed; whether the rest of the past still
holds is for the network to say.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from stillray.arrays.extend import cut
from stillray.arrays.strips import STRIP_PIXELS, Strips, pixels_of, with_halo
from stillray.arrays.workspace import Workspace
from stillray.families.contract import Context, Request, State, Step, Traits
from stillray.families.cost import feature_filters_cost
from stillray.families.feature_reconstruction import (
    Accumulated,
    Enlarged,
    Past,
    Rules,
    reconstruct,
)
from stillray.families.network_input import NetworkInput
from stillray.families.past_agreement import Shown, reject_history
from stillray.families.target_grid import Grid, dilated, recalled
from stillray.families.target_planes import Known, Surfaces, log_depth, planes_by_name
from stillray.frame import Frame
from stillray.model_spec.decoders import FeatureFilters
from stillray.model_spec.loader import ModelSpec
from stillray.model_spec.networks import BranchNetwork
from stillray.stages import features, lamps, rare_light
from stillray.stages.accumulate import bounded
from stillray.stages.decide import REJECT
from stillray.stages.history_rejection import Noise
from stillray.stages.plan import Plan, Stage
from stillray.stages.put_back import put_back
from stillray.stages.recall import Compared, Recall
from stillray.stages.repair import Buffers, all_within, repair_feature
from stillray.stages.reproject import Edges, bound_blur
from stillray.stages.sharpening import Sharpening, scale
from stillray.timing import timed

#: Frames that a frame's history is taken to go back.
MEMORY_FRAMES = 32
_OTHER_DEPTH = np.float32(np.log(1.25))  # more than a camera moves in a frame
_GUIDES = ("roughness", "specular_albedo")


@dataclass(frozen=True, eq=False)
class Remembered:
    """What the next frame looks at, at the picture's size.

    Attributes
    ----------
    accumulated
        Light, albedos and their samples.
    output : (H, W, 4) float32
        The picture, and the logarithm of the depth of its pixels.
    exposure
        1 / radiance.
    noise
        See `stillray.stages.history_rejection`; None of a frame without a past.
    """

    accumulated: Accumulated
    output: np.ndarray
    exposure: float
    noise: Noise | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class UpscalePlan(Plan):
    """The decisions on one frame, with what they were taken on.

    Attributes
    ----------
    shape
        Of the frame, pixels.
    buffers
        As given, or repaired.
    guides
        Roughness and specular albedo, by their names in `Frame`, as far as they are given.
    jitter
        The frame's.
    past
        None where nothing is used of it.
    temporal
        Whether the frame is remembered.
    """

    shape: tuple[int, int]
    buffers: Buffers
    guides: dict[str, np.ndarray]
    jitter: np.ndarray | None
    past: Remembered | None
    temporal: bool


@dataclass(frozen=True, eq=False)
class _Seen:
    """A frame and its past at the picture's pixels; see `UpscalePlan`."""

    grid: Grid
    frame: Enlarged
    surfaces: Surfaces
    past: Past | None
    noise: Noise | None


class FeatureFiltersModel:
    """A model of the family ``feature-filters``.

    Parameters
    ----------
    spec
        The model's specification.

    Attributes
    ----------
    alignment
        Height and width of the network's input must be multiples of this, pixels.
    rules
        The numbers that a reconstruction obeys.
    cost
        Operations and float32 planes moved by the reconstruction, a pixel of the picture.
    """

    def __init__(self, spec: ModelSpec) -> None:
        assert isinstance(spec.network, BranchNetwork)
        assert isinstance(spec.decoder, FeatureFilters)
        self.spec, self.scale = spec, spec.decoder.scale
        self.alignment = 1 << len(spec.network.radiance_widths)
        self.rules = Rules(
            filters=spec.decoder,
            demodulate=spec.demodulate,
            max_samples=spec.temporal.max_samples,
            most_blur=spec.temporal.most_blur,
            sharp_contrast=spec.temporal.sharp_contrast,
        )
        self.cost = feature_filters_cost(spec.network.resolutions, spec.decoder)
        self.traits = Traits(
            required=frozenset(spec.inputs.required),
            optional=frozenset(spec.inputs.optional),
            scale=self.scale,
            memory=MEMORY_FRAMES,
            linear=False,
            integers=True,
        )

    def plan(
        self, frame: Frame, before: State | Plan | None, request: Request, context: Context
    ) -> UpscalePlan:
        """Decide what runs for a frame, and why; see `Family`."""
        buffers = Buffers.of(frame)
        given = {name: getattr(frame, name) for name in _GUIDES}
        guides = {name: guide for name, guide in given.items() if guide is not None}
        with timed(context.timings, "inspect"):
            whole = all(context.strips.run(buffers.in_range, *frame.shape))
            whole &= all(all_within(guide, 0, 1, context.strips) for guide in guides.values())
        if not whole:
            with timed(context.timings, "repair"):
                buffers = buffers.repaired(context.strips)
                guides = {
                    name: repair_feature(guide, 0.0, 1.0, context.strips)
                    for name, guide in guides.items()
                }
        past, why = _past_of(frame, before, request)
        return UpscalePlan(
            stages=self._stages(frame, request, whole, "" if past else why),
            shape=frame.shape,
            buffers=buffers,
            guides=guides,
            jitter=frame.jitter,
            past=past if isinstance(past, Remembered) else None,
            temporal=request.temporal,
        )

    def _stages(
        self, frame: Frame, request: Request, whole: bool, why_anew: str
    ) -> tuple[Stage, ...]:
        repair = "every value is finite and in its range"
        if not whole:
            repair = "a value is NaN, infinite or out of its range, or a pixel has no samples"
        place = (
            "where the jitter puts them"
            if frame.jitter is not None
            else ("at the centres of their pixels, since no jitter is given")
        )
        height, width = (size * self.scale for size in frame.shape)
        return (
            Stage("inspect", True, "values tell what a frame calls for"),
            Stage("repair", not whole, repair),
            Stage("expose", True, "relative to its brightness; what stands far above is bounded"),
            Stage("enlarge", True, f"to {width} x {height} pixels; samples lie {place}"),
            Stage("warp", not why_anew, why_anew or "history and motion are there"),
            Stage("reject_history", not why_anew, why_anew or REJECT),
            Stage("encode", True, f"{len(self.spec.network.features)} planes for the network"),
            Stage("network", True, self.spec.name),
            Stage("reconstruct", True, "filters by distances of features, at every resolution"),
            *put_back(self.spec.lamps, self.spec.rare_light),
            Stage("layers", False, "none are filtered by this model"),
            Stage(
                "remember",
                request.temporal,
                "the next frame looks at this one" if request.temporal else "no next frame does",
            ),
        )

    def step(self, plan: Plan, context: Context) -> Step:
        """Run a frame as it was planned; see `Family`."""
        assert isinstance(plan, UpscalePlan)
        assert context.engine is not None
        seen = self._see(plan, context)
        planes = self._encode(seen, context)
        with timed(context.timings, "network"):
            outputs = list(context.engine.run("network", {"features": planes}).values())
        with timed(context.timings, "reconstruct"):
            room = _room(seen.grid, context)
            image, kept = reconstruct(
                seen.frame, seen.past, outputs, self.rules, context.strips, room
            )
            image = cut(image, seen.grid.shape, context.strips)
        found: lamps.Restored | None = None
        if plan.runs("lamps"):
            with timed(context.timings, "lamps"):
                found = self._lamps(image, plan, seen.frame.exposure, context)
                before = found.put_back(image, plan.buffers.color, None, self.scale)
        if plan.runs("rare_light"):
            with timed(context.timings, "rare_light"):
                gain = rare_light.restore(
                    image, plan.buffers.color, seen.frame.exposure, context.strips,
                    context.workspace, self.scale,
                )  # fmt: skip
            if gain is not None and found is not None:
                before *= found.of(gain, self.scale)[..., None]

        def finish() -> State:
            temporal: Remembered | None = None
            if plan.runs("remember"):
                with timed(context.timings, "remember"):
                    temporal = _remember(seen, image, kept, context)
                    if found is not None:
                        found.take_back(temporal.output, before, self.scale)
            return State(shape=plan.shape, temporal=temporal)

        return Step(image=image, finish=finish)

    def _lamps(
        self, image: np.ndarray, plan: UpscalePlan, exposure: float, context: Context
    ) -> lamps.Restored:
        """The frame's pixels whose light is put back, into all of the picture's that lie there."""
        color, (height, width) = plan.buffers.color, plan.shape
        if self.scale > 1:
            image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
        samples, picture = (features.luminance(each) for each in (color, image))
        return lamps.find(samples, picture, exposure, context.strips)

    def _see(self, plan: UpscalePlan, context: Context) -> _Seen:
        """A frame and its past at the picture's pixels."""
        buffers, timings, strips = plan.buffers, context.timings, context.strips
        grid = Grid.of(plan.shape, self.scale, self.alignment, plan.jitter)

        def taken(name: str, image: np.ndarray | None) -> np.ndarray | None:
            if image is None:
                return None
            shape = (*grid.full, *image.shape[2:])
            return grid.taken(image, strips, context.workspace.array(f"taken {name}", shape))

        with timed(timings, "expose"):
            exposure, color = self._exposed(plan, context)
        with timed(timings, "enlarge"):
            black = np.zeros((*grid.full, 3), np.float32)
            lit = taken("color", color)
            albedo = taken("albedo", buffers.albedo)
            specular = taken("specular albedo", plan.guides.get("specular_albedo"))
            assert lit is not None
            frame = Enlarged(
                color=lit,
                albedo=black if albedo is None else albedo,
                specular=black if specular is None else specular,
                exposure=exposure,
            )
            depth = buffers.depth
            far = None if depth is None else _in_logarithms(depth, context)
            surfaces = Surfaces(
                normal=taken("normal", buffers.normal),
                roughness=taken("roughness", plan.guides.get("roughness")),
                depth=taken("depth", depth),
                log_depth=taken("log depth", far),
                depth_unit=1.0 if depth is None else features.depth_scale(depth),
            )
        by = (depth, buffers.normal, buffers.albedo)
        shown = Shown(color, buffers.broken, exposure, by, _jitter(plan.jitter))
        past, noise = self._past(plan, grid, surfaces, shown, context)
        if past is not None and self.rules.filters.recall_noise:
            with timed(timings, "reject_history"):
                past = self._recalling(past, frame, context)
        return _Seen(grid, frame, surfaces, past, noise)

    def _past(
        self, plan: UpscalePlan, grid: Grid, surfaces: Surfaces, shown: Shown, context: Context
    ) -> tuple[Past | None, Noise | None]:
        """What still holds of the past, at the picture's pixels; and the noise of its samples."""
        buffers, strips = plan.buffers, context.strips
        if plan.past is None or buffers.motion is None:
            return None, None
        with timed(context.timings, "warp"):
            motion = dilated(buffers.motion, buffers.depth, strips)
            past = warped(plan.past, grid, motion, self.rules, strips, context.workspace)
            depth = surfaces.log_depth
            elsewhere = depth is not None and _elsewhere(past.output, depth, strips)
        with timed(context.timings, "reject_history"):
            if elsewhere:
                return None, None
            return past, reject_history(past, shown, grid, buffers.motion, plan.past.noise, strips)

    def _recalling(self, past: Past, frame: Enlarged, context: Context) -> Past:
        """A past that says what it weighs beside the frame, see `stillray.stages.recall`."""
        light = past.accumulated.light  # without samples where nothing is known
        seen = Compared(past.output, light, frame.color, frame.exposure)
        share = Recall(limit=self.rules.filters.recall_noise).share(
            seen, context.strips, context.workspace
        )
        return replace(past, recalled=share.agreed)

    def _exposed(self, plan: UpscalePlan, context: Context) -> tuple[float, np.ndarray]:
        """The exposure, and the color without what stands far above its surroundings."""
        given, transfer, strips = plan.buffers.color, self.spec.transfer, context.strips
        light = context.workspace.array("light", plan.shape)
        color = context.workspace.array("bounded", given.shape)

        def luminance(rows: slice) -> None:
            features.luminance(given[rows], out=light[rows])

        def bound(rows: slice) -> None:
            near, inside = with_halo(rows, transfer.local_size // 2, plan.shape[0])
            color[rows] = bounded(given[near], exposure, transfer, self.spec.temporal)[inside]

        strips.run(luminance, *plan.shape)
        exposure = features.frame_exposure(light, transfer)
        if plan.past is not None:
            exposure = features.steady_exposure(exposure, plan.past.exposure, transfer)
        strips.run(bound, *plan.shape)
        return exposure, color

    def _encode(self, seen: _Seen, context: Context) -> np.ndarray:
        """The network's input, see `NetworkInput`."""
        names, full = self.spec.network.features, seen.grid.full
        assert context.engine is not None
        found = NetworkInput(context.engine, len(names), full, context.workspace, context.strips)
        nothing = np.zeros((*full, 4), np.float32)
        empty = Past(Accumulated(nothing, nothing, nothing), nothing)

        past = seen.past or empty
        known = Known(
            frame=seen.frame,
            surfaces=seen.surfaces,
            accumulated=past.accumulated,
            output=past.output,
            offsets=(seen.grid.down, seen.grid.right),
        )

        def work(rows: slice) -> None:
            planes = planes_by_name(names, known.of_rows(rows), context.strips.workspace)
            found.put(rows, planes)

        with timed(context.timings, "encode"):
            context.strips.run(work, *full)
        return found.array


def _past_of(
    frame: Frame, before: State | Plan | None, request: Request
) -> tuple[Remembered | bool, str]:
    """What is used of the past, or whether a plan that is only told would use it; and why not."""
    if not request.temporal:
        return False, "temporal accumulation is switched off"
    if isinstance(before, UpscalePlan):
        found: Remembered | bool = before.temporal
        shape = before.shape
    elif isinstance(before, State) and isinstance(before.temporal, Remembered):
        found, shape = before.temporal, before.shape
    else:
        found, shape = False, frame.shape
    if not found or shape != frame.shape:
        return False, "first frame, or the first after a reset or a new size"
    if frame.motion is None:
        return False, "no motion given: where the past went is not known"
    return found, ""


def warped(
    before: Remembered,
    grid: Grid,
    motion: np.ndarray,
    rules: Rules,
    strips: Strips,
    workspace: Workspace,
) -> Past:
    """What is remembered, at the pixels of a grid; without samples where it lay outside.

    Parameters
    ----------
    before
        The last frame's.
    grid
        Of this frame.
    motion : (h, w, 2) float32
        See `stillray.families.target_grid.dilated`.
    rules
        Of the specification.
    strips
        Where the work runs.
    workspace
        Where the result lies.
    """
    kept = before.accumulated
    means = (kept.light, kept.albedo, kept.specular)
    room = [workspace.array(f"past {index}", (*grid.full, 4)) for index in range(4)]
    sharp = Sharpening(before.output, strips) if rules.filters.sharp_recall else None
    edges = Edges.of(before.output, rules.sharp_contrast, strips, sharp)

    def work(rows: slice) -> None:
        positions, inside = grid.past_positions(motion, rows)
        for source, image in zip((*means, before.output), room, strict=True):
            recalled(source, positions, out=image[rows])
        if sharp is not None:
            output = room[3][rows]
            scale(output, sharp.factor(positions, output, None, strips.workspace), strips.workspace)
        if edges is not None:
            edges.sharpen(room[0][rows], positions, strips.workspace)
        outside = np.flatnonzero(~inside)
        for image in room:
            pixels_of(image[rows])[outside] = 0
        if rules.most_blur:
            for image in room[:3]:
                bound_blur(image[rows], positions, rules.most_blur, strips.workspace)

    strips.run(work, *grid.full, pixels=STRIP_PIXELS // 2)
    return Past(Accumulated(*room[:3]), room[3])


def _in_logarithms(depth: np.ndarray, context: Context) -> np.ndarray:
    """`log_depth` of a frame."""
    found = context.workspace.array("logarithm of depth", depth.shape)

    def work(rows: slice) -> None:
        found[rows] = log_depth(depth[rows])

    context.strips.run(work, *depth.shape)
    return found


def _jitter(jitter: np.ndarray | None) -> tuple[float, float]:
    """Where all samples lie in their pixels; 0 where they lie anywhere, or in the middle."""
    return (0.0, 0.0) if jitter is None else (float(jitter[0]), float(jitter[1]))


def _elsewhere(output: np.ndarray, depth: np.ndarray, strips: Strips) -> bool:
    """Whether the last picture is of another view: a cut that nobody told.

    The network is told how depth changes, pixel by pixel, and has learned what is uncovered, not
    that nothing is as it was.

    Parameters
    ----------
    output : (H, W, 4) float32
        Of `warped`: last the logarithm of depth, 0 where it is not known.
    depth : (H, W) float32
        Of this frame, the same.
    """

    def count(rows: slice) -> np.ndarray:
        before = output[rows, :, 3]
        known = before != 0
        apart = np.abs(before - depth[rows]) > _OTHER_DEPTH
        return np.array([np.count_nonzero(known), np.count_nonzero(known & apart)])

    known, other = np.sum(strips.run(count, *depth.shape), axis=0)
    return bool(2 * other > known)


def _old(grid: Grid, context: Context) -> Remembered | None:
    """What was remembered before the last frame, of this grid: its memory may be written over."""
    state = context.back_buffer
    found = state.temporal if isinstance(state, State) else None
    if isinstance(found, Remembered) and found.output.shape[:2] == grid.shape:
        return found
    return None


def _room(grid: Grid, context: Context) -> Accumulated:
    """Where what a frame accumulates is to lie."""
    if grid.full == grid.shape:
        old = _old(grid, context)
        return Accumulated.empty(grid.full) if old is None else old.accumulated
    return Accumulated(
        *(context.workspace.array(f"kept {index}", (*grid.full, 4)) for index in range(3))
    )


def _remember(seen: _Seen, image: np.ndarray, kept: Accumulated, context: Context) -> Remembered:
    grid, depth, strips = seen.grid, seen.surfaces.log_depth, context.strips
    height, width = grid.shape
    old = _old(grid, context)
    output = np.empty((height, width, 4), np.float32) if old is None else old.output

    def work(rows: slice) -> None:
        output[rows, :, :3] = image[rows]
        output[rows, :, 3] = 0 if depth is None else depth[rows, :width]

    strips.run(work, height, width)
    parts = (kept.light, kept.albedo, kept.specular)
    return Remembered(
        Accumulated(*(cut(part, grid.shape, strips) for part in parts)),
        output,
        seen.frame.exposure,
        seen.noise,
    )

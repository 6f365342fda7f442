"""The way of a frame before the network: exposed, its past brought to its pixels, accumulated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from stillray.arrays.strips import LARGE_STRIP_PIXELS, Strips, interleave, planes_of
from stillray.arrays.workspace import Workspace
from stillray.frame import Frame
from stillray.model_spec.loader import ModelSpec
from stillray.stages import accumulate as acc
from stillray.stages import albedo_history, features, history_rejection, specular_motion
from stillray.stages import reproject as rep
from stillray.stages.decide import TemporalPlan, Wants, decide
from stillray.stages.exposure import Exposed, expose, expose_anew, local_luminance
from stillray.stages.means import Means
from stillray.stages.motion_dilation import dilate_motion
from stillray.stages.repair import Buffers
from stillray.stages.sample_counts import SampleCounts
from stillray.stages.state import History, Prepared
from stillray.timing import timed, timed_pass

#: Share of the past that is kept, below which the exposure begins anew.
LEAST_KEPT = 0.5


def prepare(
    frame: Frame,
    spec: ModelSpec,
    past: History | None,
    strips: Strips,
    wants: Wants = Wants(),  # noqa: B008  a value that nobody can change
) -> Prepared:
    """Decide on a frame and prepare it, in arrays of its own.

    Parameters
    ----------
    frame
        The buffers.
    spec
        The model's specification.
    past
        What the frame before has left, or None.
    strips
        Where the work runs.
    wants
        What is asked for.
    """
    plan = decide(frame, spec, past, strips, {}, wants)
    return prepare_planned(plan, Means(spec=spec, strips=strips))


def prepare_planned(plan: TemporalPlan, means: Means) -> Prepared:
    """Prepare a frame as it was planned."""
    exposed = expose(plan, means)
    buffers = _with_specular_motion(plan, exposed, means)
    pixels = _Pixels(plan, buffers, exposed, means)
    pixels.run()
    exposed = pixels.exposed
    if pixels.accumulated is not None:
        with timed(means.timings, "accumulate"):
            local_luminance(pixels.accumulated, exposed.exposure, exposed.local, means)
    remodulation_albedo, mean_albedo, frames = _albedo_history(
        plan, exposed, pixels.positions, pixels.counts, means
    )
    return Prepared(
        history=History(
            mean=pixels.mean,
            surface_guides=pixels.surface_guides,
            exposure=exposed.exposure,
            noise=pixels.noise,
            mean_albedo=mean_albedo,
            mean_albedo_frames=frames,
            frame_samples=pixels.counts.mean,
        ),
        sample=None if pixels.sample is None else pixels.sample[:4],
        sample_weight=None if pixels.sample is None else pixels.sample[4],
        luminance=exposed.luminance,
        demodulation_albedo=exposed.demodulation_albedo,
        remodulation_albedo=remodulation_albedo,
        local=exposed.local,
        albedo=buffers.albedo,
        normal=buffers.normal,
        depth=buffers.depth,
        depth_unit=exposed.depth_unit,
        motion=buffers.motion,
        picture_positions=pixels.positions if pixels.follows_picture else None,
        disoccluded=pixels.disoccluded,
        history_confidence=pixels.confidence,
        counts=pixels.counts,
        filter_spread=buffers.filter_spread,
    )


def _with_specular_motion(plan: TemporalPlan, exposed: Exposed, means: Means) -> Buffers:
    buffers = plan.buffers
    if not plan.runs("specular_motion") or plan.past is None:
        return buffers
    assert buffers.motion is not None
    assert buffers.depth is not None
    assert buffers.albedo is not None
    with timed(means.timings, "specular_motion"):
        motion = specular_motion.virtual_motion(
            specular_motion.Surfaces(buffers.motion, buffers.depth, buffers.albedo),
            exposed.luminance,
            plan.past.mean,
            exposed.exposure,
            means.spec.demodulate,
            means.strips,
        )
    return replace(buffers, motion=motion)


class _Pixels:
    """Geometry, the past at these pixels, whether it still holds, and the sample added to it.

    Attributes
    ----------
    mean : (h, w, 4) float32
        Accumulated irradiance and samples.
    surface_guides : (h, w, 4) float32 or None
        This frame's geometry, for the next.
    sample : (4, h, w) float32 or None
        This frame's irradiance and what its samples weigh.
    disoccluded : (h, w) uint8 or None
        1 where no past was found.
    accumulated : (h, w) float32 or None
        Luminance of ``mean``, where the network asks for what is usual in it.
    positions : (h, w, 2) float32 or None
        Where pixels were, if anything moves.
    follows_picture
        Whether anybody looks at pictures of the past there.
    exposed
        The frame's light, of which the exposure begins anew where most of the past is let go.
    confidence : (h, w) float32 or None
        How far the past agrees with this frame, see `stillray.stages.history_rejection`.
    noise
        What that leaves for the next frame; None without a past.
    counts
        The frame's samples.
    """

    def __init__(
        self, plan: TemporalPlan, buffers: Buffers, exposed: Exposed, means: Means
    ) -> None:
        self._plan, self._buffers, self.exposed, self._means = plan, buffers, exposed, means
        shape, workspace, back_buffer = (
            plan.shape,
            means.workspace,
            means.back_buffer_for(plan.shape),
        )
        wants, moved = plan.wants, plan.moved
        before = None if plan.past is None else plan.past.frame_samples
        self.counts = SampleCounts.of(buffers.samples, before, means.strips)

        def room(name: str, *more: int, dtype: type = np.float32) -> np.ndarray:
            return workspace.array(name, (*more, *shape), dtype)

        self.surface_guides: np.ndarray | None = None
        if plan.runs("surface_guides"):
            self.surface_guides = None if back_buffer is None else back_buffer.surface_guides
            if self.surface_guides is None:
                self.surface_guides = np.empty((*shape, 4), np.float32)
        self.mean = np.empty((*shape, 4), np.float32) if back_buffer is None else back_buffer.mean
        # irradiance, its weight as a new pixel's, and that beside the past
        self.sample = room("sample", 5) if wants.sample and moved else None
        looks = moved is not None and wants.previous_output
        self.disoccluded = room("disoccluded", dtype=np.uint8) if looks else None
        wants_local = moved is not None and "local_luminance" in means.spec.network.features
        self.accumulated = room("accumulated") if wants_local else None
        self.follows_picture = wants.previous_output or plan.runs("accumulate_albedo")
        self.confidence: np.ndarray | None = None
        self.noise: history_rejection.Noise | None = None
        self._blocks: np.ndarray | None = None
        self._reprojected: np.ndarray | None = None
        if moved is not None:
            halves = [-(-size // 2) for size in shape]
            self._blocks = workspace.array("blocks", (history_rejection.PLANES, *halves))
            self._reprojected = room("reprojected", 4)
        self.positions: np.ndarray | None = None
        self._discontinuous: np.ndarray | None = None
        self._edges: rep.Edges | None = None
        if moved is not None and buffers.motion is not None:
            with timed(means.timings, "reproject"):
                means.strips.watch.look()
                if buffers.motion.any():
                    self.positions = workspace.array("positions", buffers.motion.shape)
                    self._edges = rep.Edges.of(
                        moved.output, means.spec.temporal.sharp_contrast, means.strips
                    )
                    if self.surface_guides is not None and moved.surface_guides is not None:
                        self._discontinuous = discontinuities(
                            moved.surface_guides, means.strips, workspace
                        )

    def run(self) -> None:
        """Fill the arrays."""
        self._look_back()
        self._reject()
        with timed(self._means.timings, "accumulate"):
            self._run(self._accumulate)

    def _run(self, work: Callable[[slice], None]) -> None:
        """Rows from an even one on, always the same ones: see `_past_of`."""
        self._means.strips.run_even(work, *self._plan.shape, pixels=LARGE_STRIP_PIXELS)

    def _past_of(self, rows: slice) -> np.ndarray | None:
        """The reprojected past of a strip, ``(4, rows, w)``: strips lie one after the other."""
        if self._reprojected is None:
            return None
        width = self._plan.shape[1]
        flat = self._reprojected.reshape(-1)[4 * width * rows.start : 4 * width * rows.stop]
        return flat.reshape(4, -1, width)

    def _look_back(self) -> None:
        """Geometry, the past at these pixels, and its difference from this frame's samples."""
        past = self._plan.moved
        if self.surface_guides is None and past is None:
            return
        with timed_pass(self._means.timings) as part:

            def work(rows: slice) -> None:
                now: np.ndarray | None = None
                if self.surface_guides is not None:
                    with part("surface_guides"):
                        now = self._geometry(rows, self.surface_guides[rows])
                if past is not None:
                    with part("reproject"):
                        before = self._past_of(rows)
                        assert before is not None
                        planes_of(self._reproject(rows, past, now), out=before)
                        self.counts.held_by_pixel(before[3], rows)
                    with part("reject_history"):
                        self._compare(rows)

            self._run(work)

    def _compare(self, rows: slice) -> None:
        exposed, workspace, past = self.exposed, self._means.strips.workspace, self._past_of(rows)
        assert past is not None
        assert self._blocks is not None
        weight = self._sample_weight(rows, past[3])
        if self._buffers.broken is not None:
            weight[self._buffers.broken[rows]] = 0
        history_rejection.compare(
            exposed.luminance[rows],
            weight,
            past,
            exposed.exposure,
            self._blocks[:, rows.start // 2 : -(-rows.stop // 2)],
            workspace,
        )

    def _reject(self) -> None:
        """Find how far the past can be trusted."""
        past, motion = self._plan.moved, self._buffers.motion
        if past is None or self._blocks is None or motion is None:
            return
        with timed(self._means.timings, "reject_history"):
            noise = past.noise
            if noise is not None and self.counts.past_scale != 1:  # as of frames like this one
                variance = noise.variance * np.float32(self.counts.past_scale)
                noise = replace(noise, variance=variance)
            self.confidence, self.noise = history_rejection.confidence(
                self._blocks,
                noise,
                motion,
                self.exposed.exposure,
                self._means.strips,
            )
        kept = 1.0 if self.confidence is None else cv2.mean(self.confidence)[0]
        kept *= cv2.countNonZero(self._blocks[0]) / self._blocks[0].size  # 0 without a past
        if kept < LEAST_KEPT:
            self.exposed = expose_anew(self.exposed, self._means)

    def _geometry(self, rows: slice, out: np.ndarray) -> np.ndarray:
        normal, depth = self._buffers.normal, self._buffers.depth
        now = rep.surface_guide_planes(
            None if normal is None else normal[rows],
            None if depth is None else depth[rows],
            self._means.strips.workspace,
        )
        interleave(now, out=out)
        return now

    def _reproject(self, rows: slice, past: History, now: np.ndarray | None) -> np.ndarray:
        motion, workspace = self._buffers.motion, self._means.strips.workspace
        assert motion is not None
        at: np.ndarray | None = None
        if self.positions is not None:
            at = rep.positions_of(motion[rows], rows, self.positions[rows])
        # many a camera stands still, and only things move
        follows = at if motion[rows].any() else None
        previous = rep.PreviousFrame(
            past.mean, past.surface_guides, self._discontinuous, self._edges
        )
        options = self._means.spec.temporal
        warped = rep.reproject(previous, now, follows, rows, options, workspace)
        if at is not None and self.follows_picture and self._buffers.depth is not None:
            dilate_motion(at, motion, self._buffers.depth, rows, workspace)
        return warped

    def _accumulate(self, rows: slice) -> None:
        options, workspace = self._means.spec.temporal, self._means.strips.workspace
        planes = self._past_of(rows)
        if planes is not None and self.confidence is not None:
            planes[3] *= self.confidence[rows]
        if planes is not None and self.sample is not None:
            # Whoever takes the sample instead of the past takes it for a new pixel's: what a
            # firefly is allowed beside a long past would be too much.
            alone = self._sample_weight(rows, None)
            if self._buffers.broken is not None:
                alone[self._buffers.broken[rows]] = acc.FILLED_WEIGHT
            np.copyto(self.sample[3, rows], alone)
        irradiance, weight = self._weighed(rows, None if planes is None else planes[3])
        if planes is None:
            self.counts.by_frame(weight, rows)
            cv2.merge([irradiance, weight], dst=self.mean[rows])
            return
        if self.sample is None:
            new = workspace.array("new", (3, *weight.shape))
        else:
            new = self.sample[:3, rows]
            np.copyto(self.sample[4, rows], weight)
            for plane in self.sample[3:, rows]:
                self.counts.by_frame(plane, rows)
        planes_of(irradiance, out=new)
        acc.accumulate(new, weight, planes, options, workspace)
        if self.disoccluded is not None:
            np.less_equal(planes[3], weight, out=self.disoccluded[rows].view(bool))
        self.counts.by_frame(planes[3], rows)
        interleave(planes, out=self.mean[rows])
        if self.accumulated is not None:
            features.luminance_of_planes(planes, out=self.accumulated[rows])

    def _weighed(self, rows: slice, held: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Irradiance, bounded, and what it weighs beside the samples that are held."""
        exposed, buffers, workspace = self.exposed, self._buffers, self._means.strips.workspace
        weight = self._sample_weight(rows, held)
        irradiance = buffers.color[rows]
        own = workspace.array("irradiance", irradiance.shape)
        if exposed.demodulation_albedo is not None:
            irradiance = np.divide(irradiance, exposed.demodulation_albedo[rows], out=own)
        irradiance = acc.clamp_fireflies(irradiance, weight, own)
        if buffers.broken is not None:
            weight[buffers.broken[rows]] = acc.FILLED_WEIGHT
        return irradiance, weight

    def _sample_weight(self, rows: slice, held: np.ndarray | None) -> np.ndarray:
        exposed = self.exposed
        return acc.sample_weight(
            exposed.luminance[rows],
            exposed.local[rows],
            held,
            exposed.exposure,
            self._means.spec.temporal,
            self._means.strips.workspace,
        )


def discontinuities(packed: np.ndarray, strips: Strips, workspace: Workspace) -> np.ndarray:
    """`reproject.mark_discontinuities` of a whole frame's surface_guides; lies in the workspace."""
    height, width = packed.shape[:2]
    mask = workspace.array("discontinuities", (height + 1, width + 1), np.uint8)

    def work(rows: slice) -> None:
        rep.mark_discontinuities(packed, rows, mask, strips.workspace)

    strips.run(work, height, width)
    return mask


def _albedo_history(
    plan: TemporalPlan,
    exposed: Exposed,
    positions: np.ndarray | None,
    counts: SampleCounts,
    means: Means,
) -> tuple[np.ndarray | None, np.ndarray | None, float]:
    """What the result is multiplied by, what the next frame gets of it, and of how many frames."""
    now, options = exposed.demodulation_albedo, means.spec.temporal
    if now is None or not plan.wants.temporal or options.albedo_samples <= 0:
        return now, None, 0.0
    back_buffer = means.back_buffer_for(plan.shape)
    next_albedo = None if back_buffer is None else back_buffer.mean_albedo
    if next_albedo is None:
        next_albedo = np.empty((*plan.shape, 4), np.float32)
    if not plan.runs("accumulate_albedo") or plan.past is None or plan.past.mean_albedo is None:
        first = next_albedo

        def begin(rows: slice) -> None:
            albedo_history.begin(now[rows], first[rows])

        means.strips.run(begin, *plan.shape)
        return now, next_albedo, 1.0
    with timed(means.timings, "accumulate_albedo"):
        most = counts.albedo_frames(options.albedo_samples)
        samples = min(plan.past.mean_albedo_frames, most)
        remodulation_albedo = means.workspace.array("remodulation_albedo", now.shape)
        albedo_history.accumulate(
            now,
            plan.past.mean_albedo,
            samples,
            positions,
            (next_albedo, remodulation_albedo),
            means.strips,
        )
    return remodulation_albedo, next_albedo, samples + 1

"""The way of a frame before the network: repair, demodulate, expose, reproject, accumulate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from stillray.arrays.strips import Strips, interleave, planes_of, with_halo
from stillray.arrays.workspace import Scratch
from stillray.frame import Frame
from stillray.model_spec.loader import ModelSpec
from stillray.stages import accumulate as acc
from stillray.stages import albedo_history as antialias
from stillray.stages import features as encode
from stillray.stages import history_rejection as relight
from stillray.stages import reproject as rep
from stillray.stages import specular_motion as mirror
from stillray.stages.demodulate import divisor
from stillray.stages.motion_dilation import follow_nearer
from stillray.stages.repair import Buffers
from stillray.timing import timed, timed_pass

_RELIT = 0.5  # share of the past that is kept, below which the exposure begins anew


@dataclass(frozen=True, kw_only=True, eq=False)
class LayerPast:
    """What is remembered of a layer that is filtered as the beauty is, see
    `stillray.pipeline.layers`.

    Attributes
    ----------
    mean : (h, w, 4) float32
        As the beauty's; the samples are the same.
    output : (h, w, 4) float32 or None
        As the beauty's.
    """

    mean: np.ndarray
    output: np.ndarray | None


@dataclass(frozen=True, kw_only=True, eq=False)
class History:
    """What is remembered of the past: a value that can be kept, dropped or copied.

    Attributes
    ----------
    mean : (h, w, 4) float32
        Accumulated irradiance and, last, the samples that each pixel holds.
    guides : (h, w, 4) float32 or None
        Geometry of the last frame, see `stillray.stages.reproject.pack`.
    exposure
        1 / irradiance, steadied over the sequence.
    brightness
        See `stillray.stages.history_rejection`; None where the frame is too small to tell changes
        of light.
    output : (h, w, 4) float32 or None
        The last output, see `stillray.stages.previous_output.remember`; None for models that take
        none.
    divisor : (h, w, 4) float32 or None
        See `stillray.stages.albedo_history`; None for models that use this frame's alone.
    divisor_samples
        Frames that the ``divisor`` holds.
    layers
        By name, the past of layers that are filtered as the beauty is.
    """

    mean: np.ndarray
    guides: np.ndarray | None
    exposure: float
    brightness: relight.Brightness | None = None
    output: np.ndarray | None = None
    divisor: np.ndarray | None = None
    divisor_samples: float = 0.0
    layers: Mapping[str, LayerPast] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class Prepared:
    """A frame on its way, ready for the network: also what training learns from.

    Attributes
    ----------
    history
        The history after this frame; its ``mean`` is what the kernels filter.
    sample : (4, h, w) float32 or None
        This frame's irradiance and, last, what its samples are worth; None where it was not asked
        for, or where there is no past: it is the ``mean`` then.
    luminance : (h, w) float32
        Luminance of this frame's irradiance.
    divisor : (h, w, 3) float32 or None
        What radiance was divided by; None where there is no albedo.
    modulator : (h, w, 3) float32 or None
        What the result is multiplied by: ``divisor``, or its mean over frames.
    local : (h, w) float32
        Tone-mapped local luminance: of the accumulated irradiance, if the network asks for it.
    albedo, normal, depth
        The frame's, repaired.
    depth_unit
        Scale of the depth feature.
    motion : (h, w, 2) float32 or None
        The frame's, finite; in mirrors that of what they show, see
        `stillray.stages.specular_motion`.
    picture_positions : (h, w, 2) float32 or None
        Where the pixels' picture was in the last one: x and y by their motion, but at silhouettes
        by that of the nearer surface, see `stillray.stages.motion_dilation`. None where nothing
        moves, or without a past, or where nobody looks at past pictures.
    worth : (h, w) float32 or None
        How much of the past was kept where light has changed, see
        `stillray.stages.history_rejection`.
    fresh : (h, w) uint8 or None
        1 where a pixel holds this frame's sample alone; None without a past, or where nobody looks
        at past outputs.
    """

    history: History
    sample: np.ndarray | None
    luminance: np.ndarray
    divisor: np.ndarray | None
    modulator: np.ndarray | None
    local: np.ndarray
    albedo: np.ndarray | None
    normal: np.ndarray | None
    depth: np.ndarray | None
    depth_unit: float
    motion: np.ndarray | None
    picture_positions: np.ndarray | None = None
    fresh: np.ndarray | None = None
    worth: np.ndarray | None = None


def prepare(
    frame: Frame,
    spec: ModelSpec,
    history: History | None,
    strips: Strips,
    timings: dict[str, float],
    *,
    temporal: bool = True,
    wants_sample: bool = False,
    recalls: bool = False,
    kept: Scratch | None = None,
    spare: History | None = None,
) -> Prepared:
    """Repair, demodulate, expose, reproject and accumulate: all that comes before the features.

    Parameters
    ----------
    frame
        The buffers.
    spec
        The model's specification.
    history
        The past, or None; one of another size is not used.
    strips
        Where the work runs.
    timings
        Stage name to milliseconds, filled in.
    temporal
        Whether a next frame will want this one's geometry.
    wants_sample
        Whether the result's ``sample`` is wanted.
    recalls
        Whether the previous output is looked at, so that the result must say where.
    kept
        Where the result lies, all but its history, until the next call with the same; None for
        arrays of its own.
    spare
        A history that nobody needs any more, whose arrays may be overwritten.
    """
    kept = kept or Scratch()
    shape = frame.shape
    if history is not None and history.mean.shape[:2] != shape:
        history = None
    if spare is not None and spare.mean.shape[:2] != shape:
        spare = None
    luminance, local = kept.array("luminance", shape), kept.array("local", shape)
    buffers = Buffers.of(frame)
    divide_by = None if frame.albedo is None else kept.array("divisor", frame.color.shape)
    if not _demodulate(buffers, divide_by, luminance, spec, strips, timings):
        with timed(timings, "repair"):
            buffers = buffers.repaired()
        _demodulate(buffers, divide_by, luminance, spec, strips, timings)
    with timed(timings, "expose"):
        exposure = encode.frame_exposure(luminance, spec.transfer)
        bright = relight.brightness(luminance, exposure, strips) if temporal else None
        worth: np.ndarray | None = None
        earlier = None if history is None else history.brightness
        if bright is not None and earlier is not None and buffers.motion is not None:
            worth, bright = relight.follow(bright, earlier, buffers.motion, exposure)
        if history is not None and (worth is None or cv2.mean(worth)[0] >= _RELIT):
            exposure = encode.steady_exposure(exposure, history.exposure, spec.transfer)
        _local_luminance(luminance, exposure, local, spec, strips)
        depth_unit = 1.0 if buffers.depth is None else encode.depth_scale(buffers.depth)

    if history is not None:
        black = spec.demodulate.black
        buffers = _follow_reflections(buffers, luminance, history, exposure, black, strips, timings)
    guides: np.ndarray | None = None
    if temporal and not (buffers.normal is None and buffers.depth is None):
        guides = np.empty((*shape, 4), np.float32) if spare is None else spare.guides
        guides = np.empty((*shape, 4), np.float32) if guides is None else guides
    mean = np.empty((*shape, 4), np.float32) if spare is None else spare.mean
    moves = history is not None and buffers.motion is not None
    sample = kept.array("sample", (4, *shape)) if wants_sample and moves else None
    fresh = kept.array("fresh", shape, np.uint8) if recalls and moves else None
    wants_local = moves and "local_luminance" in spec.network.features
    accumulated = kept.array("accumulated", shape) if wants_local else None
    averages = temporal and divide_by is not None and spec.temporal.albedo_samples > 0
    before = history.divisor if averages and history is not None and moves else None
    looks_back = recalls or before is not None
    rough = positions = None
    if history is not None and buffers.motion is not None:
        with timed(timings, "warp"):
            if buffers.motion.any():
                positions = kept.array("positions", buffers.motion.shape)
            if guides is not None and history.guides is not None and positions is not None:
                rough = rough_blocks(history.guides, strips, kept)

    def warp(
        rows: slice,
        now: np.ndarray | None,
        motion: np.ndarray,
        past: History,
        scratch: Scratch,
    ) -> np.ndarray:
        at: np.ndarray | None = None
        if positions is not None:
            at = rep.positions_of(motion[rows], rows, positions[rows])
        # many a camera stands still, and only things move
        follows = at if motion[rows].any() else None
        warped = rep.reproject(
            past.mean, past.guides, rough, now, follows, rows, spec.temporal, scratch
        )
        if at is not None and looks_back and buffers.depth is not None:
            follow_nearer(at, motion, buffers.depth, rows, scratch)
        return warped

    def accumulate(rows: slice, past: np.ndarray | None, scratch: Scratch) -> None:
        planes: np.ndarray | None = None
        if past is not None:
            planes = planes_of(past, out=scratch.array("mean", (4, *past.shape[:2])))
            if worth is not None:
                planes[3] *= worth[rows]
        weight = acc.sample_weight(
            luminance[rows],
            local[rows],
            None if planes is None else planes[3],
            exposure,
            spec.temporal,
            scratch,
        )
        irradiance = buffers.color[rows]
        own = scratch.array("irradiance", irradiance.shape)
        if divide_by is not None:
            irradiance = np.divide(irradiance, divide_by[rows], out=own)
        irradiance = acc.bound(irradiance, weight, own)
        if buffers.broken is not None:
            weight[buffers.broken[rows]] = acc.FILLED_WEIGHT
        if planes is None:
            cv2.merge([irradiance, weight], dst=mean[rows])
            return
        if sample is None:
            new = scratch.array("new", (3, *weight.shape))
        else:
            new = sample[:3, rows]
            np.copyto(sample[3, rows], weight)
        planes_of(irradiance, out=new)
        acc.accumulate(new, weight, planes, spec.temporal, scratch)
        interleave(planes, out=mean[rows])
        if fresh is not None:
            np.less_equal(planes[3], weight, out=fresh[rows].view(bool))
        if accumulated is not None:
            encode.luminance_of_planes(planes, out=accumulated[rows])

    with timed_pass(timings) as part:

        def work(rows: slice) -> None:
            scratch, past, now = strips.scratch, None, None
            if guides is not None:
                with part("guides"):
                    normal, depth = buffers.normal, buffers.depth
                    now = rep.guide_planes(
                        None if normal is None else normal[rows],
                        None if depth is None else depth[rows],
                        scratch,
                    )
                    interleave(now, out=guides[rows])
            if history is not None and buffers.motion is not None:
                with part("warp"):
                    past = warp(rows, now, buffers.motion, history, scratch)
            with part("accumulate"):
                accumulate(rows, past, scratch)

        strips.run(work, *shape)
    if accumulated is not None:
        with timed(timings, "accumulate"):
            _local_luminance(accumulated, exposure, local, spec, strips)
    modulator, remembered, samples = divide_by, None, 0.0
    if averages and divide_by is not None:
        remembered = None if spare is None else spare.divisor
        remembered = np.empty((*shape, 4), np.float32) if remembered is None else remembered
        if before is None or history is None:
            antialias.begin(divide_by, remembered)
        else:
            with timed(timings, "antialias"):
                samples = min(history.divisor_samples, spec.temporal.albedo_samples)
                modulator = kept.array("modulator", divide_by.shape)
                antialias.accumulate(
                    divide_by, before, samples, positions, remembered, modulator, strips
                )
        samples += 1
    return Prepared(
        history=History(
            mean=mean,
            guides=guides,
            exposure=exposure,
            brightness=bright,
            divisor=remembered,
            divisor_samples=samples,
        ),
        sample=sample,
        luminance=luminance,
        divisor=divide_by,
        modulator=modulator,
        local=local,
        albedo=buffers.albedo,
        normal=buffers.normal,
        depth=buffers.depth,
        depth_unit=depth_unit,
        motion=buffers.motion,
        picture_positions=positions if looks_back else None,
        fresh=fresh,
        worth=worth,
    )


def _demodulate(
    buffers: Buffers,
    divide_by: np.ndarray | None,
    luminance: np.ndarray,
    spec: ModelSpec,
    strips: Strips,
    timings: dict[str, float],
) -> bool:
    """Fill divisor and irradiance's luminance; False, and nothing of use, if repair is needed."""
    # without albedo only the luminance is taken, which exposure needs
    name = "expose" if divide_by is None else "demodulate"
    with timed_pass(timings) as part:

        def work(rows: slice) -> bool:
            scratch = strips.scratch
            with part("repair"):
                if not buffers.in_range(rows):
                    return False
            with part(name):
                irradiance = buffers.color[rows]
                if divide_by is not None and buffers.albedo is not None:
                    divisor(buffers.albedo[rows], spec.demodulate, divide_by[rows], scratch)
                    out = scratch.array("irradiance", irradiance.shape)
                    irradiance = np.divide(irradiance, divide_by[rows], out=out)
                encode.luminance(irradiance, out=luminance[rows])
            return True

        return all(strips.run(work, *luminance.shape))


def _follow_reflections(
    buffers: Buffers,
    luminance: np.ndarray,
    history: History,
    exposure: float,
    black: float,
    strips: Strips,
    timings: dict[str, float],
) -> Buffers:
    if buffers.motion is None or buffers.albedo is None or buffers.depth is None:
        return buffers
    if not mirror.has_mirrors(buffers.albedo, black):
        return buffers
    with timed(timings, "mirror"):
        motion = mirror.follow_reflections(
            buffers.motion,
            buffers.depth,
            buffers.albedo,
            luminance,
            history.mean,
            exposure=exposure,
            black=black,
            strips=strips,
        )
    return replace(buffers, motion=motion)


def _local_luminance(
    luminance: np.ndarray, exposure: float, out: np.ndarray, spec: ModelSpec, strips: Strips
) -> None:
    height, width = luminance.shape

    def work(rows: slice) -> None:
        near, own = with_halo(rows, spec.transfer.local_size // 2, height)
        toned = strips.scratch.array("toned", luminance[near].shape)
        encode.tone_map(luminance[near], exposure, out=toned)
        out[rows] = encode.local_luminance(toned, spec.transfer)[own]

    strips.run(work, height, width)


def rough_blocks(packed: np.ndarray, strips: Strips, kept: Scratch) -> np.ndarray:
    """`reproject.rough_blocks` of a whole frame's guides; the result lies in ``kept``."""
    height, width = packed.shape[:2]
    rough = kept.array("rough", (height + 1, width + 1), np.uint8)

    def work(rows: slice) -> None:
        rep.rough_blocks(packed, rows, rough, strips.scratch)

    strips.run(work, height, width)
    return rough

"""The way of a frame before the network: repair, demodulate, expose, reproject, accumulate."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from stillray import accumulate as acc
from stillray import encode
from stillray import reproject as rep
from stillray.demodulate import divisor
from stillray.frame import Frame
from stillray.models_spec.loader import ModelSpec
from stillray.repair import repair_feature, repair_radiance
from stillray.strips import Strips

MAX_MOTION = 1e6  # pixels; outside of every frame
MAX_DEPTH = 1e30  # any unit; keeps products of depth in float32


@dataclass(frozen=True, kw_only=True, eq=False)
class History:
    """What is remembered of the past: a value that can be kept, dropped or copied.

    Attributes
    ----------
    mean : (h, w, 4) float32
        Accumulated irradiance and, last, the samples that each pixel holds.
    guides : (h, w, 4) float32 or None
        Geometry of the last frame, see `stillray.reproject.pack`.
    exposure
        1 / irradiance, steadied over the sequence.
    output : (h, w, 4) float32 or None
        The last output, see `stillray.recall.remember`; None for models that take none.
    """

    mean: np.ndarray
    guides: np.ndarray | None
    exposure: float
    output: np.ndarray | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Prepared:
    """A frame on its way, ready for the network: also what training learns from.

    Attributes
    ----------
    history
        The history after this frame; its ``mean`` is what the kernels filter.
    divisor : (h, w, 3) float32 or None
        What radiance was divided by; None where there is no albedo.
    local : (h, w) float32
        Tone-mapped local luminance of the accumulated irradiance.
    albedo, normal, depth
        The frame's, repaired.
    depth_unit
        Scale of the depth feature.
    motion : (h, w, 2) float32 or None
        The frame's, finite.
    """

    history: History
    divisor: np.ndarray | None
    local: np.ndarray
    albedo: np.ndarray | None
    normal: np.ndarray | None
    depth: np.ndarray | None
    depth_unit: float
    motion: np.ndarray | None


def prepare(
    frame: Frame,
    spec: ModelSpec,
    history: History | None,
    strips: Strips,
    timings: dict[str, float],
    *,
    temporal: bool = True,
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
    """
    height, width = frame.shape
    with timed(timings, "repair"):
        color, broken = repair_radiance(frame.color)
        albedo = None if frame.albedo is None else repair_feature(frame.albedo, 0, 1)
        normal = None if frame.normal is None else repair_feature(frame.normal, -1, 1)
        depth = None if frame.depth is None else repair_feature(frame.depth, 0, MAX_DEPTH)
        motion = None if frame.motion is None else _far_if_broken(frame.motion)

    irradiance, light = color, np.empty((height, width), np.float32)
    divide_by = None if albedo is None else np.empty_like(color)
    if divide_by is not None:
        irradiance = np.empty_like(color)

    def demodulate(rows: slice) -> None:
        if albedo is not None and divide_by is not None:
            divide_by[rows] = divisor(albedo[rows], spec.demodulate)
            np.divide(color[rows], divide_by[rows], out=irradiance[rows])
        light[rows] = encode.luminance(irradiance[rows])

    # without albedo only the luminance is taken, which exposure needs
    with timed(timings, "expose" if albedo is None else "demodulate"):
        strips.run(demodulate, height, width)
    if history is not None and history.mean.shape[:2] != frame.shape:
        history = None
    with timed(timings, "expose"):
        before = None if history is None else history.exposure
        exposure = encode.steady_exposure(
            encode.frame_exposure(light, spec.transfer), before, spec.transfer
        )
        toned = np.empty_like(light)

        def tone(rows: slice) -> None:
            toned[rows] = encode.tone_map(light[rows], exposure)

        strips.run(tone, height, width)
        local = encode.local_luminance(toned, spec.transfer)

    guides: np.ndarray | None = None
    past: np.ndarray | None = None
    if temporal and not (normal is None and depth is None):
        with timed(timings, "guides"):
            guides = _pack(normal, depth, frame.shape, strips)
    if history is not None and motion is not None:
        with timed(timings, "warp"):
            past = _warp(motion, history, guides, spec, strips)
    mean = np.empty((height, width, 4), np.float32)

    def accumulate(rows: slice) -> None:
        weight = acc.sample_weight(light[rows], local[rows], exposure, spec.temporal)
        if broken is not None:
            weight[broken[rows]] = acc.MIN_WEIGHT
        mean[rows] = acc.accumulate(
            irradiance[rows], weight, None if past is None else past[rows], spec.temporal
        )
        if past is not None:
            toned[rows] = encode.tone_map(encode.luminance(mean[rows]), exposure)

    with timed(timings, "accumulate"):
        strips.run(accumulate, height, width)
        if past is not None:
            local = encode.local_luminance(toned, spec.transfer)
        depth_unit = 1.0 if depth is None else encode.depth_scale(depth)
    return Prepared(
        history=History(mean=mean, guides=guides, exposure=exposure),
        divisor=divide_by,
        local=local,
        albedo=albedo,
        normal=normal,
        depth=depth,
        depth_unit=depth_unit,
        motion=motion,
    )


def _pack(
    normal: np.ndarray | None, depth: np.ndarray | None, shape: tuple[int, int], strips: Strips
) -> np.ndarray:
    packed = np.empty((*shape, 4), np.float32)

    def work(rows: slice) -> None:
        packed[rows] = rep.pack(
            None if normal is None else normal[rows], None if depth is None else depth[rows]
        )

    strips.run(work, *shape)
    return packed


def _far_if_broken(motion: np.ndarray) -> np.ndarray:
    # a point that came from nowhere is one that came from far outside
    with np.errstate(invalid="ignore"):  # Inf - Inf
        total = motion.sum()
    if np.isfinite(total):
        return motion
    return np.where(np.isfinite(motion), motion, np.float32(MAX_MOTION))


def _warp(
    motion: np.ndarray, history: History, guides: np.ndarray | None, spec: ModelSpec, strips: Strips
) -> np.ndarray:
    height, width = motion.shape[:2]
    past = np.empty((height, width, 4), np.float32)
    moving = bool(motion.any())
    before = history.guides
    rough: np.ndarray | None = None
    if moving and before is not None and guides is not None:
        marked = rough = np.ones((height + 1, width + 1), np.uint8)
        strips.run(lambda rows: rep.rough_blocks(before, rows, marked), height, width)

    def work(rows: slice) -> None:
        past[rows] = rep.reproject(
            history.mean,
            before,
            rough,
            None if guides is None else guides[rows],
            motion[rows] if moving else None,
            rows,
            spec.temporal,
        )

    strips.run(work, height, width)
    return past


@contextmanager
def timed(timings: dict[str, float], name: str) -> Iterator[None]:
    """Add the milliseconds of the block to ``timings[name]``."""
    start = time.perf_counter()
    yield
    timings[name] = timings.get(name, 0.0) + 1e3 * (time.perf_counter() - start)

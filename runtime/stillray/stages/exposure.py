"""A frame's light, demodulated, exposed and compared with what it was before."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.strips import with_halo
from stillray.stages import features, history_rejection
from stillray.stages.decide import TemporalPlan
from stillray.stages.demodulate import divisor
from stillray.stages.history_rejection import Brightness
from stillray.stages.means import Means
from stillray.timing import timed

_RELIT = 0.5  # share of the past that is kept, below which the exposure begins anew


@dataclass(frozen=True, kw_only=True, eq=False)
class Exposed:
    """What is known of a frame's light before its past is looked at.

    Attributes
    ----------
    divisor : (h, w, 3) float32 or None
        What radiance is divided by; None where there is no albedo.
    luminance : (h, w) float32
        Luminance of irradiance.
    local : (h, w) float32
        Tone-mapped local luminance.
    exposure
        1 / irradiance, steadied over the sequence.
    depth_unit
        Scale of the depth feature.
    history_confidence : (h, w) float32 or None
        Share of the past that is kept where light has changed, [0, 1]; None for all of it.
    brightness
        For the next frame to compare with.
    """

    divisor: np.ndarray | None
    luminance: np.ndarray
    local: np.ndarray
    exposure: float
    depth_unit: float
    history_confidence: np.ndarray | None
    brightness: Brightness | None


def expose(plan: TemporalPlan, means: Means) -> Exposed:
    """Demodulate a frame, expose it, and find where light is no longer what it was."""
    depth = plan.buffers.depth
    by, luminance = _demodulated(plan, means)
    with timed(means.timings, "expose"):
        exposure = features.frame_exposure(luminance, means.spec.transfer)
    confidence, brightness = _compared(plan, luminance, exposure, means)
    local = means.workspace.array("local", plan.shape)
    with timed(means.timings, "expose"):
        if plan.past is not None and (confidence is None or cv2.mean(confidence)[0] >= _RELIT):
            before = plan.past.exposure
            exposure = features.steady_exposure(exposure, before, means.spec.transfer)
        local_luminance(luminance, exposure, local, means)
        depth_unit = 1.0 if depth is None else features.depth_scale(depth)
    return Exposed(
        divisor=by,
        luminance=luminance,
        local=local,
        exposure=exposure,
        depth_unit=depth_unit,
        history_confidence=confidence,
        brightness=brightness,
    )


def local_luminance(luminance: np.ndarray, exposure: float, out: np.ndarray, means: Means) -> None:
    """`features.local_luminance` of a whole frame ``(h, w)``, tone-mapped; written to ``out``."""
    height, width = luminance.shape
    strips, options = means.strips, means.spec.transfer

    def work(rows: slice) -> None:
        near, own = with_halo(rows, options.local_size // 2, height)
        toned = strips.scratch.array("toned", luminance[near].shape)
        features.tone_map(luminance[near], exposure, out=toned)
        out[rows] = features.local_luminance(toned, options)[own]

    strips.run(work, height, width)


def _demodulated(plan: TemporalPlan, means: Means) -> tuple[np.ndarray | None, np.ndarray]:
    """What color is divided by, and the luminance of what that gives."""
    color, albedo = plan.buffers.color, plan.buffers.albedo
    strips, workspace = means.strips, means.workspace
    luminance = workspace.array("luminance", plan.shape)
    by = None if albedo is None else workspace.array("divisor", color.shape)

    def work(rows: slice) -> None:
        irradiance = color[rows]
        if albedo is not None and by is not None:
            divisor(albedo[rows], means.spec.demodulate, by[rows], strips.scratch)
            out = strips.scratch.array("irradiance", irradiance.shape)
            irradiance = np.divide(irradiance, by[rows], out=out)
        features.luminance(irradiance, out=luminance[rows])

    # without albedo only the luminance is taken, which exposure needs
    with timed(means.timings, "expose" if by is None else "demodulate"):
        strips.run(work, *plan.shape)
    return by, luminance


def _compared(
    plan: TemporalPlan, luminance: np.ndarray, exposure: float, means: Means
) -> tuple[np.ndarray | None, Brightness | None]:
    """How much of the past is kept where light has changed, and what the next frame needs."""
    if not plan.runs("reject"):
        return None, None
    before, motion = None if plan.past is None else plan.past.brightness, plan.buffers.motion
    with timed(means.timings, "reject"):
        now = history_rejection.brightness(luminance, exposure, means.strips)
        if now is None or before is None or motion is None:
            return None, now
        return history_rejection.follow(now, before, motion, exposure)

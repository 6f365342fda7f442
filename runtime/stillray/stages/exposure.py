"""A frame's light, demodulated and exposed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stillray.arrays.strips import with_halo
from stillray.stages import features
from stillray.stages.decide import TemporalPlan
from stillray.stages.demodulate import demodulation_albedo
from stillray.stages.means import Means
from stillray.timing import timed


@dataclass(frozen=True, kw_only=True, eq=False)
class Exposed:
    """What is known of a frame's light before its past is looked at.

    Attributes
    ----------
    demodulation_albedo : (h, w, 3) float32 or None
        What radiance is divided by; None where there is no albedo.
    luminance : (h, w) float32
        Luminance of irradiance.
    local : (h, w) float32
        Tone-mapped local luminance.
    exposure
        1 / irradiance, steadied over the sequence.
    own_exposure
        Of this frame alone.
    depth_unit
        Scale of the depth feature.
    """

    demodulation_albedo: np.ndarray | None
    luminance: np.ndarray
    local: np.ndarray
    exposure: float
    own_exposure: float
    depth_unit: float


def expose(plan: TemporalPlan, means: Means) -> Exposed:
    """Demodulate a frame and expose it."""
    depth = plan.buffers.depth
    by, luminance = _demodulated(plan, means)
    with timed(means.timings, "expose"):
        own = exposure = features.frame_exposure(luminance, means.spec.transfer)
        means.strips.watch.look()
        local = means.workspace.array("local", plan.shape)
        if plan.past is not None:
            exposure = features.steady_exposure(own, plan.past.exposure, means.spec.transfer)
        local_luminance(luminance, exposure, local, means)
        depth_unit = 1.0 if depth is None else features.depth_scale(depth)
        means.strips.watch.look()
    return Exposed(
        demodulation_albedo=by,
        luminance=luminance,
        local=local,
        exposure=exposure,
        own_exposure=own,
        depth_unit=depth_unit,
    )


def expose_anew(exposed: Exposed, means: Means) -> Exposed:
    """The same light without the exposure of the past; overwrites ``local``."""
    with timed(means.timings, "expose"):
        local_luminance(exposed.luminance, exposed.own_exposure, exposed.local, means)
    return replace(exposed, exposure=exposed.own_exposure)


def local_luminance(luminance: np.ndarray, exposure: float, out: np.ndarray, means: Means) -> None:
    """`features.local_luminance` of a whole frame ``(h, w)``, tone-mapped; written to ``out``."""
    height, width = luminance.shape
    strips, options = means.strips, means.spec.transfer

    def work(rows: slice) -> None:
        near, own = with_halo(rows, options.local_size // 2, height)
        toned = strips.workspace.array("toned", luminance[near].shape)
        features.tone_map(luminance[near], exposure, out=toned)
        out[rows] = features.local_luminance(toned, options)[own]

    strips.run(work, height, width)


def _demodulated(plan: TemporalPlan, means: Means) -> tuple[np.ndarray | None, np.ndarray]:
    """What color is divided by, and the luminance of what that gives."""
    color, albedo = plan.buffers.color, plan.buffers.albedo
    strips, workspace = means.strips, means.workspace
    luminance = workspace.array("luminance", plan.shape)
    by = None if albedo is None else workspace.array("demodulation_albedo", color.shape)

    def work(rows: slice) -> None:
        irradiance = color[rows]
        if albedo is not None and by is not None:
            demodulation_albedo(albedo[rows], means.spec.demodulate, by[rows], strips.workspace)
            out = strips.workspace.array("irradiance", irradiance.shape)
            irradiance = np.divide(irradiance, by[rows], out=out)
        features.luminance(irradiance, out=luminance[rows])

    # without albedo only the luminance is taken, which exposure needs
    with timed(means.timings, "expose" if by is None else "demodulate"):
        strips.run(work, *plan.shape)
    return by, luminance

"""Which stages a frame calls for, and why: a stage that is not called for is not run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillray.families.registry import FAMILIES
from stillray.frame import Frame
from stillray.model_spec.loader import ModelSpec
from stillray.stages.specular_motion import has_mirrors


@dataclass(frozen=True)
class Stage:
    """One stage of the way of a frame.

    Attributes
    ----------
    name
        As in the timings.
    runs
        Whether this frame calls for it.
    reason
        Why, or why not.
    """

    name: str
    runs: bool
    reason: str


def plan(
    frame: Frame,
    spec: ModelSpec,
    *,
    has_history: bool,
    temporal: bool,
    had_albedo: bool = True,
) -> list[Stage]:
    """The stages for one frame, in the order they run.

    Parameters
    ----------
    frame, spec
        What is denoised, by which model.
    has_history
        Whether there is a past of the frame's size.
    temporal
        Whether the past is used.
    had_albedo
        Whether the last frame had albedo.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        total = float(frame.color.sum(dtype=np.float64))
    broken = not np.isfinite(total) or float(frame.color.min()) < 0
    moving = frame.motion is not None and bool(frame.motion.any())
    if not temporal:
        past, why = False, "temporal accumulation is switched off"
    elif not has_history:
        past, why = False, "first frame, or the first after a reset or a new size"
    elif frame.motion is None:
        past, why = False, "no motion given: where the past went is not known"
    else:
        past, why = True, "history and motion are there"
    family = FAMILIES[spec.family]
    albedo = frame.albedo is not None
    geometry = temporal and (frame.normal is not None or frame.depth is not None)
    if geometry:
        why_guides = "normal or depth tell surfaces apart"
    else:
        why_guides = "no normal or depth given" if temporal else why
    follows, why_mirror = False, "only motion, depth, albedo and a past tell what a mirror shows"
    if past and frame.depth is not None and frame.albedo is not None:
        follows = has_mirrors(frame.albedo, spec.demodulate.black)
        why_mirror = f"{'some' if follows else 'no'} surfaces are black, as mirrors and glass are"
    smooth = spec.temporal.albedo_samples > 0
    why_antialias = "the model smooths edges otherwise" if not smooth else why
    if smooth and past:
        why_antialias = "albedo is given" if albedo else "no albedo given"
        why_antialias = why_antialias if had_albedo else "the last frame had no albedo"
    why_modulate = "albedo is given" if albedo else "no albedo given"
    if albedo and family.recalls:
        why_modulate = "the reconstruction does it, before it resolves"
    return [
        Stage(
            "repair",
            broken,
            "color holds NaN, infinities or negatives" if broken else "color is finite and >= 0",
        ),
        Stage("demodulate", albedo, "albedo is given" if albedo else "no albedo given"),
        Stage("expose", True, "features are relative to the frame's brightness"),
        Stage("mirror", follows, why_mirror),
        Stage("guides", geometry, why_guides),
        Stage(
            "warp",
            past and moving,
            why if not past else "motion is given" if moving else "motion is zero everywhere",
        ),
        Stage("accumulate", past, why),
        Stage("antialias", smooth and past and albedo and had_albedo, why_antialias),
        Stage(
            "recall",
            past and family.recalls,
            why if family.recalls else "the model does not look at its last output",
        ),
        Stage("encode", True, f"{len(spec.network.features)} planes for the network"),
        Stage("network", True, spec.name),
        Stage("reconstruct", True, family.method(spec)),
        Stage("upscale", False, "the model's scale is 1"),
        Stage("modulate", albedo and not family.recalls, why_modulate),
    ]

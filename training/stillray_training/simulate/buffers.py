"""One frame's buffers: colour, features and motion from the same samples; references."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillray_training.simulate.paths import CameraPath
from stillray_training.simulate.stage import Stage
from stillray_training.simulate.trace import (
    Samples,
    Shot,
    first_hits,
    launches,
    radiance,
    surfaces,
)

SHUTTER_STRATA = 8  # of a noisy frame under motion blur
REFERENCE_STRATA = 32  # of a reference under motion blur


@dataclass(frozen=True, kw_only=True)
class Moment:
    """A frame of a sequence: when it is and from where it is seen."""

    frame: int
    path: CameraPath
    focus: float  # metres
    jitter: np.ndarray  # (2,) pixels, x right and y down
    clamp: float | None = None  # radiance of one contribution of indirect light; None: any
    spread: float = 1.0  # part of their pixel that samples of noisy frames fill, 0 to 1


def render_noisy(stage: Stage, moment: Moment, *, spp: int, seed: int) -> dict[str, np.ndarray]:
    """Render one noisy frame and its features, all from the same camera samples.

    Parameters
    ----------
    stage
        The scene.
    moment
        The frame.
    spp
        Samples a pixel, 1 or more.
    seed
        The same seed gives the same pixels.

    Returns
    -------
    dict
        ``color``, ``albedo``, ``normal`` ``(h, w, 3)``, ``depth`` ``(h, w)`` camera z with 0 where
        nothing was hit, ``motion`` ``(h, w, 2)`` previous minus current position in pixels,
        without jitter, of the point on its object; the background moves as a point at infinity
        does. ``roughness`` and ``specular_albedo`` where the plan wants them.
    """
    height, width = stage.height, stage.width
    rng = np.random.default_rng([seed, 1])
    sums: Samples = {}
    for index, share in enumerate(launches(spp, height * width)):
        # seeds of strata lie nearer together than those of launches
        part = _samples(stage, moment, share, seed + 1000 * index, rng)
        for name, values in part.items():
            sums[name] = sums[name] + values if name in sums else values
    return _resolve({name: values / spp for name, values in sums.items()}, height, width)


def _samples(
    stage: Stage, moment: Moment, spp: int, seed: int, rng: np.random.Generator
) -> Samples:
    """Sums over the samples of one launch, ``spp`` of each pixel."""
    count = stage.height * stage.width
    if not stage.plan.shutter:
        shot = _open_shutter(stage, moment, float(moment.frame))
        return first_hits(stage, shot, np.arange(count), seed, spp)
    times = shutter_times(moment.frame, stage.plan.shutter, SHUTTER_STRATA, rng)
    pixels = np.repeat(np.arange(count), spp)
    stratum = rng.integers(SHUTTER_STRATA, size=pixels.size)
    sums: Samples = {}
    for index, time in enumerate(times):
        chosen = pixels[stratum == index]
        if not chosen.size:
            continue
        shot = _open_shutter(stage, moment, time)
        for name, values in first_hits(stage, shot, chosen, seed + index).items():
            total = sums.setdefault(name, np.zeros((count, *values.shape[1:])))
            np.add.at(total, chosen, values)
    return sums


def _open_shutter(stage: Stage, moment: Moment, time: float) -> Shot:
    """Pose and aim the stage for a time in frames."""
    camera = moment.path(time)
    stage.pose(time)
    stage.aim(camera, moment.focus)
    return Shot(
        time=time,
        camera=camera,
        previous=moment.path(time - 1),
        jitter=moment.jitter,
        clamp=moment.clamp,
        spread=moment.spread,
    )


def render_second(stage: Stage, moment: Moment, *, spp: int, seed: int) -> np.ndarray:
    """Render an independent estimate of the same frame's colour, ``(h, w, 3)``."""
    return render_noisy(stage, moment, spp=spp, seed=seed)["color"]


def render_reference(stage: Stage, moment: Moment, *, spp: int, seed: int) -> np.ndarray:
    """Render the reference radiance, ``(h, w, 3)`` at the reference scale."""
    strata = min(REFERENCE_STRATA, spp) if stage.plan.shutter else 1
    rng = np.random.default_rng([seed, 2])
    total = np.zeros(())
    for index, time in enumerate(shutter_times(moment.frame, stage.plan.shutter, strata, rng)):
        stage.pose(time)
        stage.aim(moment.path(time), moment.focus)
        share = spp // strata + (index < spp % strata)
        # seeds of strata lie apart by more than the launches of one
        sensor = stage.reference_sensor
        part = radiance(stage, sensor, share, seed + 1000 * index, moment.clamp)
        # every stratum is the same part of the shutter time, whatever its share of the samples
        total = total + part.astype(np.float64) / strata
    return np.asarray(total, np.float32)


def render_reference_features(
    stage: Stage, moment: Moment, *, spp: int, seed: int
) -> dict[str, np.ndarray]:
    """Albedo, normal and guides at the reference scale, means of many samples.

    Without motion blur: all samples are of the middle of the frame.
    """
    stage.pose(float(moment.frame))
    stage.aim(moment.path(float(moment.frame)), moment.focus)
    scale = stage.plan.wants.reference_scale
    return _surfaces(surfaces(stage, spp, seed), stage.height * scale, stage.width * scale)


def shutter_times(frame: int, shutter: float, strata: int, rng: np.random.Generator) -> np.ndarray:
    """One random time in each stratum of the open shutter, which is centred on the frame."""
    if not shutter:
        return np.array([float(frame)])
    return frame + shutter * ((np.arange(strata) + rng.random(strata)) / strata - 0.5)


def _resolve(means: Samples, height: int, width: int) -> dict[str, np.ndarray]:
    """Layers from the means of each pixel's samples; depth and normal over those that hit."""
    hits = np.maximum(means["hit"], 1e-9)
    lit = {
        "color": means["color"],
        "depth": means["depth"] / hits,
        "motion": means["motion"],
    }
    return {**_shaped(lit, height, width), **_surfaces(means, height, width)}


def _surfaces(means: Samples, height: int, width: int) -> dict[str, np.ndarray]:
    """Layers of what the first surfaces are."""
    length = np.linalg.norm(means["normal"], axis=-1, keepdims=True)
    layers = {
        "albedo": np.clip(means["albedo"], 0, 1),
        "normal": np.divide(
            means["normal"], length, out=np.zeros_like(means["normal"]), where=length > 1e-6
        ),
    }
    layers.update({name: means[name] for name in ("roughness", "specular_albedo") if name in means})
    return _shaped(layers, height, width)


def _shaped(layers: Samples, height: int, width: int) -> dict[str, np.ndarray]:
    return {
        name: np.asarray(values, np.float32).reshape(height, width, *values.shape[1:])
        for name, values in layers.items()
    }

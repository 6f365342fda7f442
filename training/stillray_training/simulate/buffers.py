"""One frame's buffers: colour, features and motion from the same samples; references."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillray_training.simulate.camera import Camera
from stillray_training.simulate.paths import CameraPath
from stillray_training.simulate.stage import Stage
from stillray_training.simulate.trace import Samples, first_hits, launches, radiance

SHUTTER_STRATA = 8  # of a noisy frame under motion blur
REFERENCE_STRATA = 32  # of a reference under motion blur


@dataclass(frozen=True, kw_only=True)
class Moment:
    """A frame of a sequence: when it is and from where it is seen."""

    frame: int
    path: CameraPath
    focus: float  # metres
    jitter: np.ndarray  # (2,) pixels, x right and y down


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
        samples = _samples(stage, moment, share, seed + 1000 * index, rng)
        # samples that hit nothing carry no normal
        samples["normal"] = np.where(samples["hit"][:, None] > 0, samples["normal"], 0)
        for name, values in samples.items():
            part = values.reshape(height * width, share, *values.shape[1:]).sum(axis=1)
            sums[name] = sums[name] + part if name in sums else part
    return _resolve({name: values / spp for name, values in sums.items()}, height, width)


def _samples(
    stage: Stage, moment: Moment, spp: int, seed: int, rng: np.random.Generator
) -> Samples:
    """All samples of one launch, ``spp`` after ``spp`` for each pixel."""
    count = stage.height * stage.width
    strata = SHUTTER_STRATA if stage.plan.shutter else 1
    times = shutter_times(moment.frame, stage.plan.shutter, strata, rng)
    pixels = np.repeat(np.arange(count), spp)
    stratum = rng.integers(strata, size=pixels.size) if strata > 1 else np.zeros(pixels.size, int)
    merged: Samples = {}
    for index, time in enumerate(times):
        chosen = np.flatnonzero(stratum == index)
        if not chosen.size:
            continue
        camera = moment.path(time)
        stage.pose(time)
        stage.aim(camera, moment.focus)
        seen = first_hits(
            stage, pixels[chosen], seed + index, moment.jitter, stage.plan.wants.guides
        )
        seen["depth"], seen["motion"] = _motion(stage, seen, time, camera, moment.path(time - 1))
        for name, values in seen.items():
            merged.setdefault(name, np.zeros((pixels.size, *values.shape[1:])))[chosen] = values
    return merged


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
        part = radiance(stage, stage.reference_sensor, share, seed + 1000 * index)
        # every stratum is the same part of the shutter time, whatever its share of the samples
        total = total + part.astype(np.float64) / strata
    return np.asarray(total, np.float32)


def shutter_times(frame: int, shutter: float, strata: int, rng: np.random.Generator) -> np.ndarray:
    """One random time in each stratum of the open shutter, which is centred on the frame."""
    if not shutter:
        return np.array([float(frame)])
    return frame + shutter * ((np.arange(strata) + rng.random(strata)) / strata - 0.5)


def _motion(
    stage: Stage, seen: Samples, time: float, camera: Camera, previous: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """Camera z and motion of each sample."""
    height, width = stage.height, stage.width
    hit = seen["hit"] > 0
    direction = seen["direction"]
    position = np.where(hit[:, None], seen["position"], camera.to_world[:3, 3] + direction)
    x, y, depth = camera.project(position, height, width)
    earlier = position.copy()
    if "object" in seen:
        now, before = stage.matrices(time), stage.matrices(time - 1)
        for index, group in enumerate(stage.groups, start=1):
            on = seen["object"] == index
            # back to where the point was when the object stood in its first place, then forward
            carry = before[group] @ np.linalg.inv(now[group])
            earlier[on] = position[on] @ carry[:3, :3].T + carry[:3, 3]
    was_x, was_y, _ = previous.project(earlier, height, width)
    far_x, far_y = camera.project_direction(direction, height, width)
    far_was_x, far_was_y = previous.project_direction(direction, height, width)
    motion = np.where(
        hit[:, None],
        np.stack([was_x - x, was_y - y], -1),
        np.stack([far_was_x - far_x, far_was_y - far_y], -1),
    )
    return np.where(hit, depth, 0.0), motion


def _resolve(means: Samples, height: int, width: int) -> dict[str, np.ndarray]:
    """Layers from the means of each pixel's samples; depth and normal over those that hit."""
    hits = np.maximum(means["hit"], 1e-9)
    length = np.linalg.norm(means["normal"], axis=-1, keepdims=True)
    layers = {
        "color": means["color"],
        "albedo": np.clip(means["albedo"], 0, 1),
        "normal": np.divide(
            means["normal"], length, out=np.zeros_like(means["normal"]), where=length > 1e-6
        ),
        "depth": means["depth"] / hits,
        "motion": means["motion"],
    }
    layers.update({name: means[name] for name in ("roughness", "specular_albedo") if name in means})
    return {
        name: np.asarray(values, np.float32).reshape(height, width, *values.shape[1:])
        for name, values in layers.items()
    }

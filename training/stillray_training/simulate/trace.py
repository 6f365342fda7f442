"""Camera samples and what they see, for every Mitsuba variant.

Samples are drawn here and not by Mitsuba's own loop over the film, so that each one's position,
lens point, shutter time and first hit are known, and no number is drawn that no effect asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from stillray_training.simulate.camera import Camera
from stillray_training.simulate.relay import clamped, path_radiance, relay_radiance
from stillray_training.simulate.shading_normal import shading_normal
from stillray_training.simulate.stage import HULL, Stage

LANES = 1 << 22  # samples a launch: bounds the memory
_LOBE_SAMPLES = 8  # directions that estimate a specular albedo

Samples = dict[str, np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Shot:
    """When and from where samples are taken."""

    time: float  # frames
    camera: Camera
    previous: Camera  # one frame before
    jitter: np.ndarray  # (2,) offset of all samples in pixels, x right and y down
    clamp: float | None = None  # see `relay.relay_radiance`; None: indirect light as it is
    spread: float = 1.0  # part of their pixel that samples fill, around its centre, 0 to 1


def first_hits(stage: Stage, shot: Shot, pixels: np.ndarray, seed: int, each: int = 1) -> Samples:
    """Trace samples of pixels and record what they see first.

    Parameters
    ----------
    stage
        Posed and aimed.
    shot
        Its cameras give depth and motion.
    pixels : (n,)
        Pixel numbers, row by row; any order, any number of times.
    seed
        The same seed gives the same samples.
    each
        Samples of each of the pixels, 1 or more.

    Returns
    -------
    dict
        Sums over the samples of each of the pixels: ``color``, ``albedo``, ``normal`` ``(n, 3)``,
        ``depth`` ``(n,)`` camera z and 0 without a hit, ``motion`` ``(n, 2)`` in pixels, ``hit``
        ``(n,)``, and the guides that the plan wants.
    """
    return _sums(
        stage, lambda sampler, number: sample(stage, shot, sampler, number), pixels, seed, each
    )


def surfaces(stage: Stage, spp: int, seed: int) -> Samples:
    """Means of what samples of the reference sensor see first, without any light.

    Parameters
    ----------
    stage
        Posed and aimed.
    spp
        Samples a pixel, 1 or more.
    seed
        The same seed gives the same samples.

    Returns
    -------
    dict
        ``hit`` ``(n,)``, ``albedo`` and ``normal`` ``(n, 3)`` and the guides that the plan wants,
        of all pixels, row by row.
    """
    sensor = stage.reference_sensor
    width, height = (int(v) for v in np.array(sensor.film().size()))
    pixels, sums = np.arange(height * width), Samples()

    def see(sampler: Any, number: Any) -> dict[str, Any]:
        ray, _ = _camera_ray(stage, sampler, sensor, number, np.zeros(2))
        return _surface(stage, sampler, ray)[0]

    for index, share in enumerate(launches(spp, height * width)):
        for name, values in _sums(stage, see, pixels, seed + index, share).items():
            sums[name] = sums[name] + values if name in sums else values
    return {name: values / spp for name, values in sums.items()}


def _sums(
    stage: Stage,
    see: Callable[[Any, Any], dict[str, Any]],
    pixels: np.ndarray,
    seed: int,
    each: int,
) -> Samples:
    """Sums over ``each`` samples of pixels of what ``see`` gives for a sampler and a number."""
    sampler = stage.mi.load_dict({"type": "independent"})
    if "scalar" not in stage.mi.variant():
        import drjit as dr

        sampler.seed(seed, len(pixels) * each)
        # repeated here: in the kernel it would be another one for every number of samples
        number = stage.mi.UInt32(np.repeat(pixels.astype(np.uint32), each))
        seen = see(sampler, number)
        dr.eval(seen)  # before the sums: each would trace all of it again
        return {name: _planar(value, each) for name, value in seen.items()}
    sampler.seed(seed)
    rows = [see(sampler, int(number)) for number in np.repeat(pixels, each)]
    values = {name: np.array([np.array(row[name], np.float64) for row in rows]) for name in rows[0]}
    return {
        name: value.reshape(len(pixels), each, *value.shape[1:]).sum(axis=1)
        for name, value in values.items()
    }


def radiance(
    stage: Stage, sensor: Any, spp: int, seed: int, clamp: float | None = None
) -> np.ndarray:
    """Mean radiance ``(h, w, 3)`` of that many samples a pixel, in launches of bounded memory."""
    mi = stage.mi
    if "scalar" not in mi.variant() and stage.plan.integrator.plugin == "path":
        return np.asarray(relay_radiance(stage, sensor, spp, seed, LANES, clamp), np.float32)
    width, height = (int(v) for v in np.array(sensor.film().size()))
    total = np.zeros((height, width, 3))
    for index, count in enumerate(launches(spp, height * width)):
        if "scalar" in mi.variant():
            # its own loop over the film runs on all cores; from Python it would run on one
            part = stage.reference_integrator.render(
                stage.scene, sensor, seed=seed + index, spp=count
            )
            part = np.array(part, np.float64)[..., :3]
        else:
            part = radiance_jit(stage, sensor, count, seed + index, clamp)
        total += count * np.where(np.isfinite(part), part, 0)
    return np.asarray(total / spp, np.float32)


def launches(spp: int, pixels: int) -> Iterator[int]:
    """Samples a pixel of each launch: as few launches as memory allows."""
    most = max(1, LANES // pixels)
    while spp > 0:
        yield min(spp, most)
        spp -= most


def radiance_jit(
    stage: Stage, sensor: Any, spp: int, seed: int, clamp: float | None = None
) -> np.ndarray:
    import drjit as dr

    mi = stage.mi
    width, height = (int(v) for v in np.array(sensor.film().size()))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, height * width * spp)
    # opaque: another count must not compile another kernel
    number = dr.arange(mi.UInt32, height * width * spp) // dr.opaque(mi.UInt32, spp)
    ray, weight = _camera_ray(stage, sampler, sensor, number, np.zeros(2))
    # where light is bounded, frames and references must end paths alike, see `relay_radiance`
    integrator = stage.reference_integrator if clamp is None else stage.integrator
    light, _, _ = integrator.sample(stage.scene, sampler, ray, stage.medium)
    color = light * weight
    if clamp is not None:
        color = clamped(color, dr.opaque(mi.Float, clamp))
    dr.eval(color)  # before the sums: each would trace all of it again
    if spp > 1:
        color = [dr.block_sum(channel, spp) / spp for channel in color]
    return np.stack([np.array(channel) for channel in color], -1).reshape(height, width, 3)


def sample(stage: Stage, shot: Shot, sampler: Any, number: Any) -> dict[str, Any]:
    """One sample (scalar variants) or a wavefront of them: colour and first hit."""
    ray, weight = _camera_ray(stage, sampler, stage.sensor, number, shot.jitter, shot.spread)
    color = _light(stage, sampler, ray, weight, shot.clamp)
    return {"color": color, "direction": ray.d, **_features(stage, sampler, ray, shot)}


def _camera_ray(
    stage: Stage,
    sampler: Any,
    sensor: Any,
    number: Any,
    jitter: np.ndarray,
    spread: float = 1.0,
) -> tuple[Any, Any]:
    """Rays of camera samples in the given pixels, and what their radiance is multiplied by."""
    mi = stage.mi
    width, height = (int(v) for v in np.array(sensor.film().size()))
    row = number // width
    inside = sampler.next_2d()
    shift = _vector(mi, np.array([*(jitter + 0.5 * (1 - spread)), spread]))
    place = mi.Point2f(
        (mi.Float(number - row * width) + shift[2] * inside[0] + shift[0]) / width,
        (mi.Float(row) + shift[2] * inside[1] + shift[1]) / height,
    )
    lens = sampler.next_2d() if sensor.needs_aperture_sample() else mi.Point2f(0.5, 0.5)
    ray, weight = sensor.sample_ray(0.0, 0.5, place, lens)
    return mi.RayDifferential3f(ray), weight


def _light(stage: Stage, sampler: Any, ray: Any, weight: Any, clamp: float | None) -> Any:
    """Radiance of camera samples of noisy frames."""
    mi = stage.mi
    if clamp is None or "scalar" in mi.variant():
        return stage.integrator.sample(stage.scene, sampler, ray, stage.medium)[0] * weight
    if stage.plan.integrator.plugin == "path":
        return path_radiance(stage, sampler, ray, weight, clamp)
    # Mitsuba's volumetric loop does not tell direct light from indirect: all of it is bounded
    light = stage.integrator.sample(stage.scene, sampler, ray, stage.medium)[0] * weight
    return clamped(light, mi.Float(clamp))


def _features(stage: Stage, sampler: Any, ray: Any, shot: Shot) -> dict[str, Any]:
    seen, si, hit = _surface(stage, sampler, ray)
    seen.update(_motion(stage, shot, ray, si, hit))
    return seen


def _surface(stage: Stage, sampler: Any, ray: Any) -> tuple[dict[str, Any], Any, Any]:
    """What is known of the first surface alone; where it was met, and whether."""
    import drjit as dr

    guides = stage.plan.wants.guides
    mi, scalar = stage.mi, "scalar" in stage.mi.variant()
    si = stage.scene.ray_intersect(ray)
    hit = si.is_valid()
    shape = si.shape
    if stage.plan.medium is not None:
        # the hull is no surface: what is seen through it is the background
        hull = next(s for s in stage.scene.shapes() if s.id() == HULL)
        hit = hit and shape.id() != HULL if scalar else hit & (shape != mi.ShapePtr(hull))
    normal = shading_normal(mi, stage.bent, si, hit)
    seen: dict[str, Any] = {
        "hit": float(hit) if scalar else dr.select(hit, mi.Float(1), 0),
        "normal": _choose(hit, normal, mi.Normal3f(0)),
    }
    if scalar:
        bsdf = si.bsdf() if hit else None
        seen["albedo"] = bsdf.eval_diffuse_reflectance(si) if bsdf else mi.Color3f(0)
    else:
        bsdf = si.bsdf(ray)
        seen["albedo"] = dr.select(hit, bsdf.eval_diffuse_reflectance(si, hit), 0)
    if "roughness" in guides:
        seen["roughness"] = _pick(stage, shape, hit, stage.roughness(), si, 1.0)
    if "specular_albedo" in guides:
        seen["specular_albedo"] = _specular_albedo(mi, sampler, bsdf, si, hit)
    return seen, si, hit


def _choose(mask: Any, value: Any, other: Any) -> Any:
    """`drjit.select` that scalar variants have too."""
    import drjit as dr

    return (value if mask else other) if isinstance(mask, bool) else dr.select(mask, value, other)


def _motion(stage: Stage, shot: Shot, ray: Any, si: Any, hit: Any) -> dict[str, Any]:
    """Camera z, and where each point of each object was one frame before minus where it is now.

    The background moves as points at infinity do.
    """
    mi = stage.mi
    size = (stage.height, stage.width)
    place = mi.Vector3f(si.p)
    earlier = mi.Vector3f(place)
    if stage.movers:
        number = _pick(stage, si.shape, hit, [(s, index) for s, index in stage.movers], si, 0)
        now, before = stage.matrices(shot.time), stage.matrices(shot.time - 1)
        for index, group in enumerate(stage.groups, start=1):
            # back to where the point was when the object stood in its first place, then forward
            carry = before[group] @ np.linalg.inv(now[group])
            earlier = _choose(number == index, _moved(mi, carry, place), earlier)
    own, old = shot.camera, shot.previous
    here, there = _project(mi, own, place, size), _project(mi, old, earlier, size)
    # what is far away stands where its direction points, whatever the camera's place
    far, was = (_at_infinity(mi, c, ray, size) for c in (own, old))
    x, y = (_choose(hit, there[k] - here[k], was[k] - far[k]) for k in range(2))
    return {"depth": _choose(hit, here[2], mi.Float(0)), "motion": mi.Vector2f(x, y)}


def _at_infinity(mi: Any, camera: Camera, ray: Any, size: tuple[int, int]) -> tuple[Any, Any, Any]:
    place = mi.Vector3f(ray.d) + _vector(mi, camera.to_world[:3, 3])
    return _project(mi, camera, place, size)


def _moved(mi: Any, matrix: np.ndarray, place: Any) -> Any:
    import drjit as dr

    rows = [_vector(mi, row[:3]) for row in matrix[:3]]
    shift = _vector(mi, matrix[:3, 3])
    return mi.Vector3f(*(dr.dot(row, place) for row in rows)) + shift


def _vector(mi: Any, values: np.ndarray) -> Any:
    """Three numbers as data: as constants they would compile another kernel for every frame."""
    if "scalar" in mi.variant():
        return mi.Vector3f(*map(float, values))
    import drjit as dr

    return mi.Vector3f(*(dr.opaque(mi.Float, float(value)) for value in values))


def _project(mi: Any, camera: Camera, place: Any, size: tuple[int, int]) -> tuple[Any, Any, Any]:
    """`Camera.project` of Mitsuba's vectors."""
    import drjit as dr

    height, width = size
    away = place - _vector(mi, camera.to_world[:3, 3])
    left, up, z = (dr.dot(away, _vector(mi, axis)) for axis in camera.to_world[:3, :3].T)
    focal = float(0.5 * width / np.tan(np.radians(camera.fov_x) / 2))
    if "scalar" not in mi.variant():
        focal = dr.opaque(mi.Float, focal)
    safe = _choose(dr.abs(z) > 1e-9, z, mi.Float(1e-9))
    return 0.5 * width - focal * left / safe, 0.5 * height - focal * up / safe, z


def _pick(
    stage: Stage, shape: Any, hit: Any, table: list[tuple[Any, Any]], si: Any, otherwise: float
) -> Any:
    """A value by shape: a number, or a texture that is looked up."""
    import drjit as dr

    mi = stage.mi
    if "scalar" in mi.variant():
        for one, value in table:
            if hit and one.id() == shape.id():
                return value.eval_1(si) if hasattr(value, "eval_1") else float(value)
        return otherwise
    result = mi.Float(otherwise)
    for one, value in table:
        mask = hit & (shape == mi.ShapePtr(one))
        if hasattr(value, "eval_1"):
            value = value.eval_1(si, mask)
        result = dr.select(mask, value, result)
    return result


def _specular_albedo(mi: Any, sampler: Any, bsdf: Any, si: Any, hit: Any) -> Any:
    """Reflected and transmitted part of the light in glossy and smooth lobes, from a few samples.

    The mean weight of directions drawn from those lobes alone is their directional albedo.
    """
    import drjit as dr

    scalar = "scalar" in mi.variant()
    if scalar and not hit:
        return mi.Color3f(0)
    context = mi.BSDFContext()
    context.type_mask = mi.BSDFFlags.Glossy | mi.BSDFFlags.Delta
    total = mi.Color3f(0)
    for _ in range(_LOBE_SAMPLES):
        lobe, direction = sampler.next_1d(), sampler.next_2d()
        if scalar:
            total += bsdf.sample(context, si, lobe, direction)[1]
        else:
            total += dr.select(hit, bsdf.sample(context, si, lobe, direction, hit)[1], 0)
    return dr.clip(total / _LOBE_SAMPLES, 0, 1)


def _planar(value: Any, each: int) -> np.ndarray:
    """Sums over neighbours, ``(n,)`` or ``(n, channels)``."""
    import drjit as dr

    channels = list(value) if dr.depth_v(value) > 1 else [value]
    sums = [dr.block_sum(one, each) if each > 1 else one for one in channels]
    planes = [np.array(one, np.float64) for one in sums]
    return planes[0] if len(planes) == 1 else np.stack(planes, -1)

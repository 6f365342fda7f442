"""Camera samples and what they see, for every Mitsuba variant.

Samples are drawn here and not by Mitsuba's own loop over the film, so that each one's position,
lens point, shutter time and first hit are known, and no number is drawn that no effect asked for.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from stillray_training.simulate.relay import relay_radiance
from stillray_training.simulate.stage import HULL, Stage

_LANES = 1 << 22  # samples a launch: bounds the memory
_LOBE_SAMPLES = 8  # directions that estimate a specular albedo

Samples = dict[str, np.ndarray]


def first_hits(
    stage: Stage, pixels: np.ndarray, seed: int, jitter: np.ndarray, guides: tuple[str, ...]
) -> Samples:
    """Trace one sample of each pixel and record what it sees first.

    Parameters
    ----------
    stage
        Posed and aimed.
    pixels : (n,)
        Pixel numbers, row by row; any order, any number of times.
    seed
        The same seed gives the same samples.
    jitter : (2,)
        Offset of all samples in pixels, x right and y down.
    guides
        Names of `stillray_training.simulate.plan.GUIDES` to add.

    Returns
    -------
    dict
        ``color``, ``albedo``, ``normal``, ``position``, ``direction`` ``(n, 3)``, ``hit`` ``(n,)``
        bool, ``object`` ``(n,)`` object index where something moves, and the guides.
    """
    if "scalar" not in stage.mi.variant():
        sampler = stage.mi.load_dict({"type": "independent"})
        sampler.seed(seed, len(pixels))
        number = stage.mi.UInt32(pixels.astype(np.uint32))
        seen = _sample(stage, sampler, number, jitter, guides)
        import drjit as dr

        dr.eval(seen)
        return {name: _planar(value) for name, value in seen.items()}
    sampler = stage.mi.load_dict({"type": "independent"})
    sampler.seed(seed)
    rows = [_sample(stage, sampler, int(number), jitter, guides) for number in pixels]
    return {name: np.array([row[name] for row in rows], np.float64) for name in rows[0]}


def radiance(stage: Stage, sensor: Any, spp: int, seed: int) -> np.ndarray:
    """Mean radiance ``(h, w, 3)`` of that many samples a pixel, in launches of bounded memory."""
    mi = stage.mi
    if "scalar" not in mi.variant() and stage.plan.integrator.plugin == "path":
        return np.asarray(relay_radiance(stage, sensor, spp, seed, _LANES), np.float32)
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
            part = _radiance_jit(stage, sensor, count, seed + index)
        total += count * np.where(np.isfinite(part), part, 0)
    return np.asarray(total / spp, np.float32)


def launches(spp: int, pixels: int) -> Iterator[int]:
    """Samples a pixel of each launch: as few launches as memory allows."""
    most = max(1, _LANES // pixels)
    while spp > 0:
        yield min(spp, most)
        spp -= most


def _radiance_jit(stage: Stage, sensor: Any, spp: int, seed: int) -> np.ndarray:
    import drjit as dr

    mi = stage.mi
    width, height = (int(v) for v in np.array(sensor.film().size()))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, height * width * spp)
    # opaque: another count must not compile another kernel
    number = dr.arange(mi.UInt32, height * width * spp) // dr.opaque(mi.UInt32, spp)
    color = _light(stage, stage.reference_integrator, sampler, sensor, number, np.zeros(2))[0]
    dr.eval(color)  # before the sums: each would trace all of it again
    if spp > 1:
        color = [dr.block_sum(channel, spp) / spp for channel in color]
    return np.stack([np.array(channel) for channel in color], -1).reshape(height, width, 3)


def _sample(
    stage: Stage, sampler: Any, number: Any, jitter: np.ndarray, guides: tuple[str, ...]
) -> dict[str, Any]:
    """One sample (scalar variants) or a wavefront of them: colour and first hit."""
    color, ray = _light(stage, stage.integrator, sampler, stage.sensor, number, jitter)
    return {"color": color, "direction": ray.d, **_features(stage, sampler, ray, guides)}


def _light(
    stage: Stage, integrator: Any, sampler: Any, sensor: Any, number: Any, jitter: np.ndarray
) -> tuple[Any, Any]:
    """Radiance of camera samples in the given pixels, and their rays."""
    mi = stage.mi
    width, height = (int(v) for v in np.array(sensor.film().size()))
    row = number // width
    inside = sampler.next_2d()
    place = mi.Point2f(
        (mi.Float(number - row * width) + inside[0] + mi.Float(jitter[0])) / width,
        (mi.Float(row) + inside[1] + mi.Float(jitter[1])) / height,
    )
    lens = sampler.next_2d() if sensor.needs_aperture_sample() else mi.Point2f(0.5, 0.5)
    ray, weight = sensor.sample_ray(0.0, 0.5, place, lens)
    ray = mi.RayDifferential3f(ray)
    light, _, _ = integrator.sample(stage.scene, sampler, ray, stage.medium)
    return light * weight, ray


def _features(stage: Stage, sampler: Any, ray: Any, guides: tuple[str, ...]) -> dict[str, Any]:
    import drjit as dr

    mi, scalar = stage.mi, "scalar" in stage.mi.variant()
    si = stage.scene.ray_intersect(ray)
    hit = si.is_valid()
    shape = si.shape
    if stage.plan.medium is not None:
        # the hull is no surface: what is seen through it is the background
        hull = next(s for s in stage.scene.shapes() if s.id() == HULL)
        hit = hit and shape.id() != HULL if scalar else hit & (shape != mi.ShapePtr(hull))
    seen: dict[str, Any] = {"hit": hit, "position": si.p, "normal": si.sh_frame.n}
    if scalar:
        bsdf = si.bsdf() if hit else None
        seen["albedo"] = bsdf.eval_diffuse_reflectance(si) if bsdf else mi.Color3f(0)
    else:
        bsdf = si.bsdf(ray)
        seen["albedo"] = dr.select(hit, bsdf.eval_diffuse_reflectance(si, hit), 0)
    if stage.movers:
        seen["object"] = _pick(stage, shape, hit, [(s, index) for s, index in stage.movers], si, 0)
    if "roughness" in guides:
        seen["roughness"] = _pick(stage, shape, hit, stage.roughness(), si, 1.0)
    if "specular_albedo" in guides:
        seen["specular_albedo"] = _specular_albedo(mi, sampler, bsdf, si, hit)
    return seen


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


def _planar(value: Any) -> np.ndarray:
    array = np.array(value, np.float64)
    return array.T if array.ndim == 2 else array

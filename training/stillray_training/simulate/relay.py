"""Path tracing in a loop whose lanes go on with their next sample when a path has ended.

Mitsuba's own loop runs a packet of paths until the longest of them has ended, most of its lanes
idle. Here a lane takes several samples of its pixel one after the other, which ends packets almost
together. It is the estimator of Mitsuba's ``path`` (next event estimation, power heuristic, Russian
roulette) but for two things that change no value: whether a light is hidden is asked after the
material, and only where the material sends some of that light on; and the derivatives of surfaces
are left out where no material asks for them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stillray_training.simulate.plan import REFERENCE_ROULETTE, ROULETTE
from stillray_training.simulate.stage import Stage

_TURNS = 64  # samples that a lane takes: with 16 a room took 1.03 times as long, with 4 1.07 times


def path_radiance(
    stage: Stage, sampler: Any, ray: Any, weight: Any, clamp: float | None = None
) -> Any:
    """Radiance of camera samples, one path for each lane, for JIT variants.

    Parameters
    ----------
    stage
        Posed and aimed, without a medium.
    sampler
        Seeded for as many lanes as there are rays.
    ray, weight
        Camera rays and what their radiance is multiplied by.
    clamp
        See `relay_radiance`.

    Returns
    -------
    mi.Color3f
        What a sample adds that is not finite counts as 0.
    """
    import drjit as dr

    mi = stage.mi
    count, bound = dr.width(ray), _bound(mi, clamp)
    state = {
        "sampler": sampler,
        "alive": mi.Bool(True),
        "total": dr.zeros(mi.Color3f, count),
        **_begun(mi, ray, weight),
        "before": dr.zeros(mi.Point3f, count),
    }

    def step(state: dict[str, Any]) -> tuple[dict[str, Any]]:
        _vertex(stage, state, ROULETTE, bound)
        return (state,)

    (state,) = dr.while_loop((state,), lambda state: state["alive"], step, mode="symbolic")
    return state["total"]


def relay_radiance(
    stage: Stage, sensor: Any, spp: int, seed: int, most: int, clamp: float | None = None
) -> np.ndarray:
    """Mean radiance of camera samples on surfaces and lights, for JIT variants.

    Parameters
    ----------
    stage
        Posed and aimed, without a medium.
    sensor
        One of the stage's.
    spp
        Samples a pixel, 1 or more.
    seed
        The same seed gives the same pixels.
    most
        Lanes that may be side by side, which bounds the memory; a pixel has one at least.
    clamp
        Radiance that one contribution of indirect light (from the second bounce on) may have in
        its brightest channel: brighter ones are scaled down to it, as production renderers do.
        None: any.

    Returns
    -------
    (h, w, 3) float64
        What a sample adds that is not finite counts as 0.
    """
    import drjit as dr

    mi = stage.mi
    width, height = (int(v) for v in np.array(sensor.film().size()))
    lanes = max(1, min(-(-spp // _TURNS), most // (height * width)))  # of each pixel
    count = height * width * lanes
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    # opaque: another count must not compile another kernel
    share, samples = dr.opaque(mi.UInt32, lanes), dr.opaque(mi.UInt32, spp)
    bound = _bound(mi, clamp)
    # Roulette makes what survives brighter, so that a bound takes more of it: frames and references
    # end paths alike where there is one, or references would be darker.
    first_roulette = REFERENCE_ROULETTE if clamp is None else ROULETTE
    lane = dr.arange(mi.UInt32, count)
    number = lane // share
    row = number // width
    corner = mi.Point2f(mi.Float(number - row * width), mi.Float(row))
    state = {
        "sampler": sampler,
        # whole turns of all lanes of the pixel, and one more of the first of them
        "left": samples // share + dr.select(lane - number * share < samples % share, 1, 0),
        "alive": mi.Bool(False),
        "total": dr.zeros(mi.Color3f, count),
        "ray": dr.zeros(mi.Ray3f, count),
        "throughput": dr.zeros(mi.Color3f, count),
        "depth": mi.UInt32(0),
        "eta": mi.Float(1),
        "before": dr.zeros(mi.Point3f, count),  # the path's last vertex
        "pdf": mi.Float(1),  # of the direction from there
        "smooth": mi.Bool(True),  # whether it was a mirror's
    }

    def step(state: dict[str, Any]) -> tuple[dict[str, Any]]:
        _start(stage, sensor, corner / mi.Vector2f(width, height), (width, height), state)
        _vertex(stage, state, first_roulette, bound)
        return (state,)

    (state,) = dr.while_loop(
        (state,), lambda state: state["alive"] | (state["left"] > 0), step, mode="symbolic"
    )
    dr.eval(state["total"])  # before the sums: each would trace all of it again
    total = state["total"]
    if lanes > 1:
        total = [dr.block_sum(channel, lanes) for channel in total]
    sums = np.stack([np.array(channel, np.float64) for channel in total], -1)
    return sums.reshape(height, width, 3) / spp


def _start(
    stage: Stage, sensor: Any, corner: Any, size: tuple[int, int], state: dict[str, Any]
) -> None:
    """Start a path in the lanes that have none; ``corner`` is their pixel's, of the film."""
    import drjit as dr

    mi, sampler = stage.mi, state["sampler"]
    fresh = ~state["alive"]
    inside = sampler.next_2d(fresh)
    place = corner + inside / mi.Vector2f(*size)
    lens = sampler.next_2d(fresh) if sensor.needs_aperture_sample() else mi.Point2f(0.5, 0.5)
    ray, weight = sensor.sample_ray(0.0, 0.5, place, lens, fresh)
    begin = {**_begun(mi, ray, weight), "left": state["left"] - 1}
    for name, value in begin.items():
        state[name] = dr.select(fresh, value, state[name])


def _begun(mi: Any, ray: Any, weight: Any) -> dict[str, Any]:
    """A path at the camera."""
    return {
        "ray": mi.Ray3f(ray),
        "throughput": mi.Color3f(weight),
        "depth": mi.UInt32(0),
        "eta": mi.Float(1),
        "pdf": mi.Float(1),
        "smooth": mi.Bool(True),  # no light was drawn at the camera: what it sees counts in full
    }


def _vertex(stage: Stage, state: dict[str, Any], first_roulette: int, bound: Any) -> None:
    """Add what the next vertex shines and what a light sends over it, and draw a way on."""
    import drjit as dr

    mi, scene, sampler = stage.mi, stage.scene, state["sampler"]
    longest = int(stage.plan.integrator.params["max_depth"])
    throughput, smooth = state["throughput"], state["smooth"]
    flags = mi.RayFlags.UV | mi.RayFlags.ShadingFrame
    if stage.plan.world.file or stage.bent:
        flags = mi.RayFlags.All  # bumps, and lobes longer than wide, which files may have
    si = scene.ray_intersect(state["ray"], flags, mi.Bool(False), mi.Bool(True))
    # a light that was hit, which could have been drawn from the vertex before too
    before = dr.zeros(mi.Interaction3f)
    before.p = state["before"]
    seen = mi.DirectionSample3f(scene, si, before)
    emitter = si.emitter(scene)
    shines = emitter != mi.EmitterPtr(None)
    drawn = scene.pdf_emitter_direction(before, seen, shines & ~smooth)
    weight = dr.select(smooth, 1, _power(state["pdf"], drawn))
    gain = throughput * emitter.eval(si, shines & (state["pdf"] > 0)) * weight
    if bound is not None:
        # what the camera sees, and lights found by the first bounce, are direct light
        gain = dr.select(state["depth"] > 1, clamped(gain, bound), gain)
    # a light that is drawn
    further = si.is_valid() & (state["depth"] + 1 < longest)
    bsdf = si.bsdf()
    lit = further & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
    light, radiance = scene.sample_emitter_direction(si, sampler.next_2d(further), False, lit)
    value, pdf, way, factor = bsdf.eval_pdf_sample(
        mi.BSDFContext(),
        si,
        si.to_local(light.d),
        sampler.next_1d(further),
        sampler.next_2d(further),
        further,
    )
    weight = dr.select(light.delta, 1, _power(light.pdf, pdf))
    sent = throughput * value * radiance * weight
    lit &= (light.pdf != 0) & (dr.max(sent) > 0)
    lit &= ~scene.ray_test(si.spawn_ray_to(light.p), lit)
    if bound is not None:
        sent = dr.select(state["depth"] > 0, clamped(sent, bound), sent)
    gain += dr.select(lit, sent, 0)
    state["total"] += dr.select(dr.isfinite(dr.sum(gain)), gain, 0)
    # the way on
    throughput = throughput * factor
    state["depth"] += 1
    state["eta"] *= way.eta
    brightest = dr.max(throughput)
    chance = dr.minimum(brightest * dr.square(state["eta"]), 0.95)
    roulette = state["depth"] >= first_roulette
    survives = sampler.next_1d(further) < chance
    state["throughput"] = dr.select(roulette, throughput / chance, throughput)
    state["alive"] = further & (brightest != 0) & (~roulette | survives)
    state["ray"] = si.spawn_ray(si.to_world(way.wo))
    state["before"], state["pdf"] = si.p, way.pdf
    state["smooth"] = mi.has_flag(way.sampled_type, mi.BSDFFlags.Delta)


def _bound(mi: Any, clamp: float | None) -> Any:
    """A clamp as the loops take it: opaque, so that another one compiles no other kernel."""
    import drjit as dr

    return None if clamp is None else dr.opaque(mi.Float, clamp)


def clamped(light: Any, bound: Any) -> Any:
    """Light scaled down to where its brightest channel is ``bound``."""
    import drjit as dr

    return light * dr.minimum(1, bound / dr.maximum(dr.max(light), 1e-30))


def _power(own: Any, other: Any) -> Any:
    """Power heuristic."""
    import drjit as dr

    own, other = dr.square(own), dr.square(other)
    weight = own / (own + other)
    return dr.select(dr.isfinite(weight), weight, 0)

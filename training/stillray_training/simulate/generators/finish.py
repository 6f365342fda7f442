"""What a generated scene calls for, how its things move, how bright it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillray_training.simulate.generators.build import Builder, Spot
from stillray_training.simulate.mesh import rotation, translation
from stillray_training.simulate.world import Fog, Lens, Motion, Sky, Sun, World

EXPOSURE_STOPS = 3.0  # all light of a scene is scaled by up to so many stops either way

# How often a generated scene calls for an effect that it could show.
ODDS = {
    "texture": 0.96, "glossy": 0.9, "soft_shadow": 0.97, "mirror_glass": 0.6,
    "environment": 1.0, "sun": 0.8, "moving_light": 0.15, "moving_object": 0.3,
    "depth_of_field": 0.2, "motion_blur": 0.12, "medium": 0.1,
    "relief": 0.95,
}  # fmt: skip


def finish(
    b: Builder,
    label: str,
    *,
    space: tuple[np.ndarray, np.ndarray],
    gaze: tuple[np.ndarray, np.ndarray],
    sky: Sky | None,
    sun: Sun | None,
    daylight: bool,
) -> World:
    """The world of a builder: light scaled, motions and effects drawn.

    Parameters
    ----------
    b
        Has placed everything.
    label
        The generator's name.
    space, gaze
        Boxes that cameras stand in and look at, metres.
    sky, sun
        Light from outside.
    daylight
        Whether the scene calls for the sky and the sun.
    """
    gain = float(2.0 ** b.rng.uniform(-EXPOSURE_STOPS, EXPOSURE_STOPS))
    lamps = [
        replace(lamp, radiance=tuple(gain * v for v in lamp.radiance))  # type: ignore[arg-type]
        for lamp in b.lamps
    ]
    if sky:
        sky = replace(sky, radiance=sky.radiance * gain)
    if sun:
        sun = replace(sun, irradiance=tuple(gain * v for v in sun.irradiance))  # type: ignore[arg-type]
    extent = float(np.max(gaze[1] - gaze[0]))
    moving, swinging = _motions(b, extent)
    world = World(
        label=label,
        pieces=b.pieces,
        lamps=lamps,
        sky=sky,
        sun=sun,
        fog=Fog(
            extinction=float(np.exp(b.rng.uniform(np.log(0.1), np.log(0.8)))) / extent,
            albedo=(0.95,) * 3 if b.chance(0.7) else tuple(b.rng.uniform(0.5, 0.98, 3).tolist()),  # type: ignore[arg-type]
            asymmetry=b.between(0, 0.7) if b.chance(0.5) else 0.0,
        ),
        lens=Lens(aperture=float(np.exp(b.rng.uniform(np.log(0.004), np.log(0.03)))),
                  focus=b.between(0.5, 1.2)),
        shutter=b.between(0.3, 1.0),
        moving=moving,
        swinging=swinging,
        space=space,
        gaze=gaze,
    )  # fmt: skip
    return replace(world, effects=_effects(b, world, daylight))


def _effects(b: Builder, world: World, daylight: bool) -> tuple[str, ...]:
    from stillray_training.simulate.effects import EFFECTS

    names = []
    for name, effect in EFFECTS.items():
        wanted = b.chance(ODDS[name])  # drawn whether or not the scene can show it
        if name in ("environment", "sun") and not daylight:
            wanted = False
        if wanted and effect.missing(world) is None:
            names.append(name)
    if not world.lamps and "environment" not in names and "sun" not in names:
        names.append("environment")
    return tuple(names)


def _motions(b: Builder, extent: float) -> tuple[dict[str, Motion], dict[str, Motion]]:
    """One to three groups that move, and the lamps that do."""
    movable = [spot for spot in b.spots if spot.kind in ("floor", "thing")]
    lamps = [spot for spot in b.spots if spot.kind in ("hanging", "lamp")]
    moving, swinging = {}, {}
    for index in b.rng.permutation(len(movable))[: int(b.rng.integers(1, 4))]:
        spot = movable[index]
        moving[spot.group] = _motion(b.rng, spot, extent)
    for index in b.rng.permutation(len(lamps))[: int(b.rng.integers(1, 3))]:
        spot = lamps[index]
        swinging[spot.group] = _motion(b.rng, spot, extent)
    return moving, swinging


def _motion(rng: np.random.Generator, spot: Spot, extent: float) -> Motion:
    centre = spot.centre
    heading = rng.uniform(0, 2 * np.pi)
    speed = extent * float(np.exp(rng.uniform(np.log(0.0015), np.log(0.012))))
    step = speed * np.array([np.cos(heading), 0.0, np.sin(heading)])
    spin = float(rng.normal() * 4.0) if rng.random() < 0.6 else 0.0  # degrees a frame
    hop = float(rng.uniform(0, 0.04)) * extent if spot.kind == "thing" and rng.random() < 0.4 else 0
    rate, phase = float(rng.uniform(0.2, 0.7)), float(rng.uniform(0, 2 * np.pi))
    if spot.kind == "hanging":
        axis, swing = np.array([np.cos(heading), 0.0, np.sin(heading)]), rng.uniform(3, 20)

        def pose(time: float) -> np.ndarray:
            turn = rotation(axis, swing * np.sin(rate * time + phase))
            return translation(centre) @ turn @ translation(-centre)

    else:

        def pose(time: float) -> np.ndarray:
            up = hop * np.sin(rate * time + phase) ** 2
            turn = rotation([0, 1, 0], spin * time)
            return translation(centre + step * time + [0, up, 0]) @ turn @ translation(-centre)

    return pose

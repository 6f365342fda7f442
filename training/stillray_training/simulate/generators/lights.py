"""Daylight: sky and sun, or panels that stand for the sky in the windows."""

from __future__ import annotations

import numpy as np

from stillray_training.simulate.generators.build import Builder
from stillray_training.simulate.generators.shell import THICK, Wall
from stillray_training.simulate.mesh import quad
from stillray_training.simulate.world import Sky, Sun


def daylight(b: Builder, sides: list[Wall]) -> tuple[Sky | None, Sun | None, bool]:
    """Light through the windows of a room.

    Returns
    -------
    sky, sun, bool
        And whether the scene calls for them: else a panel shines in each window, or it is night.
    """
    style = b.pick("sky", "panels", "night", p=[0.45, 0.35, 0.2])
    glazed = [wall for wall in sides if wall.holes]
    facing = None  # windows in two walls see more than half of the sky
    if len(glazed) == 1:
        facing = tuple(float(v) for v in -glazed[0].frame[:3, 2])
    kind = b.pick("clear", "cloudy", "dusk", p=[0.5, 0.35, 0.15])
    sky = Sky(kind=kind, seed=int(b.rng.integers(2**31)), radiance=b.between(3, 12), facing=facing)  # type: ignore[arg-type]
    sun = sunlight(b, -glazed[0].frame[:3, 2] if glazed else np.array([1.0, 0, 0]), spread=50)
    if style == "panels":
        for wall in glazed:
            light = b.light_color(b.between(4, 25))
            for le, bo, r, t in wall.holes:
                # a little outside of the opening, facing in
                face = quad([le, bo, -THICK - 0.01], [r - le, 0, 0], [0, t - bo, 0])
                b.shine(face.moved(wall.frame), light, window=True)
    return sky, sun, style == "sky"


def sunlight(b: Builder, from_side: np.ndarray, *, spread: float) -> Sun:
    """A sun that stands within ``spread`` degrees of the direction ``from_side``."""
    azimuth = np.arctan2(from_side[2], from_side[0]) + np.radians(b.between(-spread, spread))
    height = np.radians(b.between(12, 55))
    direction = -np.array(
        [np.cos(azimuth) * np.cos(height), np.sin(height), np.sin(azimuth) * np.cos(height)]
    )
    warm = np.array([1.0, 0.75 + 0.2 * np.sin(height), 0.4 + 0.5 * np.sin(height)])
    strength = b.between(15, 80) * warm / warm.mean()
    return Sun(
        direction=tuple(float(v) for v in direction),  # type: ignore[arg-type]
        irradiance=tuple(float(v) for v in strength),  # type: ignore[arg-type]
    )

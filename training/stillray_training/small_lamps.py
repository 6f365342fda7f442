"""Small lamps, painted into rendered frames.

A lamp that a pixel sees itself is as bright in every sample that meets it; where it is small and
few were in view of what a network learned from, it takes them for fireflies. Painted lamps light
nothing around them: what is to be learned is that they stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillray.frame import Frame
from stillray_training.draws import log_uniform
from stillray_training.fine_shapes import anywhere, ellipse, laid_over, rectangle, seen_through

_MOST = 3  # lamps of a picture
_HALF_EDGES = (0.7, 6.0)  # pixels, from the middle of a lamp to its edge
_BRIGHTER = (0.3, 2.5)  # powers of ten above the picture's median
_IN_FRONT = 0.9  # a lamp's distance, as a part of the least behind it
_WHITES = (0.3, 1.0)  # blue of a lamp's light over its red


@dataclass(frozen=True, eq=False)
class Lamp:
    """A lamp as a camera sees it.

    Attributes
    ----------
    coverage : (h, w) float32
        The probability that a sample of a pixel meets it.
    radiance, albedo, normal : (3,) float32
        As renderers write them: the albedo of lamps is 0, 1, their colour or their material's.
    distance
        Its depth; 0 where the renderer writes none: then pixels that see it alone have none.
    """

    coverage: np.ndarray
    radiance: np.ndarray
    albedo: np.ndarray
    normal: np.ndarray
    distance: float


def draw_lamps(
    reference: np.ndarray, depth: np.ndarray, spread: float | None, rng: np.random.Generator
) -> list[Lamp]:
    """One to three lamps, flat and alike all over, from two to 300 times as bright as a picture.

    Parameters
    ----------
    reference : (h, w, 3)
        The picture's radiance without noise.
    depth : (h, w)
        Its depth; 0 where nothing was hit.
    spread
        Standard deviation of the render's pixel filter, in pixels; None for that of a box.
    rng
        Draws their places, shapes, light and features.
    """
    usual = usual_light(reference)
    lamps = []
    for _ in range(int(rng.integers(1, _MOST + 1))):
        coverage = _coverage(reference.shape[:2], spread, rng)
        behind = depth[(coverage > 0) & (depth > 0)]
        blue = rng.uniform(*_WHITES)
        tint = tint_of(blue)
        if rng.random() < 0.2:
            tint = rng.random(3)
        white = tint / tint.mean()
        normal = rng.normal(size=3)
        materials = (np.zeros(3), np.ones(3), tint / tint.max(), np.full(3, rng.random()))
        lamps.append(
            Lamp(
                coverage=coverage,
                radiance=(usual * 10 ** rng.uniform(*_BRIGHTER) * white).astype(np.float32),
                albedo=materials[rng.integers(len(materials))].astype(np.float32),
                normal=(normal / np.linalg.norm(normal)).astype(np.float32),
                distance=_IN_FRONT * float(behind.min()) if len(behind) else 0.0,
            )
        )
    return lamps


def usual_light(reference: np.ndarray) -> float:
    """What lamps are brighter than: the median of a picture ``(h, w, 3)``, 1 if that is 0."""
    return float(np.median(reference.mean(axis=-1))) or 1.0


def tint_of(blue: float) -> np.ndarray:
    """The colour ``(3,)`` of light with so much blue over its red."""
    return np.array([1, np.sqrt(blue), blue])


def _coverage(shape: tuple[int, int], spread: float | None, rng: np.random.Generator) -> np.ndarray:
    """Of a rectangle or an ellipse, anywhere and turned anyhow, through the pixel filter."""
    middle = anywhere(shape, rng)
    sides = (2 * log_uniform(rng, _HALF_EDGES), 2 * log_uniform(rng, _HALF_EDGES))
    turned = 0.0 if rng.random() < 0.5 else rng.uniform(0, 180)
    draw = ellipse if rng.random() < 0.5 else rectangle
    return seen_through(draw(shape, middle, sides, turned), spread)


def lit_reference(reference: np.ndarray, lamps: Sequence[Lamp]) -> np.ndarray:
    """A reference ``(h, w, 3)`` with lamps in it, float32."""
    for lamp in lamps:
        reference = laid_over(reference, lamp.radiance, lamp.coverage[..., None])
    return reference


def lit_frame(
    frame: Frame, lamps: Sequence[Lamp], samples: float, rng: np.random.Generator
) -> Frame:
    """A frame with lamps in it, met by as many of a pixel's samples as chance has it.

    Parameters
    ----------
    frame
        With all features. Lamps stay where they are from frame to frame.
    lamps
        In front of all that is there, the last in front of the others.
    samples
        Of a pixel, 1 or more.
    rng
        Draws which samples meet a lamp.
    """
    assert frame.albedo is not None
    assert frame.normal is not None
    assert frame.depth is not None
    color, albedo, normal = frame.color, frame.albedo, frame.normal
    depth, motion = frame.depth, frame.motion
    count = max(round(samples), 1)
    for lamp in lamps:
        share = (rng.binomial(count, lamp.coverage) / count).astype(np.float32)
        met = share[..., None]
        # a broken sample stays one, but where the lamp alone is seen
        color = np.where(met == 1, lamp.radiance, laid_over(color, lamp.radiance, met))
        albedo = laid_over(albedo, lamp.albedo, met)
        normal = laid_over(normal, lamp.normal, met)
        if lamp.distance:
            near = np.float32(lamp.distance)
            depth = np.where((depth > 0) | (share == 0), laid_over(depth, near, share), near)
        else:
            depth = np.where(share == 1, np.float32(0), depth)
        if motion is not None:
            motion = np.where(met > 0.5, np.float32(0), motion)
    return replace(frame, color=color, albedo=albedo, normal=normal, depth=depth, motion=motion)

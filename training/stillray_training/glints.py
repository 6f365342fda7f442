"""Glints, painted into rendered frames: lamps that glass mirrors in some of the samples.

A lamp in a mirror is as bright in every sample, in glass in one of a dozen: of few samples a crowd
of fireflies, some pixels with one and some without, and solid of many. What a network learned from
had few, and left them speckled.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stillray.frame import Frame
from stillray_training.draws import log_uniform
from stillray_training.fine_shapes import anywhere, ellipse, laid_over, rectangle, seen_through
from stillray_training.small_lamps import tint_of, usual_light

_MOST = 6  # glints of a picture
_EDGES = (1.5, 16.0)  # pixels, of a glint
_CHANCES = (0.03, 0.7)  # that a sample meets the lamp, as of glass from above and at its rim
_BRIGHTER = (0.7, 3.0)  # powers of ten above the picture's median
_WHITES = (0.3, 1.0)  # blue of a lamp's light over its red


@dataclass(frozen=True, eq=False)
class Glint:
    """A lamp as glass shows it.

    Attributes
    ----------
    chance : (h, w) float32
        The probability that a sample of a pixel meets it.
    radiance, albedo : (3,) float32
        What such a sample has; normal, depth and motion are the glass's.
    """

    chance: np.ndarray
    radiance: np.ndarray
    albedo: np.ndarray


def draw_glints(
    reference: np.ndarray, spread: float | None, rng: np.random.Generator
) -> list[Glint]:
    """One to six glints, from five to a thousand times as bright as a picture.

    Parameters
    ----------
    reference : (h, w, 3)
        The picture's radiance without noise.
    spread
        Standard deviation of the render's pixel filter, in pixels; None for that of a box.
    rng
        Draws their places, shapes and light.
    """
    shape, usual = reference.shape[:2], usual_light(reference)
    glints = []
    for _ in range(int(rng.integers(1, _MOST + 1))):
        sides = (log_uniform(rng, _EDGES), log_uniform(rng, _EDGES))
        draw = ellipse if rng.random() < 0.5 else rectangle
        seen = seen_through(draw(shape, anywhere(shape, rng), sides, rng.uniform(0, 180)), spread)
        tint = tint_of(rng.uniform(*_WHITES))
        light = usual * 10 ** rng.uniform(*_BRIGHTER) * tint / tint.mean()
        # renderers write a lamp's light, white or nothing
        albedo = (light, np.ones(3), np.zeros(3))[rng.integers(3)]
        glints.append(
            Glint(
                chance=seen * np.float32(log_uniform(rng, _CHANCES)),
                radiance=light.astype(np.float32),
                albedo=albedo.astype(np.float32),
            )
        )
    return glints


def glinting_reference(reference: np.ndarray, glints: list[Glint]) -> np.ndarray:
    """A reference ``(h, w, 3)`` with glints in it, float32."""
    for glint in glints:
        reference = laid_over(reference, glint.radiance, glint.chance[..., None])
    return reference


def glinting_frame(
    frame: Frame, glints: list[Glint], samples: float, rng: np.random.Generator
) -> Frame:
    """A frame with glints in it, met by as many of a pixel's samples as chance has it.

    Parameters
    ----------
    frame
        With albedo. Glints stay where they are from frame to frame.
    glints
        What is mirrored.
    samples
        Of a pixel, 1 or more.
    rng
        Draws which samples meet a lamp.
    """
    assert frame.albedo is not None
    color, albedo, count = frame.color, frame.albedo, max(round(samples), 1)
    for glint in glints:
        met = rng.binomial(count, glint.chance[..., None]) / count
        color = laid_over(color, glint.radiance, met)
        albedo = laid_over(albedo, glint.albedo, met)
    return replace(frame, color=color, albedo=albedo)

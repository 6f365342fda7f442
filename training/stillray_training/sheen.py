"""Sheen, painted into rendered frames: windows and lamps as varnish and polished floors show them.

What a varnish mirrors has nothing of the texture beneath it, and a part of the samples carry all of
it. Light is filtered divided by albedo and multiplied again, which lays the texture over such a
reflection, in the texture's colours: streaks of violet and yellow on wood. A network can keep to
pixels of the same albedo, if it has met enough of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from stillray.frame import Frame
from stillray_training.draws import log_uniform
from stillray_training.fine_shapes import anywhere, ellipse, rectangle, seen_through
from stillray_training.small_lamps import tint_of, usual_light

_MOST = 3  # reflections on the surface
_EDGES = (12.0, 160.0)  # pixels
_BLUR = (2.0, 24.0)  # standard deviation, pixels
_BRIGHTER = (-0.4, 0.9)  # powers of ten above the picture's median
_WHITES = (0.7, 1.3)  # blue of the light over its red
_CHANCES = (0.04, 0.9)  # that a sample carries it
_SAME, _ALIKE = 0.95, 0.8  # cosines of normals: of the surface, and of what is surely no other
_RIM = 1.5  # pixels, of the blur within which the light fades at the surface's edge


@dataclass(frozen=True, eq=False)
class Sheen:
    """What a surface mirrors.

    Attributes
    ----------
    light : (h, w, 3) float32
        Radiance, the mean of all samples; 0 on other surfaces.
    facing : (3,) float32
        The surface's normal.
    chance
        The part of the samples that carry it.
    """

    light: np.ndarray
    facing: np.ndarray
    chance: float


def draw_sheen(reference: np.ndarray, frame: Frame, rng: np.random.Generator) -> Sheen:
    """One to three soft reflections on one surface, from .4 to 8 times as bright as a picture.

    Parameters
    ----------
    reference : (h, w, 3)
        The picture's radiance without noise.
    frame
        Of the same view, with normals and depth.
    rng
        Draws the surface, and places, shapes and light of what it mirrors.
    """
    assert frame.normal is not None
    assert frame.depth is not None
    shape = reference.shape[:2]
    profile = np.zeros(shape, np.float32)
    for _ in range(int(rng.integers(1, _MOST + 1))):
        sides = (log_uniform(rng, _EDGES), log_uniform(rng, _EDGES))
        draw = ellipse if rng.random() < 0.5 else rectangle
        fine = draw(shape, anywhere(shape, rng), sides, rng.uniform(0, 180))
        profile += cv2.GaussianBlur(seen_through(fine, None), (0, 0), log_uniform(rng, _BLUR))
    hit = np.argwhere(frame.depth > 0)
    facing = np.zeros(3, np.float32)
    if len(hit):
        facing = frame.normal[tuple(hit[rng.integers(len(hit))])].astype(np.float32)
    own = _faces(frame, facing, _SAME).astype(np.float32)
    soft = cv2.GaussianBlur(cv2.medianBlur(own, 3), (0, 0), _RIM)
    tint = tint_of(rng.uniform(*_WHITES))
    light = usual_light(reference) * 10 ** rng.uniform(*_BRIGHTER) * tint / tint.mean()
    inside = profile * np.clip(2 * soft - 1, 0, 1)
    return Sheen(
        light=(inside[..., None] * light).astype(np.float32),
        facing=facing,
        chance=log_uniform(rng, _CHANCES),
    )


def shining_reference(reference: np.ndarray, sheen: Sheen) -> np.ndarray:
    """A reference ``(h, w, 3)`` with sheen on a surface, float32."""
    return np.asarray(reference + sheen.light, np.float32)


def shining_frame(frame: Frame, sheen: Sheen, samples: float, rng: np.random.Generator) -> Frame:
    """A frame with sheen on a surface, carried by as many of a pixel's samples as chance has it.

    Parameters
    ----------
    frame
        With normals and depth. Sheen stays where it is from frame to frame, as far as the surface
        is there.
    sheen
        What the surface mirrors.
    samples
        Of a pixel, 1 or more.
    rng
        Draws which samples carry it.
    """
    count = max(round(samples), 1)
    carried = rng.binomial(count, sheen.chance, frame.shape) / (count * sheen.chance)
    carried *= _faces(frame, sheen.facing, _ALIKE)
    color = frame.color + sheen.light * carried[..., None].astype(np.float32)
    return replace(frame, color=color)


def _faces(frame: Frame, facing: np.ndarray, cosine: float) -> np.ndarray:
    """Where a frame's surfaces face a way, ``(h, w)`` bool."""
    assert frame.normal is not None
    assert frame.depth is not None
    length = np.linalg.norm(frame.normal, axis=-1) * np.linalg.norm(facing)
    return np.asarray((frame.depth > 0) & (frame.normal @ facing > cosine * length))

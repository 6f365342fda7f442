"""Thin shadows, painted into the light of rendered frames: slats', gaps' and leaves'.

What only light shows, no feature, and few scenes have finer than a table's shadow. A sample is
scaled by what is left of the light at its pixel, so that noise scales with it.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from stillray.frame import Frame
from stillray_training.draws import log_uniform
from stillray_training.fine_shapes import (
    FINE,
    anywhere,
    between_stripes,
    rectangle,
    seen_through,
)

_LEFT = (0.02, 0.8)  # of the light in a shadow
_STEPS = (3.0, 40.0)  # pixels from a slat's shadow to the next
_PARTS = (0.2, 0.8)  # of a step that is in the shade
_GAPS = (1, 6)  # lone lines, and one more than the most
_THIN, _LONG = (0.7, 4.0), (8.0, 128.0)  # their sides, pixels
_LEAVES = (1.5, 12.0)  # pixels of a leaf's shadow
_SOFT = (0.2, 3.0)  # standard deviation of half of the edges, pixels


def draw_shadow(
    shape: tuple[int, int], spread: float | None, rng: np.random.Generator
) -> np.ndarray:
    """What is left of a picture's light under shadows that stay where they are.

    Parameters
    ----------
    shape
        Height and width, pixels.
    spread
        Standard deviation of the render's pixel filter, in pixels; None for that of a box.
    rng
        Draws slats, lines or leaves, their edges, and how dark they are.

    Returns
    -------
    (h, w) float32
        1 in the light, 0.02 to 0.8 in the shade.
    """
    draw = (_slats, _lines, _lines, _leaves)[rng.integers(4)]
    fine = draw(shape, rng)
    if rng.random() < 0.5:
        fine = cv2.GaussianBlur(fine, (0, 0), FINE * log_uniform(rng, _SOFT))
    return 1 - seen_through(fine, spread) * np.float32(1 - log_uniform(rng, _LEFT))


def _slats(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Stripes all over, or in a part of the picture."""
    step = log_uniform(rng, _STEPS)
    thick = step * rng.uniform(*_PARTS)
    fine = 1 - between_stripes(shape, rng.uniform(0, np.pi), step, thick, rng).astype(np.float32)
    return fine * _patch(shape, rng) if rng.random() < 0.5 else fine


def _patch(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """What of a picture they fall on."""
    height, width = shape
    sides = (width * rng.uniform(0.2, 1.0), height * rng.uniform(0.2, 1.0))
    return rectangle(shape, anywhere(shape, rng), sides, rng.uniform(0, 90))


def _lines(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Lone lines: gaps between things that no feature shows."""
    fine = np.zeros([FINE * size for size in shape], np.float32)
    for _ in range(rng.integers(*_GAPS)):
        sides = (log_uniform(rng, _THIN), log_uniform(rng, _LONG))
        turned = rng.choice((0.0, 90.0, rng.uniform(0, 180)))
        np.maximum(fine, rectangle(shape, anywhere(shape, rng), sides, turned), out=fine)
    return fine


def _leaves(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Blots in a part of the picture."""
    size = log_uniform(rng, _LEAVES)
    coarse = rng.normal(size=[int(side / size) + 2 for side in shape]).astype(np.float32)
    height, width = (FINE * side for side in shape)
    field = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    dark = field > np.quantile(coarse, rng.uniform(*_PARTS))
    return np.asarray(_patch(shape, rng) * dark, np.float32)


def in_shadow(frame: Frame, light: np.ndarray) -> Frame:
    """A frame with what is left of its light, see `draw_shadow`; where nothing was hit, all."""
    return replace(frame, color=frame.color * _on_surfaces(light, frame.depth)[..., None])


def reference_in_shadow(reference: np.ndarray, light: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """A reference ``(h, w, 3)`` with what is left of its light, float32."""
    return np.asarray(reference * _on_surfaces(light, depth)[..., None], np.float32)


def _on_surfaces(light: np.ndarray, depth: np.ndarray | None) -> np.ndarray:
    assert depth is not None
    return np.where(depth > 0, light, np.float32(1))

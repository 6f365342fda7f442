"""Bright windows behind thin bars, painted into rendered frames.

Slats before a sky of some hundred times their light are met in every house and in hardly any
scene that is learned from: a hundredth of the sky let into a slat's pixel is all that is seen of
it. What a frame shows becomes the bars, and a window shines between them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stillray.frame import Frame
from stillray_training.draws import log_uniform
from stillray_training.fine_shapes import (
    anywhere,
    between_stripes,
    rectangle,
    seen_through,
)
from stillray_training.small_lamps import Lamp, lit_frame, lit_reference, tint_of, usual_light

_SIDES = (16.0, 128.0)  # pixels, of a window
_STEPS = (2.5, 20.0)  # pixels from bar to bar
_THICKNESS = (0.4, 8.0)  # pixels of a bar, and at most as much of a step as the next says
_MOST_OF_STEP = 0.85
_BRIGHTER = (0.7, 2.7)  # powers of ten above the picture's median
_DARKER = (0.0, 2.0)  # powers of ten that bars get less light, in half of the pictures
_BLUE = (0.7, 1.6)  # blue of the sky's light over its red
_FURTHER = (1.1, 4.0)  # the window's distance, as a multiple of the greatest before it


@dataclass(frozen=True, eq=False)
class Window:
    """A window as a camera sees it through bars.

    Attributes
    ----------
    lamp
        What shines between the bars.
    light : (h, w) float32
        What the light of a pixel's other samples is multiplied by: bars before a window are lit
        from behind.
    opening : (FINE h, FINE w) float32
        1 where bars leave the window open, 0 elsewhere; `FINE` points a pixel along each axis.
    """

    lamp: Lamp
    light: np.ndarray
    opening: np.ndarray


def draw_window(
    reference: np.ndarray, depth: np.ndarray, spread: float | None, rng: np.random.Generator
) -> Window:
    """A window of 5 to 500 times a picture's light, with bars of 0.4 to 8 pixels before it.

    Parameters
    ----------
    reference : (h, w, 3)
        The picture's radiance without noise.
    depth : (h, w)
        Its depth; 0 where nothing was hit.
    spread
        Standard deviation of the render's pixel filter, in pixels; None for that of a box.
    rng
        Draws place, bars, light and features.
    """
    inside, open_ = _openings(reference.shape[:2], rng)
    coverage = seen_through(open_, spread)
    tint = tint_of(rng.uniform(*_BLUE))
    usual = usual_light(reference) * tint / tint.mean()
    before = depth[(coverage > 0) & (depth > 0)]
    far = float(before.max()) * rng.uniform(*_FURTHER) if len(before) else 0.0
    normal = np.array([0, 0, rng.random() < 0.3], np.float32)
    lamp = Lamp(
        coverage=coverage,
        radiance=(10 ** rng.uniform(*_BRIGHTER) * usual).astype(np.float32),
        albedo=np.full(3, rng.random() < 0.5, np.float32),
        normal=normal,
        distance=far if rng.random() < 0.5 else 0.0,
    )
    darker = 10 ** -rng.uniform(*_DARKER) if rng.random() < 0.5 else 1.0
    light = 1 - seen_through(inside, spread) * np.float32(1 - darker)
    return Window(lamp=lamp, light=light, opening=open_)


def _openings(shape: tuple[int, int], rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A window, and what of it bars leave open, of `FINE` points a pixel along each axis."""
    middle = anywhere(shape, rng)
    sides = (log_uniform(rng, _SIDES), log_uniform(rng, _SIDES))
    turned = 0.0 if rng.random() < 0.5 else rng.uniform(0, 90)
    inside = rectangle(shape, middle, sides, turned)
    open_ = inside.copy()
    slope = np.radians(turned + rng.choice((0, 90)) + rng.choice((0.0, rng.uniform(-20, 20))))
    for angle in (slope, slope + np.radians(rng.uniform(60, 120)))[: rng.integers(1, 3)]:
        step = log_uniform(rng, _STEPS)
        thick = min(log_uniform(rng, _THICKNESS), _MOST_OF_STEP * step)
        open_ *= between_stripes(shape, angle, step, thick, rng)
    return inside, open_


def reference_through(reference: np.ndarray, window: Window) -> np.ndarray:
    """A reference ``(h, w, 3)`` with a window in it, float32."""
    return lit_reference(reference * window.light[..., None], [window.lamp])


def frame_through(frame: Frame, window: Window, samples: float, rng: np.random.Generator) -> Frame:
    """A frame with a window in it, met by as many of a pixel's samples as chance has it.

    Parameters
    ----------
    frame
        With all features. Window and bars stay where they are from frame to frame.
    window
        Behind the bars; they are what the frame shows.
    samples
        Of a pixel, 1 or more.
    rng
        Draws which samples pass between bars.
    """
    dimmed = replace(frame, color=frame.color * window.light[..., None])
    return lit_frame(dimmed, [window.lamp], samples, rng)

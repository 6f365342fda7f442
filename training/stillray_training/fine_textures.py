"""Fine textures, painted over albedos: stripes, tiles, checks and letters.

Scenes of primitives hardly have any, and a network that learns to denoise their albedo takes a
weave of two pixels for noise.
"""

from __future__ import annotations

import cv2
import numpy as np

from stillray_training.draws import log_uniform
from stillray_training.fine_shapes import FINE, between_stripes, seen_through

_STEPS = (1.5, 16.0)  # pixels from stripe to stripe, tile to tile
_OF_STEP = (0.1, 0.7)  # share of that which is painted
_DARKEST = 0.05  # of the albedo that is left
_LETTERS = "abcdefghkmnoprstuvwxyzABCDEFGHKLMNRSTXYZ0123456789"
_LETTER = (5.0, 20.0)  # pixels, height of letters
_LINES = 1.5  # of those heights from line to line


def draw_texture(
    shape: tuple[int, int], spread: float | None, rng: np.random.Generator
) -> np.ndarray:
    """What an albedo is multiplied by: the paint of stripes, tiles, checks or letters.

    Parameters
    ----------
    shape
        Height and width, pixels.
    spread
        Standard deviation of the pixel filter, in pixels; None for that of a box.
    rng
        Draws the kind, sizes of 1.5 pixels and more, the angle and the colour.

    Returns
    -------
    (h, w, 3) float32
        In (0, 1], 1 where nothing is painted.
    """
    kind = rng.integers(4)
    if kind == 3:
        painted = _letters(shape, rng)
    else:
        # along the picture's axes as often as not
        angle = rng.choice([0, np.pi / 2, rng.uniform(0, np.pi), rng.uniform(0, np.pi)])
        step = log_uniform(rng, _STEPS)
        thick = step * rng.uniform(*_OF_STEP)
        painted = ~between_stripes(shape, angle, step, thick, rng)
        if kind > 0:
            across = ~between_stripes(shape, angle + np.pi / 2, step, thick, rng)
            painted = painted | across if kind == 1 else painted ^ across
    share = seen_through(painted.astype(np.float32), spread)[..., None]
    # coloured or grey
    tint = np.ones(3) * rng.uniform(_DARKEST, 1, 3 if rng.random() < 0.5 else 1)
    return (1 - share * (1 - tint)).astype(np.float32)


def _letters(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Lines of letters, ``(FINE h, FINE w)`` bool."""
    height, width = (FINE * size for size in shape)
    page = np.zeros((height, width), np.uint8)
    size = FINE * log_uniform(rng, _LETTER)
    font, scale = cv2.FONT_HERSHEY_SIMPLEX, size / 30  # about 30 pixels high at a scale of 1
    thick = max(round(size * rng.uniform(0.08, 0.2)), 1)
    for line in range(int(height / (_LINES * size)) + 1):
        letters = "".join(rng.choice(list(_LETTERS), int(width / (0.5 * size)) + 1))
        place = (0, int((line + 1) * _LINES * size))
        cv2.putText(page, letters, place, font, scale, 1, thick, cv2.LINE_8)
    return page > 0

"""Pages of print, met by a few samples a pixel: letters from a pixel and a half high.

What tells one letter from another is a part of a pixel wide, so that of a few samples one in two
meets it. A network that has seen wide stripes and tiles with that noise, and letters without, takes
lines of print for noise and draws a bar.
"""

from __future__ import annotations

import string

import cv2
import numpy as np

from stillray_training.draws import log_uniform
from stillray_training.fine_shapes import FINE
from stillray_training.met_textures import WHITE, MetTexture, in_bytes

_LETTERS = list(string.ascii_letters + string.digits + "      .,:;!?&%")
_HIGH = (1.5, 16.0)  # of capitals, pixels
_LINES = (1.3, 2.2)  # from line to line, of that height
_THICK = (0.08, 0.22)  # of that height
_FONTS = (
    cv2.FONT_HERSHEY_SIMPLEX,
    cv2.FONT_HERSHEY_DUPLEX,
    cv2.FONT_HERSHEY_COMPLEX,
    cv2.FONT_HERSHEY_TRIPLEX,
    cv2.FONT_HERSHEY_SCRIPT_SIMPLEX,
)
_EVEN = 0.35  # share of pages that face the camera
_TILTED = 0.45  # of a page's corners, of its width, at most
_DARKEST = 0.02  # of what ink and paper leave of an albedo
_SIZES = (40.0, 300.0)  # of a page, pixels


def draw_page(shape: tuple[int, int], spread: float | None, rng: np.random.Generator) -> MetTexture:
    """A page of print somewhere in a picture, upright or seen aslant.

    Parameters
    ----------
    shape
        Height and width, pixels.
    spread
        As `MetTexture` has it.
    rng
        Draws letters, sizes, colours and the place.
    """
    wide, high = (round(FINE * log_uniform(rng, _SIZES)) for _ in range(2))
    tall = FINE * log_uniform(rng, _HIGH)
    ink, paper = rng.uniform(_DARKEST, 1, (2, 3 if rng.random() < 0.5 else 1)) * np.ones(3)
    if rng.random() < 0.6:  # as most books have it
        ink, paper = ink * 0.2, paper**0.3
    page = np.where(_printed((high, wide), tall, rng)[..., None], in_bytes(ink), in_bytes(paper))
    height, width = (FINE * size for size in shape)
    flat = np.array([(0, 0), (wide, 0), (wide, high), (0, high)], np.float32)
    middle = rng.uniform(0, 1, 2) * (width, height)
    seen = middle + (flat - flat.mean(0)) @ _turn(rng)
    if rng.random() >= _EVEN:
        seen = seen + rng.uniform(-_TILTED, _TILTED, (4, 2)) * min(wide, high) / 2
    # nearest: what lies between ink and paper belongs to pixels, not to points
    fine = cv2.warpPerspective(
        page.astype(np.uint8),
        cv2.getPerspectiveTransform(flat, seen.astype(np.float32)),
        (width, height),
        flags=cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(WHITE,) * 3,
    )
    return MetTexture(fine, spread)


def _turn(rng: np.random.Generator) -> np.ndarray:
    """Upright as often as not."""
    angle = 0.0 if rng.random() < 0.5 else rng.uniform(-np.pi, np.pi)
    along, across = np.cos(angle), np.sin(angle)
    return np.array([(along, across), (-across, along)])


def _printed(shape: tuple[int, int], tall: float, rng: np.random.Generator) -> np.ndarray:
    """Lines of letters, bool."""
    height, width = shape
    page = np.zeros(shape, np.uint8)
    font = _FONTS[rng.integers(len(_FONTS))]
    thick = max(round(tall * rng.uniform(*_THICK)), 1)
    scale = cv2.getFontScaleFromHeight(font, max(round(tall), 1), thick)
    step = tall * rng.uniform(*_LINES)
    for line in range(int(height / step)):
        letters = "".join(rng.choice(_LETTERS, int(width / (0.6 * tall)) + 1))
        cv2.putText(page, letters, (0, int((line + 0.9) * step)), font, scale, 1, thick, cv2.LINE_8)
    return page > 0

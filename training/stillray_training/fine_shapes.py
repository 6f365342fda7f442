"""Shapes drawn finer than pixels, and what pixels see of them."""

from __future__ import annotations

import cv2
import numpy as np

from stillray.pixel_filter import filter_spread

#: Points of a pixel along each axis, of which coverage is counted.
FINE = 8

Pair = tuple[float, float]


def softer_than_a_box(spread: float | None) -> float:
    """Standard deviation of the blur that makes a pixel filter of a box, pixels; 0: it is one.

    Parameters
    ----------
    spread
        That of the filter, in pixels; None for that of a box.
    """
    own = filter_spread("box")
    return 0.0 if spread is None or spread <= own else float(np.sqrt(spread**2 - own**2))


def seen_through(fine: np.ndarray, spread: float | None) -> np.ndarray:
    """What pixels see of a shape of `FINE` points a pixel along each axis.

    Parameters
    ----------
    fine : (FINE h, FINE w) float32
        1 on the shape, 0 elsewhere.
    spread
        Standard deviation of the pixel filter, in pixels; None for that of a box.

    Returns
    -------
    (h, w) float32
        The probability that a sample of a pixel meets it.
    """
    if softer := softer_than_a_box(spread):  # the mean of a pixel's points is a box of its own
        fine = cv2.GaussianBlur(fine, (0, 0), FINE * softer)
    height, width = (size // FINE for size in fine.shape)
    return cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA)


def laid_over(behind: np.ndarray, met: np.ndarray | np.float32, share: np.ndarray) -> np.ndarray:
    """What a pixel has of what is behind a shape and of the shape itself, float32.

    Parameters
    ----------
    behind, met
        Of the pixels without it, and of it alone.
    share
        Of a pixel's samples that meet it, [0, 1].
    """
    return np.asarray(behind + share * (met - behind), np.float32)


def rectangle(shape: tuple[int, int], middle: Pair, sides: Pair, turned: float) -> np.ndarray:
    """A filled rectangle in ``(h, w)`` pixels, `FINE` points each, float32.

    Parameters
    ----------
    shape
        Height and width, pixels.
    middle, sides
        Of the rectangle, x and y, pixels.
    turned
        By so many degrees.
    """
    corners = cv2.boxPoints(_box(middle, sides, turned))
    return cv2.fillConvexPoly(_empty(shape), np.round(corners).astype(np.int32), 1)


def ellipse(shape: tuple[int, int], middle: Pair, sides: Pair, turned: float) -> np.ndarray:
    """As `rectangle`, of the ellipse that it holds."""
    return cv2.ellipse(_empty(shape), _box(middle, sides, turned), 1, cv2.FILLED)


def _empty(shape: tuple[int, int]) -> np.ndarray:
    return np.zeros([FINE * size for size in shape], np.float32)


def _box(middle: Pair, sides: Pair, turned: float) -> tuple[Pair, Pair, float]:
    """As OpenCV has it."""
    (x, y), (wide, high) = middle, sides
    return (FINE * x, FINE * y), (FINE * wide, FINE * high), float(turned)


def between_stripes(
    shape: tuple[int, int], angle: float, step: float, thick: float, rng: np.random.Generator
) -> np.ndarray:
    """Where stripes leave ``(h, w)`` pixels open, of `FINE` points each, bool.

    Parameters
    ----------
    shape
        Height and width, pixels.
    angle
        Across the stripes, radians.
    step, thick
        From stripe to stripe, and of a stripe, pixels.
    rng
        Draws where they begin.
    """
    height, width = (FINE * size for size in shape)
    y, x = np.mgrid[:height, :width].astype(np.float32)
    along = (x * np.cos(angle) + y * np.sin(angle)) / (FINE * step) + rng.random()
    return np.asarray(along % 1 >= thick / step)


def anywhere(shape: tuple[int, int], rng: np.random.Generator) -> Pair:
    """A point of ``(h, w)`` pixels, x and y."""
    height, width = shape
    return rng.uniform(0, width), rng.uniform(0, height)

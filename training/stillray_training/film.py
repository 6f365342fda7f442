"""Frames as a wider pixel filter would have made them.

Renderers whose samples count in one pixel alone (a box filter; Cycles, which draws them by its
filter) give every pixel noise of its own. Where a sample counts in all pixels that its filter
reaches, as by Mitsuba's and pbrt's Gaussian, there is less noise, which is alike in neighbours.
"""

from __future__ import annotations

from dataclasses import replace
from math import erf, sqrt

import cv2
import numpy as np

from stillray.frame import Frame

DEVIATIONS = (0.3, 0.6)  # pixels; Mitsuba's Gaussian has 0.5 unless told otherwise
_REACH = 2  # pixels to each side, beyond which less than a thousandth of a sample would count


def film_weights(deviation: float) -> np.ndarray:
    """What a sample anywhere in a pixel gives to that pixel's row of neighbours, ``(5,)`` float32.

    Parameters
    ----------
    deviation
        Of a Gaussian pixel filter, in pixels, above 0.
    """
    edges = np.arange(-_REACH, _REACH + 2) - 0.5
    below = np.array([0.5 * (1 + erf(edge / (deviation * sqrt(2)))) for edge in edges])
    weights = np.diff(below)
    return (weights / weights.sum()).astype(np.float32)


def film_variance(deviation: float) -> float:
    """Variance that such a filter adds to one of the render's own, square pixels."""
    places = np.arange(-_REACH, _REACH + 1)
    return float(film_weights(deviation) @ (places * places).astype(np.float32))


def widened(spread: float | None, variance: float) -> float | None:
    """Standard deviation of a pixel filter, in pixels, after a film that adds such a variance.

    None where it is not known. Variances of filters one after the other add up.
    """
    return None if spread is None else sqrt(spread**2 + variance)


def through_film(image: np.ndarray, deviation: float) -> np.ndarray:
    """An image ``(h, w, channels)`` of a box filter as one of a Gaussian, float32.

    Parameters
    ----------
    image
        Finite.
    deviation
        Of the filter, in pixels, above 0.
    """
    weights = film_weights(deviation)
    image = np.ascontiguousarray(image, np.float32)
    return cv2.sepFilter2D(image, -1, weights, weights, borderType=cv2.BORDER_REPLICATE)


def frame_through_film(frame: Frame, deviation: float) -> Frame:
    """A frame whose color, albedo and normals went through a wider filter.

    Depth and motion are a pixel's own in most renderers and stay.
    """
    return replace(
        frame,
        color=through_film(np.nan_to_num(frame.color), deviation),
        albedo=None if frame.albedo is None else through_film(frame.albedo, deviation),
        normal=None if frame.normal is None else through_film(frame.normal, deviation),
    )

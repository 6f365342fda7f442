"""Removal of outliers before anything else looks at a frame, for models that ask for it.

Meng et al. 2020, section 5, take the preprocessing of Kalantari et al. 2015 and tell no numbers.

differs: pixels are compared by luminance, in windows of 3x3 pixels, and how far they may stand out
is the specification's to say. Other layers are filtered as they are given, so that those of a model
that removes outliers no longer add up to its picture.
"""

from __future__ import annotations

import cv2
import numpy as np

from stillray.arrays.strips import Strips, with_halo
from stillray.stages.features import luminance

_SIDE = 3  # pixels of a window
_MEAN = np.full(_SIDE, 1 / _SIDE)


def remove_outliers(color: np.ndarray, deviations: float, strips: Strips) -> np.ndarray:
    """Give pixels that stand out of their window the window's median, channel by channel.

    A pixel stands out whose luminance is above the window's mean by more than so many of its
    standard deviations. The window holds the pixel, so that of nine pixels none can stand out by
    more than 2.83: more deviations than that remove nothing.

    Parameters
    ----------
    color : (h, w, 3) float32
        Radiance, >= 0 and finite. Not changed. Beyond its edge it goes on with its last pixels.
    deviations
        How many, > 0.
    strips
        Where the work runs.

    Returns
    -------
    (h, w, 3) float32
    """
    height, width = color.shape[:2]
    result = np.empty_like(color)

    def work(rows: slice) -> None:
        near, own = with_halo(rows, _SIDE // 2, height)
        light = luminance(color[near]).astype(np.float64)
        mean, square = (_window_mean(plane) for plane in (light, light * light))
        deviation = np.sqrt(np.maximum(square - mean * mean, 0))
        # a flat window's rounding is no outlier
        above = light > mean * (1 + 1e-6) + deviations * deviation
        median = cv2.medianBlur(np.ascontiguousarray(color[near]), _SIDE)
        result[rows] = np.where(above[..., None], median, color[near])[own]

    strips.run(work, height, width)
    return result


def _window_mean(plane: np.ndarray) -> np.ndarray:
    # each window is added anew: running sums keep a residue of every firefly that has passed
    mean: np.ndarray = cv2.sepFilter2D(
        plane, cv2.CV_64F, _MEAN, _MEAN, borderType=cv2.BORDER_REPLICATE
    )
    return mean

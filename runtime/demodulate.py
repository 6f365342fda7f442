"""Albedo demodulation: filter irradiance, so that textures are not filtered away."""

from __future__ import annotations

import cv2
import numpy as np

from stillray.models_spec.loader import Demodulate

_BELOW_ZERO = (-1.0, -1.0, -1.0)


def divisor(albedo: np.ndarray, options: Demodulate) -> np.ndarray:
    """What radiance is divided by, and multiplied by again at the end.

    differs: Fan et al. 2021, section 4.2, divide by the albedo itself. Renderers report albedo 0
    for valid hits (smooth mirrors, glass) and channels near 0.01 for saturated paint; dividing a
    highlight by those makes a coloured firefly. So channels are raised to a floor, and a pixel
    whose albedo says nothing is divided by 1.

    Parameters
    ----------
    albedo : (h, w, 3) float32
        In [0, 1].
    options
        The floor and the black level.

    Returns
    -------
    (h, w, 3) float32
        In [floor, 1]. ``radiance / divisor * divisor`` gives the radiance back to rounding.
    """
    raised = np.maximum(albedo, np.float32(options.floor))
    black = cv2.inRange(albedo, _BELOW_ZERO, (options.black,) * 3)
    if cv2.countNonZero(black):
        raised[black > 0] = 1
    return raised

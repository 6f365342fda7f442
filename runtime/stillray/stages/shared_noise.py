"""Whether neighbouring pixels share their noise, where nobody says the renderer's pixel filter.

A sample that counts in all pixels that the filter reaches (Mitsuba, pbrt) makes noise that is alike
in neighbours; one that counts in a pixel of its own (a box; Cycles, which draws its place by the
filter) does not. The second difference along a line takes the picture away and leaves the noise:
of neighbouring lines it has the same sign as often as another, unless they share it.
"""

from __future__ import annotations

import numpy as np

from stillray.stages.features import luminance

#: Standard deviation of the pixel filter, in pixels, that is assumed where noise is shared: that of
#: Mitsuba's usual one.
SHARED_SPREAD = 0.5
#: Mean product of signs, along rows and along columns, from which noise is shared. Validation's and
#: Blender's frames of 1 to 256 samples have 0.02 to 0.12, through a Gaussian of 0.5 pixels 0.29 to
#: 0.4 (docs/decisions.md).
AGREEMENT = 0.2
_PAIRS = 32  # of neighbouring rows, and of columns, that are looked at
_LEAST = 16  # pixels along each axis: of fewer chance decides
_WHITE = 0.15  # added to the albedo, as surfaces reflect that besides
_DARK = 0.1  # added to light relative to its median


def shared_spread(color: np.ndarray, albedo: np.ndarray | None) -> float | None:
    """The pixel filter's standard deviation, if noise tells that samples count in several pixels.

    Parameters
    ----------
    color : (h, w, 3) float32
        Radiance, finite and >= 0.
    albedo : (h, w, 3) float32 or None
        Textures, which are no noise, are divided away.

    Returns
    -------
    float or None
        Pixels; None where it does not.
    """
    if min(color.shape[:2]) < _LEAST:
        return None
    # rows first: columns, which lie apart in memory, need not be looked at where those differ
    shared = all(_agreement(color, albedo, axis) > AGREEMENT for axis in (0, 1))
    return SHARED_SPREAD if shared else None


def _agreement(color: np.ndarray, albedo: np.ndarray | None, axis: int) -> float:
    """Mean product of the signs of some rows' curvature, or columns', and of those beside."""
    first = np.linspace(0, color.shape[axis] - 2, _PAIRS).astype(int)
    own, other = (_curvature(color, albedo, first + step, axis) for step in (0, 1))
    return float(np.sign(own * other).mean())


def _curvature(
    color: np.ndarray, albedo: np.ndarray | None, lines: np.ndarray, axis: int
) -> np.ndarray:
    """Second differences along some rows or columns of the logarithm of light."""
    light = luminance(np.ascontiguousarray(color.take(lines, axis)))
    if albedo is not None:
        light /= luminance(np.ascontiguousarray(albedo.take(lines, axis))) + np.float32(_WHITE)
    lit = light[light > 0]
    if not len(lit):
        return np.zeros_like(light)
    usual = np.median(lit.astype(np.float64))  # of which the mean of two overflows no more
    logarithm = np.log(light / usual + _DARK)
    if axis:
        logarithm = logarithm.T
    return 2 * logarithm[:, 1:-1] - logarithm[:, :-2] - logarithm[:, 2:]

"""Albedo demodulation: filter irradiance, so that textures are not filtered away."""

from __future__ import annotations

import cv2
import numpy as np

from stillray.arrays.workspace import Workspace
from stillray.model_spec.stages import Demodulate

_BELOW_ZERO = (-1.0, -1.0, -1.0)
_SUM = np.ones((1, 3), np.float32)
_SURE = 4  # three channels at the black level sum to 3 times it, up to rounding


def demodulation_albedo(
    albedo: np.ndarray,
    options: Demodulate,
    out: np.ndarray | None = None,
    workspace: Workspace | None = None,
) -> np.ndarray:
    """What radiance is divided by; and multiplied by again at the end, or by its mean over frames.

    differs: Fan et al. 2021, section 4.2, divide by the albedo itself. Renderers report albedo 0
    for valid hits (smooth mirrors, glass) and channels near 0.01 for saturated paint; dividing a
    highlight by those makes a coloured firefly. So channels are raised to a floor, and a pixel
    whose albedo says nothing counts as white. Varnish and glaze reflect light that their texture
    does not colour: of radiance ``(albedo + specular) E`` the quotient by the sum is ``E``, without
    the texture; by the albedo alone it would be as coloured as the texture's complement.

    Parameters
    ----------
    albedo : (h, w, 3) float32
        In [0, 1].
    options
        The floor, the black level, and what is added for specular reflection.
    out : (h, w, 3) float32, optional
        Written and returned.
    workspace
        Where temporaries lie, if given.

    Returns
    -------
    (h, w, 3) float32
        In [floor, 1] and ``specular`` more. Radiance divided and multiplied by it is the radiance,
        up to rounding.
    """
    raised: np.ndarray = np.clip(albedo, np.float32(options.floor), np.float32(1), out=out)
    # finding black pixels is dear: not where a quick look says that there are none
    if cv2.transform(albedo, _SUM).min() <= _SURE * options.black:
        black = cv2.inRange(albedo, _BELOW_ZERO, (options.black,) * 3)
        ones = (workspace or Workspace()).array("ones", albedo.shape)
        ones.fill(1)
        cv2.copyTo(ones, black, raised)
    if options.specular:
        raised += np.float32(options.specular)
    return raised


def demodulation_planes(
    albedo: np.ndarray, options: Demodulate, out: np.ndarray, workspace: Workspace
) -> np.ndarray:
    """`demodulation_albedo` of planes: ``(3, h, w)`` float32 into ``out`` of that shape."""
    np.clip(albedo, np.float32(options.floor), np.float32(1), out=out)
    largest = workspace.array("largest", albedo.shape[1:])
    cv2.max(albedo[0], albedo[1], dst=largest)
    cv2.max(largest, albedo[2], dst=largest)
    if largest.min() <= options.black:
        black = cv2.inRange(largest, -1.0, options.black)
        ones = workspace.array("ones", largest.shape)
        ones.fill(1)
        for plane in out:
            cv2.copyTo(ones, black, plane)
    if options.specular:
        out += np.float32(options.specular)
    return out

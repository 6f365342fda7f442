"""The past of a model that learns while it denoises, brought to a frame's pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.bounds import at_most
from stillray.arrays.strips import STRIP_PIXELS, Strips, interleave, with_halo
from stillray.families.contract import Context
from stillray.stages.repair import MAX_RADIANCE
from stillray.stages.state import History

_MOST_LOG = np.float32(60)  # of exposed radiance: exp of it is a float32
_ORDINARY = (1e-30, 1e30)  # exposures that a float32 may be divided by
_AROUND = np.ones((3, 3), np.uint8)


@dataclass(frozen=True, kw_only=True, eq=False)
class Past:
    """What holds until the next cut.

    Attributes
    ----------
    first, second : History
        What either half has accumulated, each of its own samples alone. Geometry, the mean albedo
        and the last picture are the first's.
    """

    first: History
    second: History


def exposure_of(first: History, second: History) -> float:
    """Of both halves alike: pictures do not depend on which is called the first."""
    return math.sqrt(first.exposure) * math.sqrt(second.exposure)


def picture_of_past(
    picture: np.ndarray,
    pilots: np.ndarray,
    albedo: np.ndarray | None,
    exposure: float,
    context: Context,
) -> np.ndarray:
    """The last picture as the filter takes it: irradiance in the range of what is around it now.

    differs: Choi et al. 2024 drop the past of a pixel whose surface disagrees. Samples meet the
    surfaces on either side of an edge in turn, so its pixels would never have a past, and stairs
    would stay. Here a picture is looked up as temporal antialiasing does (Karis 2014): without
    geometry, but limited to the range of both pilots in the 3x3 pixels around.

    Parameters
    ----------
    picture : (h, w, 4) float32
        Radiance at these pixels, and how much of it is known, [0, 1].
    pilots : (2, 3, h, w) float32
        This frame's, as logarithms of exposed irradiance.
    albedo : (h, w, 3) float32 or None
        What irradiance is multiplied by; None for 1.
    exposure
        Of this frame.
    context
        Where the work runs; the result lies in its workspace.

    Returns
    -------
    (4, h, w) float32
        Logarithm of exposed irradiance, and how much of it is known.
    """
    height, width = picture.shape[:2]
    out = context.workspace.array("last picture", (4, height, width))

    def work(rows: slice) -> None:
        near, own = with_halo(rows, 1, height)
        light = picture[rows, :, :3] if albedo is None else picture[rows, :, :3] / albedo[rows]
        out[:3, rows] = logarithm(light, exposure).transpose(2, 0, 1)
        out[3, rows] = picture[rows, :, 3]
        for channel, target in enumerate(out[:3, rows]):
            first, second = pilots[:, channel, near]
            least = cv2.erode(np.minimum(first, second), _AROUND)[own]
            most = cv2.dilate(np.maximum(first, second), _AROUND)[own]
            np.clip(target, least, most, out=target)

    context.strips.run(work, height, width, pixels=STRIP_PIXELS // 4)
    return out


def logarithm(radiance: np.ndarray, exposure: float) -> np.ndarray:
    """Log of one and the exposed radiance (Choi et al. 2024, section 4.4), float32."""
    with np.errstate(over="ignore"):
        exposed = radiance * np.float32(exposure)
    return at_most(np.log1p(exposed, out=exposed), _MOST_LOG, out=exposed)


def radiance_of(
    log: np.ndarray, exposure: float, albedo: np.ndarray | None, strips: Strips
) -> np.ndarray:
    """`logarithm` undone, and the light multiplied by the albedo.

    Parameters
    ----------
    log : (3, h, w) float32
        Logarithms of exposed irradiance.
    exposure
        1 / irradiance.
    albedo : (h, w, 3) float32 or None
        None for 1.
    strips
        Where the work runs.

    Returns
    -------
    (h, w, 3) float32
        Finite, 0 or more.
    """
    radiance = np.empty((*log.shape[1:], 3), np.float32)
    kind = np.float32 if _ORDINARY[0] < exposure < _ORDINARY[1] else np.float64

    def work(rows: slice) -> None:
        light = strips.workspace.array("of a logarithm", log[:, rows].shape)
        np.expm1(np.clip(log[:, rows], 0, _MOST_LOG, out=light), out=light)
        with np.errstate(over="ignore"):
            np.divide(light, kind(exposure), out=light, casting="same_kind")
        np.minimum(light, MAX_RADIANCE, out=light)
        interleave(light, out=radiance[rows])
        if albedo is not None:
            radiance[rows] *= albedo[rows]
            at_most(radiance[rows], MAX_RADIANCE, out=radiance[rows])

    strips.run(work, *log.shape[1:])
    return radiance


def exposed(mean: np.ndarray, exposure: float, strips: Strips) -> np.ndarray:
    """`logarithm` of a frame: ``(h, w, 4)`` irradiance and samples to ``(3, h, w)``."""
    planes = np.empty((3, *mean.shape[:2]), np.float32)

    def work(rows: slice) -> None:
        planes[:, rows] = logarithm(mean[rows, :, :3], exposure).transpose(2, 0, 1)

    strips.run(work, *mean.shape[:2], pixels=STRIP_PIXELS // 2)
    return planes

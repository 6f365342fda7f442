"""From irradiance and features to the planes that a network reads."""

from __future__ import annotations

import math

import cv2
import numpy as np

from stillray.models_spec.loader import Temporal, Transfer

_REC709 = np.array([[0.2126, 0.7152, 0.0722]], np.float32)
_BLOCK = 8  # pixels: blocks whose means give the frame's typical irradiance


def luminance(irradiance: np.ndarray) -> np.ndarray:
    """Rec. 709 luminance of an ``(h, w, 3)`` image."""
    return cv2.transform(irradiance, _REC709)


def frame_exposure(light: np.ndarray, options: Transfer) -> float:
    """The scale that brings a frame's typical irradiance to ``middle``.

    Typical is the median of the means of 8x8 blocks that are not black: fireflies and black
    pixels, which are most of a frame at 1 sample a pixel, move it little.

    Parameters
    ----------
    light : (h, w) float32
        Irradiance luminance.

    Returns
    -------
    float
        1 / irradiance, positive and finite; scales inversely with the frame.
    """
    height, width = light.shape
    size = (max(1, width // _BLOCK), max(1, height // _BLOCK))
    blocks = cv2.resize(light, size, interpolation=cv2.INTER_AREA)
    lit = blocks[blocks > 0]
    if lit.size == 0:
        return 1.0
    typical = float(np.median(lit))
    return min(max(options.middle / typical, 1e-30), 1e30)


def steady_exposure(now: float, before: float | None, options: Transfer) -> float:
    """Exposure of a sequence: a running mean of the logarithm, so that it does not pump."""
    if before is None:
        return now
    keep = options.exposure_memory
    return math.exp(keep * math.log(before) + (1 - keep) * math.log(now))


def tone_map(radiance: np.ndarray, exposure: float) -> np.ndarray:
    """``x e / (1 + x e)``, in [0, 1]."""
    # written as 1 - 1 / (1 + x e): an overflow of x e gives 1, not Inf / Inf
    return 1 - 1 / (1 + radiance * np.float32(exposure))


def local_luminance(light: np.ndarray, exposure: float, options: Transfer) -> np.ndarray:
    """Mean of the tone-mapped luminance over ``local_size``: what is usual around a pixel.

    Tone mapping first bounds what one firefly adds to it.

    Returns
    -------
    (h, w) float32
        In [0, 0.9999].
    """
    window = (options.local_size, options.local_size)
    mean = cv2.blur(tone_map(light, exposure), window, borderType=cv2.BORDER_REPLICATE)
    return np.clip(mean, 0, np.float32(0.9999))


def depth_scale(depth: np.ndarray) -> float:
    """Mean depth of what was hit: the unit of the depth feature."""
    hit = cv2.countNonZero(depth)
    return cv2.sumElems(depth)[0] / hit if hit else 1.0


def feature_planes(
    mean: np.ndarray,
    local: np.ndarray,
    exposure: float,
    temporal: Temporal,
    *,
    albedo: np.ndarray | None,
    normal: np.ndarray | None,
    depth: np.ndarray | None,
    depth_unit: float,
) -> dict[str, np.ndarray]:
    """Every feature that a network may ask for, by name.

    Parameters
    ----------
    mean : (h, w, 4) float32
        Accumulated irradiance and samples.
    local : (h, w) float32
        Local luminance of the accumulated irradiance, tone-mapped.
    exposure
        1 / irradiance.
    albedo, normal, depth
        Features of the frame; planes of one that is missing are absent, and read as 0.
    depth_unit
        See `depth_scale`.

    Returns
    -------
    dict
        Name to ``(h, w)`` float32, in [0, 1] ([-1, 1] for normals).
    """
    planes = {}
    # the square root opens the dark end of [0, 1], as a display gamma does
    toned = np.sqrt(tone_map(mean[..., :3], exposure))
    planes.update(
        zip(("irradiance.r", "irradiance.g", "irradiance.b"), cv2.split(toned), strict=True)
    )
    planes["local_luminance"] = np.sqrt(local)
    samples = mean[..., 3]
    planes["samples"] = np.sqrt(samples / (samples + np.float32(temporal.max_samples / 4)))
    if albedo is not None:
        planes.update(zip(("albedo.r", "albedo.g", "albedo.b"), cv2.split(albedo), strict=True))
    if normal is not None:
        planes.update(zip(("normal.x", "normal.y", "normal.z"), cv2.split(normal), strict=True))
    if depth is not None:
        planes["depth"] = depth / (depth + np.float32(depth_unit))
    return planes

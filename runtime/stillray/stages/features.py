"""From irradiance and features to the planes that a network reads."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.strips import planes_of
from stillray.arrays.workspace import Workspace
from stillray.model_spec.planes import PIXEL_FILTER
from stillray.model_spec.stages import Temporal, Transfer

#: Shares of red, green and blue in luminance.
REC709 = np.array([[0.2126, 0.7152, 0.0722]], np.float32)
_ALBEDO = ("albedo.r", "albedo.g", "albedo.b")
_NORMAL = ("normal.x", "normal.y", "normal.z")
_PREVIOUS = ("previous.r", "previous.g", "previous.b")
_PREVIOUS_LUMINANCE, _PREVIOUS_VALID = "previous.luminance", "previous.valid"
_LDR = ("ldr.r", "ldr.g", "ldr.b")
_SCALED_NORMAL = ("scaled_normal.x", "scaled_normal.y", "scaled_normal.z")
#: Exposed irradiance has its typical value at a quarter and surfaces reflect half of it: this
#: brings radiance to where `stillray.compare.display.display_exposure` puts it.
DISPLAY_GAIN = 2.0
_GAMMA = 1 / 2.2
#: Pixels: the standard deviation of a pixel filter at which its plane is 0, as where nobody says,
#: and how far from that it is 1. A box of one pixel has 0.29, Blender's usual filter 0.42.
FILTER_MIDDLE, FILTER_RANGE = 0.35, 0.15
_BLOCK = 8  # pixels: blocks whose means give the frame's typical irradiance


def luminance(irradiance: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
    """Rec. 709 luminance of an ``(h, w, 3)`` image, or of ``(h, w, 4)`` irradiance and samples."""
    if irradiance.shape[2] == 4:  # of three channels OpenCV transforms several pixels at once
        irradiance = cv2.cvtColor(irradiance, cv2.COLOR_RGBA2RGB)
    return cv2.transform(irradiance, REC709, dst=out)


def luminance_of_planes(planes: np.ndarray | Sequence[np.ndarray], out: np.ndarray) -> np.ndarray:
    """`luminance` of ``(3 or more, h, w)`` into ``out`` of ``(h, w)``."""
    red, green, blue = map(float, REC709[0])
    cv2.addWeighted(planes[0], red, planes[1], green, 0, dst=out)
    return cv2.scaleAdd(planes[2], blue, out, dst=out)


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


def steady_exposure(now: float, before: float, options: Transfer) -> float:
    """Exposure of a sequence: a running mean of the logarithm, so that it does not pump."""
    keep = options.exposure_memory
    return math.exp(keep * math.log(before) + (1 - keep) * math.log(now))


def tone_map(radiance: np.ndarray, exposure: float, out: np.ndarray | None = None) -> np.ndarray:
    """``x e / (1 + x e)``, in [0, 1]; written to ``out`` if given."""
    # written as 1 - 1 / (1 + x e): an overflow of x e gives 1, not Inf / Inf
    with np.errstate(over="ignore"):
        mapped: np.ndarray = np.multiply(radiance, np.float32(exposure), out=out)
    mapped += 1
    np.reciprocal(mapped, out=mapped)
    return np.subtract(1, mapped, out=mapped)


def local_luminance(toned: np.ndarray, options: Transfer) -> np.ndarray:
    """Mean of the tone-mapped luminance over ``local_size``: what is usual around a pixel.

    Tone mapping first bounds what one firefly adds to it.

    Parameters
    ----------
    toned : (h, w) float32
        `tone_map` of the irradiance's luminance, in [0, 1].

    Returns
    -------
    (h, w) float32
        In [0, 1], up to rounding.
    """
    kernel = np.full(options.local_size, 1 / options.local_size, np.float32)
    # each window is added anew, so that a strip of rows gives what the whole frame gives
    return cv2.sepFilter2D(toned, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REPLICATE)


def depth_scale(depth: np.ndarray) -> float:
    """Mean depth of what was hit: the unit of the depth feature."""
    hit = cv2.countNonZero(depth)
    return cv2.sumElems(depth)[0] / hit if hit else 1.0


def filter_feature(spread: float | None) -> float:
    """What a network is told of a pixel filter, in [-1, 1]; 0 where its spread is not known.

    Where a glint or a bright edge ends, a filter decides: samples of a box are their own pixel's,
    a soft one's reach into the next.
    """
    if spread is None:
        return 0.0
    return min(max((spread - FILTER_MIDDLE) / FILTER_RANGE, -1.0), 1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class FeatureInputs:
    """Rows of a frame, of which `feature_planes` are made.

    Attributes
    ----------
    mean : (h, w, 4) float32
        Accumulated irradiance and samples.
    local : (h, w) float32
        Local luminance of the accumulated irradiance, tone-mapped.
    exposure
        1 / irradiance.
    sample : (h, w) float32
        Luminance of this frame's irradiance.
    albedo, normal : (h, w, 3) float32 or None
    depth : (h, w) float32 or None
        Planes of a buffer that is missing are filled with 0.
    depth_unit
        See `depth_scale`.
    frame_samples : number or (h, w) float32
        Samples a pixel of a frame, > 0; 1 where nobody said.
    filter_spread
        Standard deviation of the renderer's pixel filter, in pixels; None where nobody said.
    demodulation_albedo : (h, w, 3) float32 or None
        What radiance was divided by; None where ``mean`` is radiance.
    """

    mean: np.ndarray
    local: np.ndarray
    exposure: float
    sample: np.ndarray
    albedo: np.ndarray | None = None
    normal: np.ndarray | None = None
    depth: np.ndarray | None = None
    depth_unit: float = 1.0
    frame_samples: float | np.ndarray = 1.0
    filter_spread: float | None = None
    demodulation_albedo: np.ndarray | None = None


def feature_planes(
    given: FeatureInputs,
    temporal: Temporal,
    features: Sequence[str],
    *,
    out: np.ndarray,
    workspace: Workspace | None = None,
) -> None:
    """Fill the planes that a network asks for.

    Parameters
    ----------
    given
        What they are made of.
    temporal
        Its ``max_samples`` scales the samples' plane.
    features
        Names of the planes, of `stillray.model_spec.planes.FEATURES`.
    out : (len(features), h, w) float32
        Written: values in [0, 1] ([-1, 1] for normals).
    workspace
        Where temporaries lie, if given.
    """
    local, exposure, albedo, depth = given.local, given.exposure, given.albedo, given.depth
    workspace = workspace or Workspace()
    plane = dict(zip(features, out, strict=True))
    *irradiance, samples = planes_of(given.mean, out=workspace.array("mean", (4, *local.shape)))
    for name, light in zip("rgb", irradiance, strict=True):
        if (target := plane.get(f"irradiance.{name}")) is not None:
            # the square root opens the dark end of [0, 1], as a display gamma does
            np.sqrt(tone_map(light, exposure, out=target), out=target)
    if (target := plane.get("irradiance.luminance")) is not None:
        light = luminance_of_planes(irradiance, out=target)
        np.sqrt(tone_map(light, exposure, out=target), out=target)
    if (target := plane.get("sample.luminance")) is not None:
        np.sqrt(tone_map(given.sample, exposure, out=target), out=target)
    if (target := plane.get("albedo.luminance")) is not None:
        if albedo is None:
            target.fill(0)
        else:
            luminance(albedo, out=target)
    if (target := plane.get("local_luminance")) is not None:
        np.sqrt(local, out=target)
    if (target := plane.get("samples")) is not None:
        samples *= np.float32(given.frame_samples)
        np.add(samples, np.float32(temporal.max_samples / 4), out=target)
        np.divide(samples, target, out=target)
        np.sqrt(target, out=target)
    if (target := plane.get(PIXEL_FILTER)) is not None:
        target.fill(filter_feature(given.filter_spread))
    for image, names in ((albedo, _ALBEDO), (given.normal, _NORMAL)):
        for channel, name in enumerate(names):
            if (target := plane.get(name)) is not None:
                target[...] = 0 if image is None else image[..., channel]
    if (target := plane.get("depth")) is not None:
        if depth is None:
            target[...] = 0
        else:
            np.add(depth, np.float32(given.depth_unit), out=target)
            np.divide(depth, target, out=target)
    for channel, name in enumerate(_LDR):
        if (target := plane.get(name)) is not None:
            _displayed(irradiance[channel], channel, given, target)
    for channel, name in enumerate(_SCALED_NORMAL):
        if (target := plane.get(name)) is not None:
            target[...] = 0 if given.normal is None else given.normal[..., channel]
            target += 1
            target /= 2


def _displayed(light: np.ndarray, channel: int, given: FeatureInputs, out: np.ndarray) -> None:
    """A channel of radiance as a screen would show it, in [0, 1] (Fan et al. 2021, section 5.1).

    differs: exposed; the paper's scenes are all of one brightness.
    """
    with np.errstate(over="ignore"):
        np.multiply(light, np.float32(given.exposure * DISPLAY_GAIN), out=out)
    if given.demodulation_albedo is not None:
        out *= given.demodulation_albedo[..., channel]
    np.clip(out, 0, 1, out=out)
    np.power(out, np.float32(_GAMMA), out=out)


def previous_planes(
    previous: np.ndarray | None,
    remodulation_albedo: np.ndarray | None,
    exposure: float,
    features: Sequence[str],
    *,
    out: np.ndarray,
    workspace: Workspace | None = None,
) -> None:
    """Fill the planes of the previous output, for networks that ask for them.

    Parameters
    ----------
    previous : (h, w, 4) float32 or None
        Radiance of the previous output at these pixels and, last, how much of it is valid; None
        where there is no past: zeros.
    remodulation_albedo : (h, w, 3) float32 or None
        What radiance is divided by, so that the output compares with the irradiance.
    exposure
        1 / irradiance.
    features
        Names of the planes.
    out : (len(features), h, w) float32
        Written: values in [0, 1].
    workspace
        Where temporaries lie, if given.
    """
    plane = dict(zip(features, out, strict=True))
    workspace = workspace or Workspace()
    if previous is None:
        for name in (*_PREVIOUS, _PREVIOUS_LUMINANCE, _PREVIOUS_VALID):
            if name in plane:
                plane[name].fill(0)
        return
    if (target := plane.get(_PREVIOUS_VALID)) is not None:
        cv2.extractChannel(previous, 3, dst=target)
    if (target := plane.get(_PREVIOUS_LUMINANCE)) is not None:
        light = luminance(previous, out=target)
        if remodulation_albedo is not None:
            by = luminance(remodulation_albedo, out=workspace.array("light", light.shape))
            light = np.divide(light, by, out=target)
        np.sqrt(tone_map(light, exposure, out=target), out=target)
    if any(name in plane for name in _PREVIOUS):
        planes = planes_of(previous, out=workspace.array("previous", (4, *previous.shape[:2])))
        for channel, name in enumerate(_PREVIOUS):
            if (target := plane.get(name)) is not None:
                light = planes[channel]
                if remodulation_albedo is not None:
                    light = np.divide(light, remodulation_albedo[..., channel], out=target)
                np.sqrt(tone_map(light, exposure, out=target), out=target)

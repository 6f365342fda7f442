"""What a filter of Open Image Denoise does, done by a `Denoiser`: ranges, curves and guides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from stillray.arrays import srgb
from stillray.errors import InputError
from stillray.frame import Frame
from stillray.oidn.constants import OIDN_FILTER_TYPE_RT, OIDN_FILTER_TYPE_RT_LIGHTMAP
from stillray.pipeline.denoiser import Denoiser
from stillray.pipeline.tiles import BASE_BYTES, FRAME_BYTES

FILTER_TYPES = (OIDN_FILTER_TYPE_RT, OIDN_FILTER_TYPE_RT_LIGHTMAP)


class Values(Enum):
    """What the numbers of a picture are."""

    HDR = "scene-linear radiance, 0 and more"
    LDR = "linear, in [0, 1]"
    SRGB = "sRGB values in [0, 1]"
    SIGNED = "in [-1, 1]: normals, coefficients of directional lightmaps"


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """Of a filter; those that change nothing here are not among them.

    Attributes
    ----------
    filter_type
        ``"RT"`` or ``"RTLightmap"``; color of the latter is HDR, or directional.
    hdr, srgb, directional
        What the color's values are; linear in [0, 1] where none is set.
    max_memory_mb
        MiB that the network and the reconstruction may take beside the frame's buffers, which
        are done in tiles then; negative for no bound.
    """

    filter_type: str = OIDN_FILTER_TYPE_RT
    hdr: bool = False
    srgb: bool = False
    directional: bool = False
    max_memory_mb: int = -1

    @property
    def color_values(self) -> Values:
        """What the color's values are."""
        if self.filter_type == OIDN_FILTER_TYPE_RT_LIGHTMAP:
            return Values.SIGNED if self.directional else Values.HDR
        if self.hdr:
            return Values.HDR
        return Values.SRGB if self.srgb else Values.LDR


def filtered(
    images: Mapping[str, np.ndarray], parameters: Parameters, denoiser: Denoiser
) -> np.ndarray:
    """Filter color by itself and its guides; or, without color, albedo or normal alone.

    Parameters
    ----------
    images
        ``"color"``, ``"albedo"``, ``"normal"``: ``(h, w, 3)``, or of one channel, float16 or
        float32. Not changed.
    parameters
        What the values mean.
    denoiser
        With ``temporal=False``.

    Returns
    -------
    (h, w, channels) float32
        The picture, with as many channels and in the same curve and range as what was filtered.

    Raises
    ------
    InputError
        There is nothing to filter, sizes differ, or the memory does not suffice.
    """
    name, values = _subject(images, parameters)
    subject = images[name]
    for other, image in images.items():
        if image.shape[:2] != subject.shape[:2]:
            raise InputError(
                f"{other} must have {name}'s size {subject.shape[:2]}, got {image.shape[:2]}"
            )
    guides = {}
    # coefficients of a direction are not divided by albedo, and a guide has no guide
    if name == "color" and values is not Values.SIGNED:
        guides = {n: _three(images[n]) for n in ("albedo", "normal") if n in images}
    frame = Frame(color=radiance_of(_three(subject), values), **guides)
    denoiser.max_memory = None
    if parameters.max_memory_mb >= 0:
        height, width = frame.shape
        scratch = parameters.max_memory_mb << 20
        denoiser.max_memory = BASE_BYTES + FRAME_BYTES * height * width + scratch
    result = values_of(denoiser.denoise(frame), values)
    return result if subject.shape[2] == 3 else result[..., :1]


def radiance_of(image: np.ndarray, values: Values) -> np.ndarray:
    """Radiance to denoise; what lies beyond the range of the values is clipped."""
    if values is Values.HDR:
        return image
    image = np.asarray(image, np.float32)
    if values is Values.SIGNED:
        # every picture is a weighted mean of what is there, so a shift goes through unchanged
        return (np.clip(image, -1, 1) + np.float32(1)) * np.float32(0.5)
    image = np.clip(image, 0, 1)
    return srgb.decode(image) if values is Values.SRGB else image


def values_of(radiance: np.ndarray, values: Values) -> np.ndarray:
    """`radiance_of` undone."""
    if values is Values.HDR:
        return radiance
    radiance = np.clip(radiance, 0, 1)
    if values is Values.SIGNED:
        return radiance * np.float32(2) - np.float32(1)
    return srgb.encode(radiance) if values is Values.SRGB else radiance


def _subject(images: Mapping[str, np.ndarray], parameters: Parameters) -> tuple[str, Values]:
    if "color" in images:
        return "color", parameters.color_values
    if len(images) == 1 and parameters.filter_type == OIDN_FILTER_TYPE_RT:
        if "albedo" in images:
            return "albedo", Values.LDR
        if "normal" in images:
            return "normal", Values.SIGNED
    raise InputError(
        f"color must be given, or albedo or normal alone to an RT filter, got "
        f"{' and '.join(images) or 'no image'}"
    )


def _three(image: np.ndarray) -> np.ndarray:
    return image if image.shape[2] == 3 else np.repeat(image, 3, axis=2)

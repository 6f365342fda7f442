"""What the numbers of a picture are, and radiance to filter in their place."""

from __future__ import annotations

from enum import Enum

import numpy as np

from stillray.arrays import srgb
from stillray.errors import InputError


class Encoding(Enum):
    """What the numbers of a picture are."""

    HDR = "hdr"  #: scene-linear radiance, 0 and more
    LDR = "ldr"  #: linear, in [0, 1]
    SRGB = "srgb"  #: sRGB values in [0, 1]
    SIGNED = "signed"  #: in [-1, 1]: normals, coefficients of directional lightmaps


def encoding_of(name: str) -> Encoding:
    """An encoding by its name.

    Raises
    ------
    InputError
        There is none of that name.
    """
    try:
        return Encoding(name)
    except ValueError:
        names = ", ".join(encoding.value for encoding in Encoding)
        raise InputError(f"encoding must be one of {names}, got {name!r}") from None


def decoded(image: np.ndarray, encoding: Encoding) -> np.ndarray:
    """Radiance to denoise; what lies beyond the range of the encoding is clipped."""
    if encoding is Encoding.HDR:
        return image
    image = np.asarray(image, np.float32)
    if encoding is Encoding.SIGNED:
        # every picture is a weighted mean of what is there, so a shift goes through unchanged
        return (np.clip(image, -1, 1) + np.float32(1)) * np.float32(0.5)
    image = np.clip(image, 0, 1)
    return srgb.decode(image) if encoding is Encoding.SRGB else image


def encoded(radiance: np.ndarray, encoding: Encoding) -> np.ndarray:
    """`decoded` undone."""
    if encoding is Encoding.HDR:
        return radiance
    radiance = np.clip(radiance, 0, 1)
    if encoding is Encoding.SIGNED:
        return radiance * np.float32(2) - np.float32(1)
    return srgb.encode(radiance) if encoding is Encoding.SRGB else radiance

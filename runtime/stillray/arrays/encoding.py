"""What the numbers of a picture are, and radiance to filter in their place."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum

import numpy as np

from stillray.arrays import srgb
from stillray.arrays.strips import Strips
from stillray.errors import InputError

_STRIP_PIXELS = 1 << 15  # powers in double precision take a tenth of a microsecond a value


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


def decoded(image: np.ndarray, encoding: Encoding, strips: Strips) -> np.ndarray:
    """Radiance to denoise, ``(h, w, 3)``; what lies beyond the encoding's range is clipped."""
    if encoding is Encoding.HDR:
        return image
    return _by_strips(lambda part: _decoded(part, encoding), image, strips)


def encoded(radiance: np.ndarray, encoding: Encoding, strips: Strips) -> np.ndarray:
    """`decoded` undone."""
    if encoding is Encoding.HDR:
        return radiance
    return _by_strips(lambda part: _encoded(part, encoding), radiance, strips)


def _by_strips(
    change: Callable[[np.ndarray], np.ndarray], image: np.ndarray, strips: Strips
) -> np.ndarray:
    changed = np.empty(image.shape, np.float32)

    def work(rows: slice) -> None:
        changed[rows] = change(image[rows])

    strips.run(work, *image.shape[:2], pixels=_STRIP_PIXELS)
    return changed


def _decoded(image: np.ndarray, encoding: Encoding) -> np.ndarray:
    image = np.asarray(image, np.float32)
    if encoding is Encoding.SIGNED:
        # every picture is a weighted mean of what is there, so a shift goes through unchanged
        return (np.clip(image, -1, 1) + np.float32(1)) * np.float32(0.5)
    image = np.clip(image, 0, 1)
    return srgb.decode(image) if encoding is Encoding.SRGB else image


def _encoded(radiance: np.ndarray, encoding: Encoding) -> np.ndarray:
    radiance = np.clip(radiance, 0, 1)
    if encoding is Encoding.SIGNED:
        return radiance * np.float32(2) - np.float32(1)
    return srgb.encode(radiance) if encoding is Encoding.SRGB else radiance

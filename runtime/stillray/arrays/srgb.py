"""The sRGB curve (IEC 61966-2-1), both ways, for pictures that are stored as screens show them."""

from __future__ import annotations

import numpy as np

_LINEAR_UNTIL = 0.0031308  # where the straight part of the curve ends, in light
_SLOPE = 12.92
_EXPONENT = 2.4
_OFFSET = 0.055


def decode(shown: np.ndarray) -> np.ndarray:
    """Linear light of sRGB values in [0, 1], float32."""
    shown = np.asarray(shown, np.float32)
    straight = shown / np.float32(_SLOPE)
    curved = ((np.maximum(shown, 0) + np.float32(_OFFSET)) / np.float32(1 + _OFFSET)) ** _EXPONENT
    return np.where(shown <= _LINEAR_UNTIL * _SLOPE, straight, curved).astype(np.float32)


def encode(light: np.ndarray) -> np.ndarray:
    """sRGB values of linear light in [0, 1], float32."""
    # in double precision, so that white stays 1: programs that truncate would make it 254
    light = np.asarray(light, np.float64)
    straight = light * _SLOPE
    curved = (1 + _OFFSET) * np.maximum(light, 0) ** (1 / _EXPONENT) - _OFFSET
    return np.where(light <= _LINEAR_UNTIL, straight, curved).astype(np.float32)

"""How colour is written in the tensors of a spatial graph.

Open Image Denoise's networks see HDR colour through a curve of its own, and so does a network that
takes the place of one: near black a line, then a power, then a logarithm, scaled so that the
largest half float is 1. The numbers are those of `core/color.h` of Open Image Denoise (Apache-2.0),
a fit of the perceptually uniform curve of Aydin et al. 2008.
"""

from __future__ import annotations

import math
from enum import StrEnum

import torch
from torch import Tensor

_MOST = 65504.0  # radiance, times the exposure of whoever encodes
_LINE = 1.41283765e3
_SCALE, _POWER, _OFFSET = 1.64593172, 0.431384981, -2.94139609e-3
_LOG_SCALE, _LOG_SHIFT, _LOG_OFFSET = 0.192653254, 6.26026094e-3, 0.998620152
_DARK, _BRIGHT = 1.57945760e-6, 3.22087631e-2  # radiance at which a piece begins
_NORM = _LOG_SCALE * math.log(_MOST + _LOG_SHIFT) + _LOG_OFFSET
_DARK_CODE = _LINE * _DARK
_BRIGHT_CODE = _LOG_SCALE * math.log(_BRIGHT + _LOG_SHIFT) + _LOG_OFFSET


class ColorCurve(StrEnum):
    """What the numbers of color are."""

    #: Radiance, times any exposure, through Open Image Denoise's curve for HDR: [0, 1].
    OIDN = "oidn"
    #: Scene-linear radiance.
    LINEAR = "linear"


def decoded(code: Tensor, curve: ColorCurve) -> Tensor:
    """Radiance of colour as it is written; not a number stays so, to be repaired."""
    if curve is ColorCurve.LINEAR:
        return code
    scaled = code.clamp(0, 1) * _NORM
    # each piece within its own range: what is computed and not taken must not overflow
    power = (scaled.clamp(min=_DARK_CODE) - _OFFSET) / _SCALE
    logarithm = (scaled - _LOG_OFFSET) / _LOG_SCALE
    bright = torch.where(
        scaled <= _BRIGHT_CODE, power.pow(1 / _POWER), logarithm.exp() - _LOG_SHIFT
    )
    return torch.where(scaled <= _DARK_CODE, scaled / _LINE, bright)


def encoded(radiance: Tensor, curve: ColorCurve) -> Tensor:
    """`decoded` undone, of radiance that is not negative."""
    if curve is ColorCurve.LINEAR:
        return radiance
    radiance = radiance.clamp(max=_MOST)
    power = _SCALE * radiance.clamp(min=_DARK).pow(_POWER) + _OFFSET
    logarithm = _LOG_SCALE * (radiance + _LOG_SHIFT).log() + _LOG_OFFSET
    bright = torch.where(radiance <= _BRIGHT, power, logarithm)
    return torch.where(radiance <= _DARK, _LINE * radiance, bright) / _NORM

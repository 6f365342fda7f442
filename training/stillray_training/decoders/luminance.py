"""Luminance, the twin of `stillray.stages.features.luminance`."""

from __future__ import annotations

from torch import Tensor

_REC709 = (0.2126, 0.7152, 0.0722)


def luminance(planes_nchw: Tensor) -> Tensor:
    """Rec. 709 luminance of the first three channels, ``(n, 1, h, w)``."""
    red, green, blue = (planes_nchw[:, i : i + 1] for i in range(3))
    return red * _REC709[0] + green * _REC709[1] + blue * _REC709[2]

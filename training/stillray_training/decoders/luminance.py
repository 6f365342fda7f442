"""Luminance, the twin of `stillray.stages.features.luminance`."""

from __future__ import annotations

from torch import Tensor

from stillray.stages import features as runtime

# the runtime's numbers, so that there is one place for them
_RED, _GREEN, _BLUE = map(float, runtime.REC709[0])


def luminance(planes_nchw: Tensor) -> Tensor:
    """Rec. 709 luminance of the first three channels, ``(n, 1, h, w)``."""
    red, green, blue = (planes_nchw[:, i : i + 1] for i in range(3))
    return red * _RED + green * _GREEN + blue * _BLUE

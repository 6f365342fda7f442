"""Training losses."""

from __future__ import annotations

from torch import Tensor

# Light below which the display curve is taken as straight: its slope at 0 would be infinite.
_TOE = 1e-3
# Exposed irradiance has its typical value at a quarter and surfaces reflect half of it: this
# brings radiance to where `stillray.display.display_exposure` puts it.
_DISPLAY_GAIN = 2.0


def smape(image: Tensor, reference: Tensor, epsilon: float) -> Tensor:
    """Symmetric mean absolute percentage error, in [0, 1] (Fan et al. 2021, eq. 6).

    Parameters
    ----------
    image, reference
        Radiance of one shape, >= 0.
    epsilon
        Radiance below which differences count less.
    """
    # per pixel first, then the mean: half-precision references do not overflow the sum
    return ((image - reference).abs() / (image.abs() + reference.abs() + epsilon)).mean()


def displayed_error(image: Tensor, reference: Tensor) -> Tensor:
    """Mean absolute error of what a screen would show: clipped, with a power of 1 / 2.2.

    Parameters
    ----------
    image, reference
        Exposed radiance of one shape, >= 0.
    """
    return (_displayed(image) - _displayed(reference)).abs().mean()


def _displayed(exposed: Tensor) -> Tensor:
    return ((exposed * _DISPLAY_GAIN).clamp(0, 1) + _TOE) ** (1 / 2.2)

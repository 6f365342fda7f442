"""Training losses."""

from __future__ import annotations

from torch import Tensor


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

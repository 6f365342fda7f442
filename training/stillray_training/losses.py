"""Training losses."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from stillray.stages.features import DISPLAY_GAIN

# Light below which the display curve is taken as straight: its slope at 0 would be infinite.
_TOE = 1e-3
_WINDOW = 7  # pixels of a window of structural similarity
_STRIDE = 4  # of the windows: they overlap, and a sixteenth of them says the same
_C1, _C2 = 0.01**2, 0.03**2  # Wang et al. 2004: keep its ratios finite in even windows
_CLOSE = 0.05  # of the display's range


def per_patch(values: Tensor) -> Tensor:
    """The mean of each patch, ``(n,)``."""
    return values.flatten(1).mean(1)


def smape(image: Tensor, reference: Tensor, epsilon: float) -> Tensor:
    """Symmetric mean absolute percentage error of each patch, in [0, 1] (Fan et al. 2021, eq. 6).

    Parameters
    ----------
    image, reference
        Radiance of one shape, >= 0.
    epsilon
        Radiance below which differences count less.
    """
    # per pixel first, then the mean: half-precision references do not overflow the sum
    return per_patch((image - reference).abs() / (image.abs() + reference.abs() + epsilon))


def displayed(exposed: Tensor) -> Tensor:
    """What a screen would show of exposed radiance: clipped, with a power of 1 / 2.2, in [0, 1]."""
    return ((exposed * DISPLAY_GAIN).clamp(0, 1) + _TOE) ** (1 / 2.2)


def filmic(exposed: Tensor) -> Tensor:
    """Exposed radiance after a filmic curve with its display gamma, in [0, 1).

    The rational fit of Hejl and Burgess-Dawson (Hable 2010, *Filmic tonemapping operators*): the
    curve that Tungsten calls filmic, and Meng et al. 2020 and Fan et al. 2021 show their 64-sample
    data through.
    """
    light = (exposed * DISPLAY_GAIN - 0.004).clamp(min=0)
    # both sides divided by the light's square, which would leave float32
    light = light.clamp(max=1e6)
    return light * (6.2 * light + 0.5) / (light * (6.2 * light + 1.7) + 0.06)


def dissimilarity(shown: Tensor, wanted: Tensor) -> Tensor:
    """One minus the structural similarity, of each patch.

    differs: Wang et al. 2004 weigh a window by a Gaussian of 11 pixels; here it is a plain mean of
    7, as `skimage.metrics.structural_similarity` takes it, of the channels' mean alone, and windows
    are taken at every fourth pixel.

    Parameters
    ----------
    shown, wanted
        `displayed`, ``(n, 3, h, w)``, 7 pixels or more each way.
    """
    a, b = (part.mean(1, keepdim=True) for part in (shown, wanted))
    moments = F.avg_pool2d(torch.cat([a, b, a * a, b * b, a * b], 1), _WINDOW, stride=_STRIDE)
    mean_a, mean_b, aa, bb, ab = moments.unbind(1)
    both = mean_a * mean_b
    squares = mean_a * mean_a + mean_b * mean_b
    likeness = (2 * both + _C1) * (2 * (ab - both) + _C2)
    return per_patch(1 - likeness / ((squares + _C1) * (aa + bb - squares + _C2)))


def slope_error(error: Tensor) -> Tensor:
    """Mean absolute slope of what is wrong, of each patch, after a blur of one pixel.

    Stippled silhouettes and lost relief are errors of slopes, which differences of pixels hardly
    count; the blur keeps the noise of single pixels from counting here too.

    Parameters
    ----------
    error : (n, 3, h, w)
        Difference of two pictures, `displayed`.
    """
    smooth = F.avg_pool2d(error, 2, stride=1)
    across = (smooth[..., 1:] - smooth[..., :-1]).abs()
    down = (smooth[..., 1:, :] - smooth[..., :-1, :]).abs()
    return per_patch(across) + per_patch(down)


def blur_error(error: Tensor) -> Tensor:
    """Mean absolute means of 4x4 and 16x16 pixels of what is wrong, of each patch: mottling."""
    fine = F.avg_pool2d(error, 4)
    return per_patch(fine.abs()) + per_patch(F.avg_pool2d(fine, 4).abs())


def mean_error(error: Tensor) -> Tensor:
    """How far the mean of each patch is off, of its colors' mean.

    What a pixel's noise leaves open is answered best by its median where absolute errors count,
    and light is skewed: pictures would be too dark.

    Parameters
    ----------
    error : (n, 3, h, w)
        Difference of two pictures, `displayed`.
    """
    return per_patch(error.mean((2, 3)).abs())


def excess(error: Tensor, before: Tensor) -> Tensor:
    """How much further off the result is than the input was, over squares of 4x4 pixels.

    A patch may gain as a whole while its silhouettes lose; of a single pixel, noise may be right by
    chance.

    Parameters
    ----------
    error, before : (n, 3, h, w)
        Absolute differences from the reference, `displayed`, of the result and of the input.
    """
    return per_patch((F.avg_pool2d(error, 4) - F.avg_pool2d(before, 4)).relu())


def unsteadiness(shown: Tensor, wanted: Tensor, before: Tensor, valid: Tensor) -> Tensor:
    """Mean change of each patch where the previous output was as good as right.

    A previous output further than `_CLOSE` from the reference pulls ever less: the light moved.

    Parameters
    ----------
    shown, wanted, before
        `displayed`, ``(n, 3, h, w)``: the image, the reference and the previous output.
    valid : (n, 1, h, w)
        How much of the previous output lay in the frame.
    """
    close = valid * (-(before - wanted).abs() / _CLOSE).exp()
    return per_patch(close * (shown - before).abs())

"""Accumulation over time that neither smears fireflies nor forgets what a pixel is worth."""

from __future__ import annotations

import cv2
import numpy as np

from stillray.models_spec.loader import Temporal
from stillray.scratch import Scratch
from stillray.strips import planes_of


def sample_weight(
    luminance: np.ndarray,
    local: np.ndarray,
    exposure: float,
    options: Temporal,
    scratch: Scratch | None = None,
) -> np.ndarray:
    """What a new sample is worth, in (0, 1]: less, the further it stands above its surroundings.

    With ``s`` the local radiance, a sample of luminance ``L`` weighs
    ``1 / (1 + L / (outlier_ratio (s + s0)))``: its product with ``L`` stays bounded, so one
    firefly moves a mean by no more than a few ordinary samples, and the pixel's sample count says
    that little is known there.

    differs: Fan et al. 2021 average plainly (section 4.1), which smears fireflies over the frames
    that follow. The ratio trades that against lost energy: where most samples are black, a bright
    one is ordinary. Measured on the validation scenes with a 5x5 box as the filter, PSNR: 20.2 dB
    at ratio 4, 22.8 at 16, 23.5 at 64 (kept), 23.3 at 512, 23.2 without.

    Parameters
    ----------
    luminance : (h, w) float32
        Irradiance luminance, >= 0.
    local : (h, w) float32
        Tone-mapped local luminance ``t = s e / (1 + s e)`` in [0, 1), see
        `stillray.encode.local_luminance`.
    exposure
        ``e``, 1 / irradiance.
    scratch
        Where the result and what leads to it lie, if given.

    Returns
    -------
    (h, w) float32
    """
    scratch = scratch or Scratch()
    # in exposed units: s e = t / (1 - t); DARK is a small share of the frame's typical value
    typical = scratch.array("typical", local.shape)
    weight = scratch.array("weight", local.shape)
    np.clip(local, np.float32(0), np.float32(0.9999), out=typical)
    typical /= np.subtract(1, typical, out=weight)
    typical += np.float32(DARK)
    # 1 / (1 + L / typical), as typical / (typical + L)
    np.multiply(luminance, np.float32(exposure / options.outlier_ratio), out=weight)
    weight += typical
    np.divide(typical, weight, out=weight)
    # a weight of exactly 0 would leave windows of fireflies empty
    return np.clip(weight, np.float32(MIN_WEIGHT), np.float32(1), out=weight)


#: Exposed irradiance below which surroundings no longer count as darker.
DARK = 0.02
#: Smallest weight of a sample, so that it is better than nothing.
MIN_WEIGHT = 1e-6


def accumulate(
    irradiance: np.ndarray,
    weight: np.ndarray,
    planes: np.ndarray,
    options: Temporal,
    scratch: Scratch | None = None,
) -> None:
    """Running weighted mean of samples.

    Parameters
    ----------
    irradiance : (h, w, 3) float32
        This frame's sample.
    weight : (h, w) float32
        What it is worth, in (0, 1].
    planes : (4, h, w) float32
        The past at these pixels: finite irradiance and, last, its samples, 0 where there is no
        past. Overwritten with the mean irradiance and the samples that it holds, at most
        ``max_samples + 1``.
    scratch
        Where temporaries lie, if given.
    """
    scratch = scratch or Scratch()
    samples = planes[3]
    np.clip(samples, np.float32(0), np.float32(options.max_samples), out=samples)
    samples += weight
    share = np.divide(weight, samples, out=scratch.array("share", samples.shape))
    rest = np.subtract(1, share, out=scratch.array("rest", samples.shape))
    new = planes_of(irradiance, out=scratch.array("new", (3, *samples.shape)))
    # mean + share (new - mean) cancels where a firefly meets a dark past; two products do not
    planes[:3] *= rest
    for mean, sample in zip(planes[:3], new, strict=True):
        cv2.accumulateProduct(sample, share, mean)

"""Accumulation over time that neither smears fireflies nor forgets what a pixel is worth."""

from __future__ import annotations

import cv2
import numpy as np

from stillray.models_spec.loader import Temporal
from stillray.strips import planes_of


def sample_weight(
    luminance: np.ndarray, local: np.ndarray, exposure: float, options: Temporal
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

    Returns
    -------
    (h, w) float32
    """
    # in exposed units: s e = t / (1 - t); DARK is a small share of the frame's typical value
    local = np.clip(local, 0, np.float32(0.9999))
    typical = local / (1 - local)
    typical += np.float32(DARK)
    ratio = luminance * np.float32(exposure / options.outlier_ratio)
    ratio /= typical
    ratio += 1
    np.reciprocal(ratio, out=ratio)
    # a weight of exactly 0 would leave windows of fireflies empty
    return np.maximum(ratio, np.float32(MIN_WEIGHT), out=ratio)


#: Exposed irradiance below which surroundings no longer count as darker.
DARK = 0.02
#: Smallest weight of a sample, so that it is better than nothing.
MIN_WEIGHT = 1e-6


def accumulate(
    irradiance: np.ndarray, weight: np.ndarray, reprojected: np.ndarray | None, options: Temporal
) -> np.ndarray:
    """Running weighted mean of samples.

    Parameters
    ----------
    irradiance : (h, w, 3) float32
        This frame's sample.
    weight : (h, w) float32
        What it is worth, in [0, 1].
    reprojected : (h, w, 4) float32 or None
        The past at these pixels: irradiance and its samples. None in the first frame.

    Returns
    -------
    (h, w, 4) float32
        Mean irradiance and the samples that it holds, at most ``max_samples + 1``.
    """
    if reprojected is None:
        return cv2.merge([irradiance, weight])
    # planes, not interleaved pixels: NumPy's inner loops then run over rows, not over 3 channels
    *past, samples = planes_of(reprojected)
    np.minimum(samples, np.float32(options.max_samples), out=samples)
    samples += weight
    share = weight / np.maximum(samples, np.float32(MIN_WEIGHT))
    rest = 1 - share
    for mean, sample in zip(past, planes_of(irradiance), strict=True):
        # mean + share (new - mean) cancels where a firefly meets a dark past; two products do not
        mean *= rest
        sample *= share
        mean += sample
    return cv2.merge([*past, samples])

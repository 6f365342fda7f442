"""Accumulation over time that neither smears fireflies nor forgets what a pixel is worth."""

from __future__ import annotations

import numpy as np

from stillray.models_spec.loader import Temporal


def sample_weight(
    luminance: np.ndarray, local: np.ndarray, exposure: float, options: Temporal
) -> np.ndarray:
    """What a new sample is worth, in (0, 1]: less, the further it stands above its surroundings.

    With ``s`` the local radiance, a sample of luminance ``L`` weighs
    ``1 / (1 + L / (outlier_ratio (s + s0)))``: its product with ``L`` stays bounded, so one
    firefly moves a mean by no more than a few ordinary samples, and the pixel's sample count says
    that little is known there.

    differs: Fan et al. 2021 average plainly (section 4.1), which smears fireflies over the frames
    that follow. The ratio trades that against lost energy: where most samples are black, a bright one
    is ordinary. Measured on the validation scenes with a 5x5 box as the filter, PSNR: 20.2 dB at
    ratio 4, 22.8 at 16, 23.5 at 64 (kept), 23.3 at 512, 23.2 without.

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
    typical = local / (1 - local) + np.float32(DARK)
    ratio = luminance * np.float32(exposure) / (np.float32(options.outlier_ratio) * typical)
    # a weight of exactly 0 would leave windows of fireflies empty
    return np.maximum(1 / (1 + ratio), np.float32(MIN_WEIGHT))


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
    result = np.empty((*irradiance.shape[:2], 4), np.float32)
    if reprojected is None:
        result[..., :3] = irradiance
        result[..., 3] = weight
        return result
    past = np.minimum(reprojected[..., 3], np.float32(options.max_samples))
    samples = past + weight
    share = weight / np.maximum(samples, np.float32(MIN_WEIGHT))
    # mean + share (new - mean) cancels where a firefly meets a dark past; two products do not
    result[..., :3] = irradiance * share[..., None]
    result[..., :3] += reprojected[..., :3] * (1 - share)[..., None]
    result[..., 3] = samples
    return result

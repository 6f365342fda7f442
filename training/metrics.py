"""Image metrics: exposure and tone mapping as the validation set states them, then the usual ones.

PSNR, SSIM and FLIP see tone-mapped images; SMAPE and relative MSE see exposed radiance.
"""

from __future__ import annotations

import numpy as np

from stillray.display import display_exposure, tone_map

SMAPE_EPSILON = 0.01  # exposed radiance (Fan et al. 2021, eq. 6)
RELATIVE_MSE_EPSILON = 0.01  # exposed radiance, squared units


def evaluate(image: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """All metrics of an image against its reference.

    Parameters
    ----------
    image, reference : (h, w, 3) float32
        Scene-linear radiance.

    Returns
    -------
    dict
        ``psnr`` in dB and ``ssim`` (higher is better), ``smape``, ``relmse`` and ``flip``
        (lower is better).
    """
    import flip_evaluator
    from skimage.metrics import peak_signal_noise_ratio, structural_similarity

    exposure = display_exposure(reference)
    shown, wanted = tone_map(image, exposure), tone_map(reference, exposure)
    a, b = image.astype(np.float64) * exposure, reference.astype(np.float64) * exposure
    _, flip, _ = flip_evaluator.evaluate(
        wanted.astype(np.float32),
        shown.astype(np.float32),
        "LDR",
        inputsRGB=True,
        applyMagma=False,
    )
    return {
        "psnr": float(peak_signal_noise_ratio(wanted, shown, data_range=1.0)),
        "ssim": float(structural_similarity(wanted, shown, channel_axis=-1, data_range=1.0)),
        "smape": float(np.mean(np.abs(a - b) / (np.abs(a) + np.abs(b) + SMAPE_EPSILON))),
        "relmse": float(np.mean((a - b) ** 2 / (b**2 + RELATIVE_MSE_EPSILON))),
        "flip": float(flip),
    }


def flicker(
    before: np.ndarray, image: np.ndarray, reference_before: np.ndarray, reference: np.ndarray
) -> float:
    """Mean absolute error of the tone-mapped difference between two consecutive frames.

    Parameters
    ----------
    before, image : (h, w, 3) float32
        Scene-linear radiance of the two frames.
    reference_before, reference : (h, w, 3) float32
        Their references; both pairs are exposed for ``reference``.

    Returns
    -------
    float
        In [0, 2]; 0 where the image changes exactly as it should.
    """
    exposure = display_exposure(reference)
    change = tone_map(image, exposure) - tone_map(before, exposure)
    wanted = tone_map(reference, exposure) - tone_map(reference_before, exposure)
    return float(np.mean(np.abs(change - wanted)))

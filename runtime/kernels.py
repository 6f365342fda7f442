"""Reconstruction with fused weight-sharing kernels (Fan et al. 2021, section 4.2).

Kernels are never built. Their softmax over a shared importance map (eq. 3, 4) is a ratio of two
box sums, ``sum(exp(I) r) / sum(exp(I))``, and a box sum is separable.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from stillray.models_spec.loader import FusedKernels, ModelSpec
from stillray.prepare import Prepared, timed
from stillray.strips import Strips, planes_of


def reconstruct(
    prepared: Prepared,
    previous: np.ndarray | None,
    outputs: Sequence[np.ndarray],
    spec: ModelSpec,
    strips: Strips,
    timings: dict[str, float],
) -> np.ndarray:
    """Filter and re-modulate a frame, see `stillray.families.Family`."""
    options = spec.decoder
    assert isinstance(options, FusedKernels)
    (logits,) = outputs
    mean = prepared.history.mean
    height, width = mean.shape[:2]
    image = np.empty((height, width, 3), np.float32)
    halo = reach(spec)

    def filter_strip(rows: slice) -> None:
        top, bottom = max(rows.start - halo, 0), min(rows.stop + halo, height)
        inner = slice(rows.start - top, rows.stop - top)
        image[rows] = filter_rows(mean[top:bottom], logits[:, top:bottom], inner, options)

    with timed(timings, "reconstruct"):
        strips.run(filter_strip, height, width)
    if prepared.divisor is not None:
        with timed(timings, "modulate"):
            cv2.multiply(image, prepared.divisor, dst=image)
    return image


def method(spec: ModelSpec) -> str:
    """What the reconstruction does, in a few words."""
    assert isinstance(spec.decoder, FusedKernels)
    return f"{len(spec.decoder.kernel_sizes)} fused kernels"


def reach(spec: ModelSpec) -> int:
    """Pixels that the largest kernel looks to each side."""
    assert isinstance(spec.decoder, FusedKernels)
    return max(spec.decoder.kernel_sizes) // 2


def filter_rows(
    mean: np.ndarray, logits: np.ndarray, inner: slice, options: FusedKernels
) -> np.ndarray:
    """Filter an image, or a strip of one with its neighbouring rows.

    Parameters
    ----------
    mean : (h, w, 4) float32
        Irradiance, which is filtered, >= 0 and finite; and the samples that each pixel holds,
        > 0, which multiply its importance when the spec says so.
    logits : (2 m, h, w) float32
        m importance maps and m fusion maps, as the network gives them; any values.
    inner
        The rows of the result; the others only lend their pixels.

    Returns
    -------
    (rows, w, 3) float32
        ``sum_i alpha_i R_i``, eq. 5: a convex combination of irradiance in each window. Windows
        end at the border of the image, as if zero importance lay outside.
    """
    count = len(options.kernel_sizes)
    *planes, samples = planes_of(mean)
    height, width = samples[inner].shape
    total = np.zeros((3, height, width), np.float32)
    alpha_sum = np.zeros((height, width), np.float32)
    scratch = np.empty_like(samples)
    for index, size in enumerate(options.kernel_sizes):
        importance = _bounded_exp(logits[index], options.logit_bound)
        if options.weigh_samples:
            importance *= samples
        # Normalised kernels keep sums of large radiance finite. sepFilter2D adds each window
        # anew: boxFilter's running sums keep a residue of every firefly that has passed, which
        # drowns darker windows (and it is no faster here).
        kernel = np.full(size, 1 / size, np.float32)
        share = _bounded_exp(logits[count + index, inner], options.logit_bound)
        alpha_sum += share
        share /= _box(importance, kernel)[inner]
        for plane, sums in zip(planes, total, strict=True):
            np.multiply(importance, plane, out=scratch)
            cv2.accumulateProduct(_box(scratch, kernel)[inner], share, sums)
    if np.isnan(alpha_sum.sum()) or np.isnan(total.sum()):  # a NaN logit says nothing: 0
        return filter_rows(mean, np.nan_to_num(logits, nan=0.0), inner, options)
    total /= alpha_sum
    return cv2.merge(list(total))


def _box(plane: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    return cv2.sepFilter2D(plane, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_CONSTANT)


def _bounded_exp(logits: np.ndarray, bound: float) -> np.ndarray:
    # bounded logits need no maximum subtracted: exp stays within e^-bound .. e^bound
    bounded = np.clip(logits, np.float32(-bound), np.float32(bound))
    return cv2.exp(bounded, dst=bounded)

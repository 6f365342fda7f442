"""Fused weight-sharing kernels as box filters (Fan et al. 2021, section 4.2).

Kernels are never built. Their softmax over a shared importance map (eq. 3, 4) is a ratio of two
box sums, ``sum(exp(I) r) / sum(exp(I))``, and a box sum is separable.
"""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

from stillray.arrays.strips import interleave, planes_of, with_halo
from stillray.arrays.workspace import Workspace
from stillray.families.depth_to_space import DepthToSpace
from stillray.model_spec.decoders import FusedKernels


def filter_rows(
    mean: np.ndarray,
    logits: np.ndarray | DepthToSpace,
    inner: slice,
    options: FusedKernels,
    out: np.ndarray | None = None,
    workspace: Workspace | None = None,
) -> np.ndarray:
    """Filter an image, or a strip of one with its neighbouring rows.

    Parameters
    ----------
    mean : (h, w, 4) float32
        Irradiance, which is filtered, >= 0 and finite; and the samples that each pixel holds,
        > 0, which multiply its importance when the spec says so.
    logits : (2 m, h, w) float32
        m importance maps and m fusion maps, as the network gives them; any values. Where there
        are fewer kernel sizes than m, the other maps are not looked at.
    inner
        The rows of the result; the others only lend their pixels.
    out : (rows, w, 3) float32, optional
        Written and returned.
    workspace
        Where temporaries lie, if given.

    Returns
    -------
    (rows, w, 3) float32
        ``sum_i alpha_i R_i``, eq. 5: a convex combination of irradiance in each window. Windows
        end at the border of the image, as if zero importance lay outside.
    """
    workspace = workspace or Workspace()
    if out is None:
        out = np.empty((inner.stop - inner.start, mean.shape[1], 3), np.float32)
    interleave(filter_planes(mean, logits, inner, options, workspace), out=out)
    if np.isnan(out.max()):  # a NaN logit says nothing: 0
        maps = logits[slice(0, len(logits)), slice(0, len(mean))]
        return filter_rows(mean, np.nan_to_num(maps, nan=0.0), inner, options, out, workspace)
    return out


def filter_planes(
    mean: np.ndarray,
    logits: np.ndarray | DepthToSpace,
    inner: slice,
    options: FusedKernels,
    workspace: Workspace,
) -> np.ndarray:
    """`filter_rows` as planes ``(3, rows, w)``, in the workspace; without a look for NaN logits.

    The last of an odd number of logits is not looked at.
    """
    # fewer kernels than maps: the first ones
    count, (height, width) = len(logits) // 2, mean.shape[:2]
    shape = inner.stop - inner.start, width
    *planes, samples = planes_of(mean, out=workspace.array("mean", (4, height, width)))
    total, alpha_sum = workspace.array("total", (3, *shape)), workspace.array("alpha_sum", shape)
    share = workspace.array("share", shape)
    total.fill(0)
    alpha_sum.fill(0)
    for index, size in enumerate(options.kernel_sizes):
        rows, own = with_halo(inner, size // 2, height)
        strip = rows.stop - rows.start, width
        importance, product, box = (
            workspace.array(name, strip) for name in ("importance", "product", "box")
        )
        bounded_exp(logits[index, rows], options.logit_bound, importance)
        if options.weigh_samples:
            importance *= samples[rows]
        bounded_exp(logits[count + index, inner], options.logit_bound, share)
        alpha_sum += share
        share /= box_means(importance, size, box)[own]
        for plane, sums in zip(planes, total, strict=True):
            np.multiply(importance, plane[rows], out=product)
            cv2.accumulateProduct(box_means(product, size, box)[own], share, sums)
    total /= alpha_sum
    return total


def box_means(plane: np.ndarray, size: int, out: np.ndarray) -> np.ndarray:
    """Means over windows of ``size`` x ``size``, zeros outside; written to ``out``, which returns.

    Means and not sums, so that those of large radiance stay finite. Each window is added anew:
    running sums, as ``cv2.boxFilter`` has them, keep a residue of every firefly that has passed,
    which drowns darker windows (and are no faster here).
    """
    kernel = _mean_kernel(size)
    border = cv2.BORDER_CONSTANT
    return cv2.sepFilter2D(plane, cv2.CV_32F, kernel, kernel, dst=out, borderType=border)


@cache
def _mean_kernel(size: int) -> np.ndarray:
    return np.full(size, 1 / size, np.float32)


def bounded_exp(logits: np.ndarray, bound: float, out: np.ndarray) -> None:
    """``exp`` of logits clipped to ``bound``.

    Bounded logits need no maximum subtracted: ``exp`` stays within e^-bound .. e^bound.

    Parameters
    ----------
    logits : (h, w) float32
        Any values; a NaN gives NaN.
    bound
        The largest magnitude of a logit.
    out : (h, w) float32
        Written.
    """
    # finding the largest takes a third of the time of clipping; NaN is not within the bound
    if not cv2.norm(logits, cv2.NORM_INF) <= bound:
        logits = np.clip(logits, np.float32(-bound), np.float32(bound), out=out)
    cv2.exp(logits, dst=out)

"""Reconstruction with shared-weight kernels at several resolutions.

differs: Fan et al. 2021, section 5.2, blend a U-Net's resolutions by eq. 7. Here the weights of a
coarser level come from the finer one, the blend is one softmax over what a pixel can take (itself,
its kernels, the coarser level), and the re-modulated result is resolved with its neighbours and
the previous output, which smooths edges as supersampling would and holds the picture still. Every
step is a convex combination: no light is invented.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from stillray.models_spec.loader import ModelSpec, PyramidKernels, PyramidNetwork
from stillray.prepare import Prepared
from stillray.strips import Strips, planes_of
from stillray.timing import timed

#: Neighbours of the resolve in the order of their logits: (rows down, columns right).
NEIGHBOURS = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))


@dataclass(frozen=True)
class LevelLayout:
    """Where the logits of one level lie in its planes.

    Attributes
    ----------
    importance
        One map a kernel.
    pool
        Weights for the next coarser level; empty at the coarsest.
    blend
        What a pixel takes: at the coarsest level its kernels, against itself at logit 0; elsewhere
        itself and its kernels, against the coarser level at logit 0.
    resolve
        At the finest level the eight `NEIGHBOURS` and the previous output, against the pixel
        itself at logit 0; empty elsewhere.
    """

    importance: slice
    pool: slice
    blend: slice
    resolve: slice


def level_layout(level: int, levels: int, options: PyramidKernels) -> LevelLayout:
    """The layout of a level, 0 being the finest."""
    kernels = len(options.kernel_sizes)
    coarsest = level == levels - 1
    counts = (
        kernels,
        0 if coarsest else 1,
        kernels if coarsest else kernels + 1,
        len(NEIGHBOURS) + 1 if level == 0 else 0,
    )
    starts = [sum(counts[:index]) for index in range(5)]
    return LevelLayout(*(slice(a, b) for a, b in pairwise(starts)))


def level_logits(level: int, levels: int, options: PyramidKernels) -> int:
    """Planes that the network gives at a level, 0 being the finest."""
    return level_layout(level, levels, options).resolve.stop


def multiple(spec: ModelSpec) -> int:
    """Height and width of the network's input must be multiples of this, pixels."""
    assert isinstance(spec.network, PyramidNetwork)
    return 1 << (len(spec.network.widths) - 1)


def reach(spec: ModelSpec) -> int:
    """Pixels from which light can come to a pixel, to each side."""
    assert isinstance(spec.decoder, PyramidKernels)
    coarsest = multiple(spec)
    # a bilinear step looks into the neighbouring cell: 1.5 cells of every level above the finest,
    # 1.5 (2 + 4 + ... + coarsest); then the largest kernel of the coarsest, and the resolve
    return 3 * (coarsest - 1) + max(spec.decoder.kernel_sizes) // 2 * coarsest + 1


def method(spec: ModelSpec) -> str:
    """What the reconstruction does, in a few words."""
    assert isinstance(spec.network, PyramidNetwork)
    return f"kernels at {len(spec.network.widths)} resolutions, resolved with the last output"


def reconstruct(
    prepared: Prepared,
    previous: np.ndarray | None,
    outputs: Sequence[np.ndarray],
    spec: ModelSpec,
    strips: Strips,
    timings: dict[str, float],
) -> np.ndarray:
    """Filter, re-modulate and resolve a frame, see `stillray.families.Family`."""
    assert isinstance(spec.decoder, PyramidKernels)
    with timed(timings, "reconstruct"):
        return filter_pyramid(
            prepared.history.mean, prepared.divisor, previous, outputs, spec.decoder, strips
        )


def filter_pyramid(
    mean: np.ndarray,
    divisor: np.ndarray | None,
    previous: np.ndarray | None,
    logits: Sequence[np.ndarray],
    options: PyramidKernels,
    strips: Strips,
) -> np.ndarray:
    """Filter, re-modulate and resolve a frame.

    Parameters
    ----------
    mean : (h, w, 4) float32
        Irradiance, >= 0 and finite; and the samples that each pixel holds, > 0.
    divisor : (h, w, 3) float32 or None
        What radiance was divided by.
    previous : (h, w, 4) float32 or None
        Radiance of the previous output at these pixels, and how much of it is valid, [0, 1].
    logits
        One ``(planes, H, W)`` map a level, finest first, of the frame's size rounded up to
        `multiple`; any values. The frame's last row and column are repeated to that size.
    options
        Kernel sizes and the bound of the logits.
    strips
        Where the work runs.

    Returns
    -------
    (h, w, 3) float32
        Radiance: for every pixel a convex combination of accumulated irradiance around it, times
        the divisors of its 3x3 neighbours, and of the previous output.
    """
    if any(np.isnan(level.sum()) for level in logits):  # a NaN logit says nothing: 0
        logits = [np.nan_to_num(level, nan=0.0) for level in logits]
    height, width = mean.shape[:2]
    levels = len(logits)
    bottom, right = (
        full - size for full, size in zip(logits[0].shape[1:], mean.shape, strict=False)
    )
    if bottom or right:
        mean = cv2.copyMakeBorder(mean, 0, bottom, 0, right, cv2.BORDER_REPLICATE)
    *light, held = planes_of(mean)
    pyramid = [(light, held)]
    for level in range(levels - 1):
        pool = logits[level][level_layout(level, levels, options).pool][0]
        pyramid.append(_pool(*pyramid[-1], pool, options, strips))
    coarser: list[np.ndarray] | None = None
    for level in reversed(range(1, levels)):
        light, held = pyramid[level]
        layout = level_layout(level, levels, options)
        result = [np.empty_like(held) for _ in light]

        def blend(
            rows: slice,
            level: int = level,
            layout: LevelLayout = layout,
            coarser: list[np.ndarray] | None = coarser,
            result: list[np.ndarray] = result,
        ) -> None:
            planes = _blend(rows, *pyramid[level], coarser, logits[level], layout, options)
            for target, plane in zip(result, planes, strict=True):
                target[rows] = plane

        strips.run(blend, *held.shape)
        coarser = _double(result)
    image = np.empty((height, width, 3), np.float32)
    finest = level_layout(0, levels, options)

    def finish(rows: slice) -> None:
        # the resolve looks one row up and down
        around = slice(max(rows.start - 1, 0), min(rows.stop + 1, height))
        planes = _blend(around, *pyramid[0], coarser, logits[0], finest, options)
        if divisor is not None:
            for channel, plane in enumerate(planes):
                plane[:, :width] *= divisor[around, :, channel]
        image[rows] = _resolve(
            [plane[:, :width] for plane in planes],
            rows,
            around,
            logits[0][finest.resolve, rows, :width],
            None if previous is None else previous[rows],
            options,
        )

    strips.run(finish, height, width)
    return image


def _pool(
    light: list[np.ndarray],
    held: np.ndarray,
    pool: np.ndarray,
    options: PyramidKernels,
    strips: Strips,
) -> tuple[list[np.ndarray], np.ndarray]:
    """Light and samples of the next coarser level: weighted means of 2x2 blocks."""
    height, width = (size // 2 for size in held.shape)
    coarse = [np.empty((height, width), np.float32) for _ in light]
    samples = np.empty((height, width), np.float32)

    def work(rows: slice) -> None:
        fine = slice(2 * rows.start, 2 * rows.stop)
        importance = _bounded_exp(pool[fine], options)
        total = _halve(importance)
        importance *= held[fine]
        weight = _halve(importance)
        inverse = 1 / weight
        for plane, target in zip(light, coarse, strict=True):
            np.multiply(_halve(importance * plane[fine]), inverse, out=target[rows])
        np.divide(weight, total, out=samples[rows])

    strips.run(work, height, width)
    return coarse, samples


def _blend(
    rows: slice,
    light: list[np.ndarray],
    held: np.ndarray,
    coarser: list[np.ndarray] | None,
    logits: np.ndarray,
    layout: LevelLayout,
    options: PyramidKernels,
) -> list[np.ndarray]:
    """Rows of a level: itself, its kernels and the coarser level, by their shares."""
    halo = max(options.kernel_sizes) // 2
    outer = slice(max(rows.start - halo, 0), min(rows.stop + halo, held.shape[0]))
    inner = slice(rows.start - outer.start, rows.stop - outer.start)
    shares = _bounded_exp(logits[layout.blend, rows], options)
    others = list(shares)
    if coarser is None:  # itself at logit 0, then the kernels
        total = [plane[rows].copy() for plane in light]
    else:  # the coarser level at logit 0, then itself, then the kernels
        total = [plane[rows].copy() for plane in coarser]
        own = others.pop(0)
        for plane, sums in zip(light, total, strict=True):
            cv2.accumulateProduct(plane[rows], own, sums)
    normal = shares.sum(axis=0)
    normal += 1
    for size, share, maps in zip(
        options.kernel_sizes, others, logits[layout.importance, outer], strict=True
    ):
        weight = _bounded_exp(maps, options)
        weight *= held[outer]
        share /= _box(weight, size)[inner]
        for plane, sums in zip(light, total, strict=True):
            cv2.accumulateProduct(_box(weight * plane[outer], size)[inner], share, sums)
    for sums in total:
        sums /= normal
    return total


def _resolve(
    planes: list[np.ndarray],
    rows: slice,
    around: slice,
    logits: np.ndarray,
    previous: np.ndarray | None,
    options: PyramidKernels,
) -> np.ndarray:
    """Average pixels with their neighbours and the previous output."""
    weights = _bounded_exp(logits, options)
    count, width = rows.stop - rows.start, planes[0].shape[1]
    above, below = 1 - (rows.start - around.start), 1 - (around.stop - rows.stop)
    normal = weights[:-1].sum(axis=0)
    normal += 1
    if previous is not None:
        weights[-1] *= previous[..., 3]
        normal += weights[-1]
    resolved = []
    for channel, plane in enumerate(planes):
        padded = cv2.copyMakeBorder(plane, above, below, 1, 1, cv2.BORDER_REPLICATE)
        total = padded[1 : 1 + count, 1 : 1 + width].copy()
        for weight, (down, right) in zip(weights, NEIGHBOURS, strict=False):
            moved = padded[1 + down : 1 + down + count, 1 + right : 1 + right + width]
            cv2.accumulateProduct(moved, weight, total)
        if previous is not None:
            cv2.accumulateProduct(np.ascontiguousarray(previous[..., channel]), weights[-1], total)
        total /= normal
        resolved.append(total)
    return cv2.merge(resolved)


def _box(plane: np.ndarray, size: int) -> np.ndarray:
    # normalised, so that sums of large radiance stay finite; no running sums, see kernels.py
    kernel = np.full(size, 1 / size, np.float32)
    return cv2.sepFilter2D(plane, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_CONSTANT)


def _halve(plane: np.ndarray) -> np.ndarray:
    """Means of 2x2 blocks."""
    height, width = plane.shape
    return cv2.resize(plane, (width // 2, height // 2), interpolation=cv2.INTER_AREA)


def _double(planes: list[np.ndarray]) -> list[np.ndarray]:
    """Twice the size, bilinear between pixel centres."""
    height, width = planes[0].shape
    return [
        cv2.resize(plane, (2 * width, 2 * height), interpolation=cv2.INTER_LINEAR)
        for plane in planes
    ]


def _bounded_exp(logits: np.ndarray, options: PyramidKernels) -> np.ndarray:
    bound = np.float32(options.logit_bound)
    bounded = np.clip(logits, -bound, bound)
    return np.exp(bounded, out=bounded)

"""What a pixel costs at least: operations and bytes of the methods that families share.

Counts are of the method, not of its code: each plane that is needed is read or written once, and a
window's sum is two additions an axis however large the window is.
"""

from __future__ import annotations

from stillray.families.pyramid_logits import level_layout, level_logits
from stillray.model_spec.loader import PyramidKernels

WINDOW_SUM = 4  # operations: one value comes in and one goes out, along each axis
EXP = 1  # operations of an exponential, a root or a logarithm: instructions of their own in time


def fused_kernels_cost(kernels: int) -> tuple[float, float]:
    """Operations and planes moved, a pixel, with so many fused kernels."""
    # two exponentials, importance, sums of it and of three channels, the share, three additions
    one = 2 * EXP + 1 + 3 + 4 * WINDOW_SUM + 1 + 3 * 2 + 1
    return kernels * one + 3, 2 * kernels + 4 + 3


def kernel_pyramid_cost(levels: int, options: PyramidKernels) -> tuple[float, float]:
    """The same of a kernel pyramid."""
    operations, planes = 0.0, 3.0 + 3.0 + 4.0  # albedo, image, the previous output
    for level in range(levels):
        share = 0.25**level
        logits = level_logits(level, levels, options)
        maps = len(options.kernel_sizes) if level or options.finest_kernels else 0
        # kernels as above; itself and the coarser level; what is pooled; four pixels for one, with
        # their shares and of each channel three products
        kernels = maps * (1 + 3 + 4 * WINDOW_SUM + 1 + 3 * 2 + 1)
        doubled = 4 * (6 + 3 * 5) if level else 0
        neighbours = 8 * (1 + 3 * 2) * len(level_layout(level, levels, options).distances)
        operations += share * (logits * EXP + kernels + 3 * 4 + 4 * 2 + doubled + neighbours)
        planes += share * (logits + 4 + 4)  # light read and the level's result written
    for _ in options.finest_filters:  # a distance serves both of its pixels
        operations += 4 * (3 * options.filter_features + EXP) + 8 * (2 + 3 * 2) + 3
        planes += 3 + options.filter_features + 2 + 3
    resolve = 9 * (1 + 3 * 2) + 3 + 3  # eight neighbours and the past; normalised, modulated
    return operations + resolve, planes


def multi_resolution_cost(levels: int, kernels: int) -> tuple[float, float]:
    """The same of fused kernels at several resolutions."""
    operations, planes = 0.0, 0.0
    filtered, moved = fused_kernels_cost(kernels)
    for level in range(levels):
        share = 0.25**level
        operations += share * filtered
        planes += share * moved
        if level < levels - 1:
            # weighted means for the coarser level; the share that gives way, and of each channel
            # a block's mean, least and most, the step to the coarser level and two limits
            operations += share * (3 + 4 + EXP + 2 + 3 * (3 + 2 + 2))
            planes += share * (1 + 3 / 4)
    return operations, planes

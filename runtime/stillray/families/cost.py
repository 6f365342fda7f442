"""What a pixel costs at least: operations and bytes of the methods that families share.

Counts are of the method, not of its code: each plane that is needed is read or written once, and a
window's sum is two additions an axis however large the window is.
"""

from __future__ import annotations

from stillray.families.pyramid_logits import level_layout, level_logits
from stillray.model_spec.decoders import FeatureFilters, PyramidKernels

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
    for _ in options.finest_filters:
        filtered, moved = gaussian_cost(3, options.filter_features)
        operations += filtered
        planes += moved + 1  # a filter has a weight of the pixel itself, too
    if options.filter_tone:  # a share by luminance, then two products with it a filter
        operations += 3 * 2 + 2 + EXP + 2 * len(options.finest_filters)
        planes += 1
    # eight weights squared, three channels
    operations += len(options.albedo_filters) * (8 * (EXP + 2 + 3 * 2) + 3)
    planes += len(options.albedo_filters) * (8 + 3 + 3)
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


def gaussian_cost(channels: int, features: int) -> tuple[float, float]:
    """The same of one 3x3 filter by distances of features."""
    # a distance serves both of its pixels
    operations = 4 * (3 * features + EXP) + 8 * (2 + channels * 2) + channels
    return operations, channels + features + 1 + channels


def feature_filters_cost(levels: int, options: FeatureFilters) -> tuple[float, float]:
    """The same of a pyramid of such filters, after a frame was enlarged and accumulated by two.

    Light is filtered over both albedos and as it is: nine planes.
    """
    operations, planes = 0.0, 0.0
    for channels in (3, 6):
        filtered, moved = gaussian_cost(channels, options.features)
        # what the past weighs, its samples, and of each channel two products and a share
        kept = channels // 3 * (EXP + 6 + 3 * 4)
        operations += filtered + EXP + kept
        planes += moved + channels // 3 * (1 + 4 + 4)
    for level in range(levels):
        share = 0.25**level
        filtered, moved = gaussian_cost(9, options.features)
        # taken over and mixed with the next level
        passes = len(options.coarsest_filters) if level == levels - 1 else 1
        operations += share * (
            passes * (filtered + EXP) + (2 * EXP + 9 * 3 if level < levels - 1 else 0)
        )
        planes += share * (passes * moved + (1 if level < levels - 1 else 0))
    # light over two albedos; shares of the coarser levels, each a weighted mean of four pixels
    operations += 2 * 3 * 3 + levels * EXP + (levels - 1) * 9 * 3
    planes += 8 + levels - 1 + (levels - 1) * 10 / 4
    # times two albedos, composed of four, mixed with the last output
    operations += 2 * 3 * 2 + 4 * (EXP + 2 * 3) + 2 * EXP + 3 * 3
    planes += 9 + 8 + 4 + 3 + 4 + 3
    return operations, planes


def cross_bilateral_cost(neighbours: int) -> tuple[float, float]:
    """The same of a cross-bilateral filter of two estimates by two guides, blended with a past."""
    # four differences of three channels, squared and added, once for two neighbours; their bands
    # and the place's; two weights, and the light of two estimates
    each = 4 * (3 * 2 + 2) / 2 + 4 + 4 + 2 * (EXP + 1 + 3 * 2)
    return (neighbours - 1) * each + 5 * 3 + 2 * 3 * 2 + EXP + 3 * 2, 4 * 3 + 6 + 3 + 1 + 3


def cross_regression_cost(lines: int, variables: int, guides: int) -> tuple[float, float]:
    """The same of lines fitted to both halves, so many of which speak of a pixel."""
    # how far guides are apart serves both halves
    alike = 3 * guides
    # weights by color, three variables of it; normal equations of three channels; what lines say
    products = 2 * variables * (variables + 3)
    each = 3 * 3 + 4 + EXP + 2 + 3 * 2 + products + 2 * 3 * variables + 2 * 4
    return lines * (alike + 2 * each) + 2 * (9 * 2 + 3 * 4), 2 * 3 + guides + 2 * 3

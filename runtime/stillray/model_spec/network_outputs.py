"""What a network must give for its decoder: planes and resolution of every output."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from stillray.model_spec.decoders import (
    BilateralGrids,
    CrossBilateral,
    FeatureFilters,
    FusedKernels,
    PyramidKernels,
)
from stillray.model_spec.loader import ModelSpec
from stillray.model_spec.network_weights import PARAMETERS
from stillray.model_spec.networks import (
    BranchNetwork,
    FilterNetwork,
    GuideNetwork,
    ImportanceNetwork,
    PyramidNetwork,
)

_NEIGHBOURS = 8


#: Planes and reduction of each output, finest first.
Outputs = list[tuple[int, int]]


def network_outputs(spec: ModelSpec) -> Outputs:
    """``(planes, reduction)`` of each output, finest first.

    An output has the frame's height and width, rounded up, over its reduction.
    """
    return _OUTPUTS[spec.family](spec.network, spec.decoder)


def _cross_regression(network: FilterNetwork, decoder: CrossBilateral) -> Outputs:
    return [(PARAMETERS, 1)]


def _bilateral_grids(network: GuideNetwork, decoder: BilateralGrids) -> Outputs:
    return [(2 * decoder.grids - 1, 1)]


def _weight_sharing_kernels(network: ImportanceNetwork, decoder: FusedKernels) -> Outputs:
    return [(2 * len(decoder.kernel_sizes) * network.block**2, network.block)]


def _multi_resolution_kernels(network: PyramidNetwork, decoder: FusedKernels) -> Outputs:
    """As `stillray.families.multi_resolution` lays them out."""
    levels, kernels = network.resolutions, len(decoder.kernel_sizes)
    return [(2 * kernels + (level < levels - 1), 2**level) for level in range(levels)]


def _kernel_pyramid(network: PyramidNetwork, decoder: PyramidKernels) -> Outputs:
    levels = network.resolutions
    counts = [_pyramid_planes(decoder, level, levels) for level in range(levels)]
    reductions = [2**level for level in range(levels)]
    if network.block > 1:  # the finest logits come by blocks of pixels
        counts[0] *= network.block**2
        reductions[0] = network.block
    return list(zip(counts, reductions, strict=True))


def _pyramid_planes(decoder: PyramidKernels, level: int, levels: int) -> int:
    """As `stillray.families.pyramid_logits` lays them out."""
    kernels, coarsest = len(decoder.kernel_sizes), level == levels - 1
    if level == 0 and not decoder.finest_kernels:
        kernels = 0
    planes = 2 * kernels + (0 if coarsest else 2)  # importance, blend; pool and blend's own
    if level == 0:
        planes += decoder.filter_features + 2 * len(decoder.finest_filters)
        # the previous output, this frame's sample
        return planes + _NEIGHBOURS * (1 + len(decoder.finest_neighbours)) + 2
    return planes + 8 + (_NEIGHBOURS if decoder.predicted else 0)  # doubling, neighbours


def _feature_filters(network: BranchNetwork, decoder: FeatureFilters) -> Outputs:
    """As `stillray.families.filter_layout` lays them out."""
    levels = network.resolutions
    one = decoder.features + 1  # a filter compares features, and weighs pixels by one more
    # two filters that enlarge, three accumulations, shares of levels, the filter and how much it
    # takes of the next level, three light planes against the frame's own light, the last output
    finest = 3 * one + 3 + (levels - 1) + 1 + 3 + 1
    coarser = [(one + (level < levels - 1), 2**level) for level in range(1, levels)]
    return [(4 * finest, 2), *coarser]  # the finest come by blocks of pixels


_OUTPUTS: dict[str, Callable[[Any, Any], Outputs]] = {
    "weight-sharing-kernels": _weight_sharing_kernels,
    "kernel-pyramid": _kernel_pyramid,
    "multi-resolution-kernels": _multi_resolution_kernels,
    "bilateral-grids": _bilateral_grids,
    "cross-regression": _cross_regression,
    "feature-filters": _feature_filters,
}

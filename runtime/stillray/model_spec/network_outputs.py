"""What a network must give for its decoder: planes and resolution of every output."""

from __future__ import annotations

from stillray.model_spec.loader import (
    BilateralGrids,
    BranchNetwork,
    CrossBilateral,
    FeatureFilters,
    FusedKernels,
    ImportanceNetwork,
    ModelSpec,
    PyramidKernels,
    PyramidNetwork,
)
from stillray.model_spec.network_weights import PARAMETERS

_NEIGHBOURS = 8


def network_outputs(spec: ModelSpec) -> list[tuple[int, int]]:
    """``(planes, reduction)`` of each output, finest first.

    An output has the frame's height and width, rounded up, over its reduction.
    """
    network, decoder = spec.network, spec.decoder
    if isinstance(decoder, CrossBilateral):
        return [(PARAMETERS, 1)]
    if isinstance(decoder, BilateralGrids):
        return [(2 * decoder.grids - 1, 1)]
    if isinstance(network, BranchNetwork):
        assert isinstance(decoder, FeatureFilters)
        return _feature_outputs(network.resolutions, decoder)
    if isinstance(network, ImportanceNetwork):
        assert isinstance(decoder, FusedKernels)
        return [(2 * len(decoder.kernel_sizes) * network.block**2, network.block)]
    assert isinstance(network, PyramidNetwork)
    assert not isinstance(decoder, FeatureFilters)
    levels = network.resolutions
    counts = [_planes(decoder, level, levels) for level in range(levels)]
    reductions = [2**level for level in range(levels)]
    if network.block > 1:  # the finest logits come by blocks of pixels
        counts[0] *= network.block**2
        reductions[0] = network.block
    return list(zip(counts, reductions, strict=True))


def _feature_outputs(levels: int, decoder: FeatureFilters) -> list[tuple[int, int]]:
    """As `stillray.families.filter_layout` lays them out."""
    one = decoder.features + 1  # a filter compares features, and weighs pixels by one more
    # two filters that enlarge, three accumulations, shares of levels, the filter and how much it
    # takes of the next level, three light planes against the frame's own light, the last output
    finest = 3 * one + 3 + (levels - 1) + 1 + 3 + 1
    coarser = [(one + (level < levels - 1), 2**level) for level in range(1, levels)]
    return [(4 * finest, 2), *coarser]  # the finest come by blocks of pixels


def _planes(decoder: FusedKernels | PyramidKernels, level: int, levels: int) -> int:
    """As `stillray.families` lays them out: `pyramid_logits`, `multi_resolution`."""
    kernels, coarsest = len(decoder.kernel_sizes), level == levels - 1
    if isinstance(decoder, FusedKernels):
        return 2 * kernels + (not coarsest)
    if level == 0 and not decoder.finest_kernels:
        kernels = 0
    planes = 2 * kernels + (0 if coarsest else 2)  # importance, blend; pool and blend's own
    if level == 0:
        # the previous output, this frame's sample
        return planes + _NEIGHBOURS * (1 + len(decoder.finest_neighbours)) + 2
    return planes + 8 + (_NEIGHBOURS if decoder.predicted else 0)  # doubling, neighbours

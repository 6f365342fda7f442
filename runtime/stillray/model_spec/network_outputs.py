"""What a network must give for its decoder: planes and resolution of every output."""

from __future__ import annotations

from stillray.model_spec.loader import (
    BilateralGrids,
    CrossBilateral,
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
    if isinstance(network, ImportanceNetwork):
        assert isinstance(decoder, FusedKernels)
        return [(2 * len(decoder.kernel_sizes) * network.block**2, network.block)]
    assert isinstance(network, PyramidNetwork)
    levels = network.resolutions
    counts = [_planes(decoder, level, levels) for level in range(levels)]
    reductions = [2**level for level in range(levels)]
    if network.block > 1:  # the finest logits come by blocks of pixels
        counts[0] *= network.block**2
        reductions[0] = network.block
    return list(zip(counts, reductions, strict=True))


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

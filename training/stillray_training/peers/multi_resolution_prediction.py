"""Kernel prediction at several resolutions, the learned peer "MR-KP" of Fan et al. 2021, 6.1.

The U-Net of the multi-resolution model (section 5.2) gives every pixel of each level its own 5x5
kernel in the place of two shared-weight ones; levels are blended by eq. 7 as ours are. Input,
accumulation, demodulation and loss are the same, so that the two differ in nothing but the kernels.

differs: the paper's peer is the program of Meng et al. 2020, whose network is "similar".

`FAMILY` takes the specification of a multi-resolution model with one kernel size and trains it in
this way instead. It is not among the families that specifications name: no user's model is one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from torch import Tensor, nn

from stillray.arrays.workspace import Workspace
from stillray.families import multi_resolution as multires
from stillray.model_spec import ModelSpec
from stillray.model_spec.decoders import FusedKernels
from stillray.model_spec.networks import PyramidNetwork
from stillray_training.decoders.multires import filtered_resolutions
from stillray_training.families import BoxFilter, Family
from stillray_training.networks.pyramid import PyramidNet
from stillray_training.peers.kernel_prediction import filter_planes, kernels_of, predicted_kernels


def multi_resolution_predicted_kernels(
    irradiance_nchw: Tensor, samples_nchw: Tensor, logits: Sequence[Tensor], options: FusedKernels
) -> Tensor:
    """Filter every level with its pixels' own kernels; blend from the coarsest to the finest.

    Parameters
    ----------
    irradiance_nchw : (n, 3, h, w)
        Sizes that are multiples of 2^(levels - 1).
    samples_nchw : (n, 1, h, w)
        Samples that each pixel holds, > 0.
    logits
        One map a level, finest first: a kernel, row by row from the top left of its window, then,
        but at the coarsest, the blend with the coarser level.
    options
        With one kernel size.

    Returns
    -------
    (n, 3, h, w)
        Differentiable in all arguments.
    """
    kernels = kernels_of(options)

    def level_filter(light: Tensor, held: Tensor, maps: Tensor) -> Tensor:
        return predicted_kernels(light, held, maps, kernels)

    return filtered_resolutions(irradiance_nchw, samples_nchw, logits, options, level_filter)


def _filter_level(
    mean: np.ndarray, logits: np.ndarray, inner: slice, options: FusedKernels, workspace: Workspace
) -> np.ndarray:
    return filter_planes(mean, logits, inner, kernels_of(options), workspace)


class MultiResolutionPredictedModel(multires.MultiResolutionModel):
    """The peer as `stillray.Denoiser` runs it; logits as a multi-resolution model's."""

    level_filter = staticmethod(_filter_level)


def _network(spec: ModelSpec) -> nn.Module:
    network, decoder = spec.network, spec.decoder
    assert isinstance(network, PyramidNetwork)
    assert isinstance(decoder, FusedKernels)
    weights, coarser = kernels_of(decoder).kernel_size ** 2, network.resolutions - 1
    return PyramidNet(network, [weights + 1] * coarser + [weights])


def _decode(
    logits: tuple[Tensor, ...], batch: Mapping[str, Tensor], spec: ModelSpec, box: BoxFilter
) -> Tensor:
    assert isinstance(spec.decoder, FusedKernels)
    return multi_resolution_predicted_kernels(
        batch["irradiance"], batch["samples"], logits, spec.decoder
    )


#: For training, as `stillray_training.families.FAMILIES` has them.
FAMILY = Family(_network, _decode, inputs=("irradiance", "samples"), modulates=False)

"""Direct kernel prediction with the fusion of Fan et al. 2021: "KP-fusion", supplement, table 5.

Every pixel has kernels of its own at several sizes and a share for each, where `kernel_prediction`
has one kernel and our own models kernels that neighbours share.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor, nn

from stillray.arrays.strips import interleave
from stillray.arrays.workspace import Workspace
from stillray.families.box_filter import bounded_exp
from stillray.families.temporal_kernels import Looks
from stillray.model_spec import ModelSpec
from stillray.model_spec.decoders import FusedKernels
from stillray_training.families import BoxFilter, Family
from stillray_training.peers.kernel_prediction import (
    KernelPredictionNet,
    KernelsOfPixels,
    PredictedKernels,
    filter_planes,
    kernels_of,
    options_of,
    predicted_kernels,
)


def planes_of_sizes(decoder: FusedKernels) -> list[int]:
    """Logits of each size's kernel, a plane a weight; those of the shares come after them."""
    return [size**2 for size in decoder.kernel_sizes]


def fused_predictions(
    irradiance_nchw: Tensor, samples_nchw: Tensor, logits_nchw: Tensor, decoder: FusedKernels
) -> Tensor:
    """Filter with each size's own kernel, and average by the shares (eq. 5).

    Parameters
    ----------
    irradiance_nchw : (n, 3, h, w)
    samples_nchw : (n, 1, h, w)
        Samples that each pixel holds, > 0.
    logits_nchw : (n, planes, h, w)
        The kernels, see `planes_of_sizes`, each row by row; then a share for each.
    decoder
        The sizes.

    Returns
    -------
    (n, 3, h, w)
        Differentiable in all arguments.
    """
    count, bound = len(decoder.kernel_sizes), decoder.logit_bound
    *kernels, fusion = logits_nchw.split([*planes_of_sizes(decoder), count], 1)
    shares = fusion.clamp(-bound, bound).softmax(1)
    total = torch.zeros_like(irradiance_nchw)
    for index, (options, logits) in enumerate(zip(_each(decoder), kernels, strict=True)):
        image = predicted_kernels(irradiance_nchw, samples_nchw, logits, options)
        total = total + shares[:, index : index + 1] * image
    return total


def filter_rows(
    mean: np.ndarray,
    logits: np.ndarray,
    inner: slice,
    decoder: FusedKernels,
    workspace: Workspace | None = None,
) -> np.ndarray:
    """The twin of `fused_predictions` without PyTorch.

    Parameters
    ----------
    mean : (h, w, 4) float32
        Irradiance, >= 0 and finite, and samples, > 0: an image, or a strip with its neighbouring
        rows, half of the largest kernel where the image goes on.
    logits : (planes, h, w) float32
        As there; NaN says nothing.
    inner
        The rows of the result.
    decoder
        The sizes.
    workspace
        Where temporaries lie, if given.

    Returns
    -------
    (rows, w, 3) float32
    """
    workspace = workspace or Workspace()
    if np.isnan(logits.max()):
        logits = np.nan_to_num(logits, nan=0.0)
    shape = inner.stop - inner.start, mean.shape[1]
    image, shares = np.zeros((3, *shape), np.float32), np.zeros(shape, np.float32)
    share, first = np.empty(shape, np.float32), 0
    fusion = logits[sum(planes_of_sizes(decoder)) :]
    for options, plane in zip(_each(decoder), fusion, strict=True):
        size = options.kernel_size**2
        bounded_exp(plane[inner], decoder.logit_bound, share)
        own = filter_planes(mean, logits[first : first + size], inner, options, workspace)
        image += own * share
        shares += share
        first += size
    image /= shares
    return interleave(image, out=np.empty((*shape, 3), np.float32))


def _each(decoder: FusedKernels) -> list[PredictedKernels]:
    return [kernels_of(decoder.with_kernels((size,))) for size in decoder.kernel_sizes]


class FusedPredictionModel(KernelsOfPixels):
    """The peer with several kernels a pixel."""

    def __init__(self, spec: ModelSpec) -> None:
        assert isinstance(spec.decoder, FusedKernels)
        self._decoder = spec.decoder
        weights = sum(planes_of_sizes(spec.decoder))
        self.method = f"{len(spec.decoder.kernel_sizes)} kernels a pixel"
        # as `PredictedKernelsModel` for each, and a share
        self.cost = (weights * (1.0 + 2 + 1 + 3 * 2) + 3, weights + 4.0 + 3.0)
        reach = max(spec.decoder.kernel_sizes) // 2
        super().__init__(spec, Looks(reach=reach, receptive_field=None))

    def filter(
        self, mean: np.ndarray, logits: np.ndarray, inner: slice, workspace: Workspace
    ) -> np.ndarray:
        """See `KernelsOfPixels`."""
        return filter_rows(mean, logits, inner, self._decoder, workspace)


def _network(spec: ModelSpec) -> nn.Module:
    assert isinstance(spec.decoder, FusedKernels)
    outputs = sum(planes_of_sizes(spec.decoder)) + len(spec.decoder.kernel_sizes)
    chain = options_of(spec, spec.decoder.kernel_sizes[0])
    return KernelPredictionNet(len(spec.network.features), chain, outputs)


def _decode(logits: Tensor, batch: Mapping[str, Tensor], spec: ModelSpec, box: BoxFilter) -> Tensor:
    assert isinstance(spec.decoder, FusedKernels)
    return fused_predictions(batch["irradiance"], batch["samples"], logits, spec.decoder)


#: For training, as `stillray_training.families.FAMILIES` has them.
FAMILY = Family(_network, _decode, inputs=("irradiance", "samples"), modulates=False)

"""What differs between families of models in training: the network and the reconstruction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from torch import Tensor, nn

from stillray.models_spec import ModelSpec
from stillray.models_spec.loader import FusedKernels, PyramidKernels
from stillray.training.decoders.fused_kernels import fused_kernels
from stillray.training.decoders.pyramid import kernel_pyramid, resolve
from stillray.training.networks.importance import ImportanceNet
from stillray.training.networks.pyramid import PyramidNet


@dataclass(frozen=True)
class Family:
    """One family of models.

    Attributes
    ----------
    network
        Makes the network of a specification.
    reconstruct
        From what the network gave and the tensors of a `stillray.training.dataset.Batch`, by name,
        to the ``(n, 3, h, w)`` radiance.
    """

    network: Callable[[ModelSpec], nn.Module]
    reconstruct: Callable[[Any, dict[str, Tensor], ModelSpec], Tensor]


def _fused(logits: Tensor, batch: dict[str, Tensor], spec: ModelSpec) -> Tensor:
    assert isinstance(spec.decoder, FusedKernels)
    image = fused_kernels(batch["irradiance"], batch["samples"], logits, spec.decoder)
    return image * batch["divisor"]


def _pyramid(logits: tuple[Tensor, ...], batch: dict[str, Tensor], spec: ModelSpec) -> Tensor:
    assert isinstance(spec.decoder, PyramidKernels)
    image = kernel_pyramid(batch["irradiance"], batch["samples"], logits, spec.decoder)
    return resolve(
        image * batch["divisor"], logits[0], batch["previous"], batch["valid"], spec.decoder
    )


#: By the name that specifications use.
FAMILIES = {
    "weight-sharing-kernels": Family(ImportanceNet, _fused),
    "kernel-pyramid": Family(PyramidNet, _pyramid),
}

"""What differs between families of models in training: the network and the reconstruction."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from torch import Tensor, nn
from torch.nn import functional as F

from stillray.model_spec import ModelSpec
from stillray.model_spec.decoders import BilateralGrids, FusedKernels, PyramidKernels
from stillray.model_spec.networks import ImportanceNetwork
from stillray_training.decoders.bilateral_grids import bilateral_grids
from stillray_training.decoders.boxes import BoxMean
from stillray_training.decoders.fused_kernels import fused_kernels
from stillray_training.decoders.multires import multi_resolution_kernels
from stillray_training.decoders.pyramid import (
    averaged_albedo,
    blended_with_sample,
    kernel_pyramid,
    level_parts,
    resolve,
)
from stillray_training.networks.guide import GuideNet
from stillray_training.networks.importance import ImportanceNet
from stillray_training.networks.multi_branch import multi_branch_net
from stillray_training.networks.pyramid import kernel_pyramid_net, multi_resolution_net

BoxFilter = Callable[[Tensor, int], Tensor]


@dataclass(frozen=True)
class Family:
    """One family of models.

    Attributes
    ----------
    network
        Makes the network of a specification.
    decode
        From what the network gave, the tensors of a `stillray_training.patches.Batch` by name, the
        specification and a box filter, to ``(n, 3, h, w)``.
    inputs
        The tensors that `decode` takes.
    modulates
        Whether `decode` gives radiance; otherwise irradiance, to be multiplied by the divisor.
    leak
        Share of the brightest light within reach that the rounding of a network's outputs may
        move to a pixel. Weights that are products of positive numbers are rounded in proportion,
        and move nothing.
    """

    network: Callable[[ModelSpec], nn.Module]
    decode: Callable[[Any, Mapping[str, Tensor], ModelSpec, BoxFilter], Tensor]
    inputs: tuple[str, ...]
    modulates: bool
    leak: float = 0.0

    def radiance(self, outputs: Any, batch: Mapping[str, Tensor], spec: ModelSpec) -> Tensor:
        """The ``(n, 3, h, w)`` radiance that a network's outputs stand for."""
        image = self.decode(outputs, batch, spec, BoxMean.apply)
        return image if self.modulates else image * batch["divisor"]


def _fused(logits: Tensor, batch: Mapping[str, Tensor], spec: ModelSpec, box: BoxFilter) -> Tensor:
    assert isinstance(spec.network, ImportanceNetwork)
    assert isinstance(spec.decoder, FusedKernels)
    if spec.network.block > 1:
        logits = F.pixel_shuffle(logits, spec.network.block)
    return fused_kernels(batch["irradiance"], batch["samples"], logits, spec.decoder, box)


def _pyramid(
    logits: tuple[Tensor, ...], batch: Mapping[str, Tensor], spec: ModelSpec, box: BoxFilter
) -> Tensor:
    assert isinstance(spec.decoder, PyramidKernels)
    maps = level_parts(logits, spec.decoder)
    finest = maps[0]
    light, samples = blended_with_sample(
        batch["irradiance"], batch["samples"], batch["new"], batch["worth"], finest.sample_blend
    )
    image = kernel_pyramid(light, samples, maps, spec.decoder, box, batch["exposure"])
    divisor = averaged_albedo(batch["divisor"], finest.resolve, spec.decoder.albedo_filters)
    image = image * divisor
    # of a box, whatever filter a patch has: recipes whose scenes have others train with 0
    toned = spec.decoder.resolve_tone
    tone = toned * batch["exposure"] if toned else None
    valid = batch["valid"] * batch["recalled"] if "recalled" in batch else batch["valid"]
    return resolve(image, finest.resolve, batch["previous"], valid, tone)


def _multires(
    logits: tuple[Tensor, ...], batch: Mapping[str, Tensor], spec: ModelSpec, box: BoxFilter
) -> Tensor:
    assert isinstance(spec.decoder, FusedKernels)
    return multi_resolution_kernels(
        batch["irradiance"], batch["samples"], logits, spec.decoder, box
    )


def _grids(maps: Tensor, batch: Mapping[str, Tensor], spec: ModelSpec, box: BoxFilter) -> Tensor:
    assert isinstance(spec.decoder, BilateralGrids)
    return bilateral_grids(batch["irradiance"], batch["samples"], maps, spec.decoder)


#: By the name that specifications use.
FAMILIES = {
    "weight-sharing-kernels": Family(
        ImportanceNet, _fused, inputs=("irradiance", "samples"), modulates=False
    ),
    "kernel-pyramid": Family(
        kernel_pyramid_net,
        _pyramid,
        inputs=(
            "irradiance",
            "samples",
            "new",
            "worth",
            "divisor",
            "previous",
            "valid",
            "exposure",
        ),
        modulates=True,
    ),
    "multi-resolution-kernels": Family(
        multi_resolution_net,
        _multires,
        inputs=("irradiance", "samples"),
        modulates=False,
        # eq. 7 takes a block's mean away and adds another: what is left is rounded as the means are
        leak=0.1,
    ),
    "bilateral-grids": Family(
        GuideNet,
        _grids,
        inputs=("irradiance", "samples"),
        modulates=False,
        # a guide is rounded to a few millionths of a cell, 1e-5 of the brightest cell beside it
        leak=0.1,
    ),
}


#: Networks of models that denoise and upscale, whose decoder takes and gives a past: see
#: `stillray_training.upscaling`.
RECURRENT: dict[str, Callable[[ModelSpec], nn.Module]] = {"feature-filters": multi_branch_net}


def network_of(spec: ModelSpec) -> nn.Module:
    """The network of a specification of any family, untrained."""
    recurrent = RECURRENT.get(spec.family)
    return recurrent(spec) if recurrent else FAMILIES[spec.family].network(spec)

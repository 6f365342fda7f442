"""The RepVGG block without batch normalisation (Fan et al. 2021, supplement, section 1.1)."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from stillray.errors import InputError
from stillray.model_spec import ModelSpec


class RepVGGBlock(nn.Module):
    """Convolutions of several sizes, and an identity where widths agree, added before a ReLU.

    Without batch normalisation the block is linear up to its ReLU, so the branches' kernels can
    be added before they meet the image: `forward` does that, one convolution instead of three,
    with the same values and the same gradients. `by_branches` switches to the definition, which
    tests and the export compare with.

    Parameters
    ----------
    width_in, width_out
        Channels.
    branches
        Kernel sizes in pixels, odd.
    identity
        Add the identity branch where ``width_in == width_out``.
    activation
        Whether a ReLU follows.
    block
        Side of the squares of pixels that it works on: what comes in is read as one pixel a
        square, of ``width_in`` channels for each of its pixels, and identity means those.
    """

    def __init__(
        self,
        width_in: int,
        width_out: int,
        branches: tuple[int, ...],
        *,
        identity: bool,
        activation: bool,
        block: int = 1,
    ) -> None:
        super().__init__()
        width_in *= block**2
        self.convolutions = nn.ModuleList(
            nn.Conv2d(width_in, width_out, size, padding=size // 2) for size in branches
        )
        self.kernel_size = max(branches)
        self.identity = identity and width_in == width_out
        self.activation = activation
        self.block = block
        self.merged = True

    def branches(self) -> list[nn.Conv2d]:
        """The trained convolutions, largest first as they were named."""
        return [branch for branch in self.convolutions if isinstance(branch, nn.Conv2d)]

    def fused(self) -> tuple[Tensor, Tensor]:
        """Weight and bias of the one convolution that equals all branches together."""
        weight: Tensor | None = None
        bias: Tensor | None = None
        for convolution in self.branches():
            margin = (self.kernel_size - convolution.kernel_size[0]) // 2
            padded = F.pad(convolution.weight, [margin] * 4)
            weight = padded if weight is None else weight + padded
            assert convolution.bias is not None
            bias = convolution.bias if bias is None else bias + convolution.bias
        assert weight is not None
        assert bias is not None
        if self.identity:
            one = torch.eye(weight.shape[0], dtype=weight.dtype, device=weight.device)
            weight = weight + F.pad(one[:, :, None, None], [self.kernel_size // 2] * 4)
        return weight, bias

    def unfuse(self, weight: Tensor, bias: Tensor) -> None:
        """Compute what one convolution of the inference network does: `fused` undone.

        Parameters
        ----------
        weight, bias
            As `stillray_training.networks.fuse` writes them: over squares of pixels, a kernel
            over pixels.
        """
        weight = F.pixel_unshuffle(weight, self.block)
        for parameter in self.convolutions.parameters():
            parameter.zero_()
        identity, _ = self.fused()
        largest = next(part for part in self.branches() if part.kernel_size[0] == self.kernel_size)
        assert largest.bias is not None
        largest.weight.copy_(weight - identity)
        largest.bias.copy_(bias)

    def forward(self, planes_nchw: Tensor) -> Tensor:
        """``(n, width_in, h, w)`` to ``(n, width_out, h / block, w / block)``; zeros outside."""
        if self.block > 1:
            planes_nchw = F.pixel_unshuffle(planes_nchw, self.block)
        if self.merged:
            weight, bias = self.fused()
            result = F.conv2d(planes_nchw, weight, bias, padding=self.kernel_size // 2)
        else:
            result = torch.stack([branch(planes_nchw) for branch in self.branches()]).sum(0)
            if self.identity:
                result = result + planes_nchw
        return F.relu(result) if self.activation else result


@contextmanager
def by_branches(network: nn.Module) -> Iterator[None]:
    """Compute every branch of a network's blocks on its own, as the paper draws them."""
    blocks = [module for module in network.modules() if isinstance(module, RepVGGBlock)]
    for block in blocks:
        block.merged = False
    try:
        yield
    finally:
        for block in blocks:
            block.merged = True


def without_branches(spec: ModelSpec) -> ModelSpec:
    """The same model as plain convolutions: Fan et al. 2021, table 5, "without RepVGG"."""
    network: Any = spec.network
    if not hasattr(network, "branches"):
        raise InputError(f"model must have branches to go without, got {spec.name}")
    network = dataclasses.replace(network, branches=(max(network.branches),), identity=False)
    return dataclasses.replace(spec, network=network)

"""RepVGG fusion: all branches of a block become one convolution, as a new module."""

from __future__ import annotations

import copy

from torch import nn
from torch.nn import functional as F

from stillray_training.networks.repvgg import RepVGGBlock


def fuse(network: nn.Module) -> nn.Module:
    """The inference network: one convolution and a ReLU a block (Fan et al. 2021, figure 1).

    Parameters
    ----------
    network
        The trained network; it is not changed and shares no memory with the result.

    Returns
    -------
    nn.Module
        The same network with every `RepVGGBlock` replaced, in evaluation mode.
    """
    return _replace_blocks(copy.deepcopy(network)).eval()


def _replace_blocks(module: nn.Module) -> nn.Module:
    for name, child in module.named_children():
        if isinstance(child, RepVGGBlock):
            setattr(module, name, _one_convolution(child))
        else:
            _replace_blocks(child)
    return module


def _one_convolution(block: RepVGGBlock) -> nn.Module:
    weight, bias = (part.detach().clone() for part in block.fused())
    # a kernel over squares of pixels is one over pixels that steps from square to square
    weight = F.pixel_shuffle(weight, block.block)
    convolution = nn.Conv2d(
        weight.shape[1],
        weight.shape[0],
        weight.shape[2],
        stride=block.block,
        padding=block.kernel_size // 2 * block.block,
    ).to(weight.dtype)
    convolution.weight.data = weight
    convolution.bias.data = bias  # type: ignore[union-attr]
    return nn.Sequential(convolution, nn.ReLU()) if block.activation else convolution

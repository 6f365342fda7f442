"""RepVGG fusion: all branches of a block become one convolution, as a new module."""

from __future__ import annotations

from torch import nn

from stillray.training.networks.importance import ImportanceNet


def fuse(network: ImportanceNet) -> nn.Sequential:
    """The inference network: one convolution and a ReLU a block (Fan et al. 2021, figure 1).

    Parameters
    ----------
    network
        The trained network; it is not changed and shares no memory with the result.

    Returns
    -------
    nn.Sequential
        ``(n, features, h, w)`` to ``(n, 2 m, h, w)``, in evaluation mode.
    """
    layers: list[nn.Module] = []
    for block in network.chain():
        weight, bias = (part.detach().clone() for part in block.fused())
        convolution = nn.Conv2d(
            weight.shape[1], weight.shape[0], block.kernel_size, padding=block.kernel_size // 2
        ).to(weight.dtype)
        convolution.weight.data = weight
        convolution.bias.data = bias  # type: ignore[union-attr]
        layers.append(convolution)
        if block.activation:
            layers.append(nn.ReLU())
    return nn.Sequential(*layers).eval()

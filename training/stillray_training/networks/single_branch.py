"""A U-Net of one branch, which sees light and guides alike: what MUNet is measured against.

Kazmierczyk et al. 2025, section 5.5: the same blocks and halvings, and fewer channels, so that it
has as many weights as the network of two branches.
"""

from __future__ import annotations

from itertools import pairwise

from torch import Tensor, nn
from torch.nn import functional as F

from stillray.families.filter_layout import target_layout
from stillray.model_spec import ModelSpec
from stillray.model_spec.decoders import FeatureFilters
from stillray.model_spec.network_outputs import network_outputs
from stillray.model_spec.networks import BranchNetwork
from stillray_training.networks.multi_branch import Residual, doubled, halving, start_heads


class SingleBranchNet(nn.Module):
    """What `stillray_training.networks.multi_branch.MultiBranchNet` gives, by one branch.

    Parameters
    ----------
    network
        Features and kernels; its widths are not looked at.
    widths
        Channels of each level.
    planes
        To give at each resolution, see `stillray.model_spec.network_outputs`.
    """

    def __init__(self, network: BranchNetwork, widths: tuple[int, ...], planes: list[int]) -> None:
        super().__init__()

        def blocks() -> nn.ModuleList:
            return nn.ModuleList(Residual(width, network, partial=False) for width in widths)

        self.enter = halving(len(network.features), widths)
        self.encode, self.decode = blocks(), blocks()
        self.rise = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in pairwise(widths))
        self.heads = nn.ModuleList(
            nn.Conv2d(width, count, 1)
            for width, count in zip((widths[0], *widths), planes, strict=True)
        )

    def forward(self, features_nchw: Tensor) -> tuple[Tensor, ...]:
        """``(n, planes, h, w)``, multiples of the coarsest level's pixels, to one map each."""
        skips = []
        light = features_nchw
        for enter, block in zip(self.enter, self.encode, strict=True):
            light = F.relu(enter(light))
            light = F.relu(light + block(light))
            skips.append(light)
        maps: list[Tensor] = []
        for level in reversed(range(len(skips))):
            if level < len(skips) - 1:
                light = doubled(self.rise[level](light)) + skips[level]
            light = F.relu(light + self.decode[level](light))
            maps.append(self.heads[level + 1](light))
        maps.append(self.heads[0](light))
        return tuple(reversed(maps))


def single_branch_net(spec: ModelSpec, widths: tuple[int, ...]) -> SingleBranchNet:
    """In place of `stillray_training.networks.multi_branch.multi_branch_net`."""
    network, decoder = spec.network, spec.decoder
    assert isinstance(network, BranchNetwork)
    assert isinstance(decoder, FeatureFilters)
    planes = [count for count, _ in network_outputs(spec)]
    made = SingleBranchNet(network, widths, planes)
    start_heads(made.heads[0], target_layout(network.resolutions, decoder))
    return made

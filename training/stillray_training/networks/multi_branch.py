"""MUNet: a U-Net whose radiance branch is steered by a smaller one of guides.

Kazmierczyk et al. 2025, section 3.3 and figure 3. The text gives no widths; those of the
specifications are chosen so that a network has 0.6 to 0.7 million weights, as theirs (0.644).
differs: planes of the picture's pixels are given by the first level, four for one, where the paper
doubles its features, which would give four pixels the same; convolutions are RepVGG blocks, which
are fused for inference; the guiding branch has one convolution in a block.
"""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from stillray.families.filter_layout import TargetLayout, target_layout
from stillray.model_spec import ModelSpec
from stillray.model_spec.decoders import FeatureFilters
from stillray.model_spec.network_outputs import network_outputs
from stillray.model_spec.networks import BranchNetwork
from stillray_training.networks.repvgg import RepVGGBlock

_MERGED = 0.5  # of the residual before training, whatever the guides say
_NOT_ALONE = -3.0  # logit of a frame's own light, before training
_NOT_PAST = -1.0  # and of the last output


class Residual(nn.Module):
    """What a block adds: two convolutions, of all channels or of the first half."""

    def __init__(self, width: int, network: BranchNetwork, *, partial: bool) -> None:
        super().__init__()
        self.convolved = width // 2 if partial else width
        self.first, self.second = (
            RepVGGBlock(
                self.convolved,
                self.convolved,
                network.branches,
                identity=network.identity and activation,
                activation=activation,
            )
            for activation in (True, False)
        )

    def forward(self, planes_nchw: Tensor) -> Tensor:
        """``(n, width, h, w)`` to the same; channels that are not convolved stay as they are."""
        if self.convolved == planes_nchw.shape[1]:
            return self.second(self.first(planes_nchw))  # type: ignore[no-any-return]
        convolved = self.second(self.first(planes_nchw[:, : self.convolved]))
        return torch.cat([convolved, planes_nchw[:, self.convolved :]], 1)


class _Guide(nn.Module):
    """A block of the guiding branch: one convolution, whose identity branch is the residual."""

    def __init__(self, width: int, network: BranchNetwork, *, partial: bool) -> None:
        super().__init__()
        self.convolved = width // 2 if partial else width
        self.block = RepVGGBlock(
            self.convolved,
            self.convolved,
            network.branches,
            identity=network.identity,
            activation=True,
        )

    def forward(self, planes_nchw: Tensor) -> Tensor:
        """``(n, width, h, w)`` to the same."""
        if self.convolved == planes_nchw.shape[1]:
            return self.block(planes_nchw)  # type: ignore[no-any-return]
        convolved = self.block(planes_nchw[:, : self.convolved])
        return torch.cat([convolved, planes_nchw[:, self.convolved :]], 1)


class MultiBranchBlock(nn.Module):
    """MConvRes, or with ``partial`` MPConvRes: both branches of a level.

    Parameters
    ----------
    width, guide_width
        Channels of the branches.
    network
        Kernel sizes and branches.
    partial
        Whether half of the channels alone are convolved.
    """

    def __init__(
        self, width: int, guide_width: int, network: BranchNetwork, *, partial: bool
    ) -> None:
        super().__init__()
        self.residual = Residual(width, network, partial=partial)
        self.guide = _Guide(guide_width, network, partial=partial)
        self.merge = nn.Conv2d(guide_width, width, 1)
        with torch.no_grad():
            assert self.merge.bias is not None
            self.merge.bias.fill_(_MERGED)

    def forward(self, planes_nchw: Tensor, guides_nchw: Tensor) -> tuple[Tensor, Tensor]:
        """Both branches; the residual is multiplied by what the guides say of it."""
        guides = self.guide(guides_nchw)
        added = self.residual(planes_nchw) * self.merge(guides)
        return F.relu(planes_nchw + added), guides


class MultiBranchNet(nn.Module):
    """Planes of a frame and its past in, planes of every resolution out, the picture's first.

    Parameters
    ----------
    network
        Features, widths and kernels.
    planes
        To give at each resolution, see `stillray.model_spec.network_outputs`.
    """

    def __init__(self, network: BranchNetwork, planes: list[int]) -> None:
        super().__init__()
        self.radiance = len(network.radiance)
        wide, narrow = network.radiance_widths, network.guide_widths
        levels = range(len(wide))

        def blocks() -> nn.ModuleList:
            return nn.ModuleList(
                MultiBranchBlock(
                    wide[level], narrow[level], network, partial=network.partial and level > 0
                )
                for level in levels
            )

        self.enter = halving(self.radiance, wide)
        self.enter_guides = halving(len(network.guides), narrow)
        self.encode, self.decode = blocks(), blocks()
        self.rise = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in pairwise(wide))
        self.rise_guides = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in pairwise(narrow))
        widths = [wide[0] + narrow[0], *(a + b for a, b in zip(wide, narrow, strict=True))]
        self.heads = nn.ModuleList(
            nn.Conv2d(width, count, 1) for width, count in zip(widths, planes, strict=True)
        )

    def forward(self, features_nchw: Tensor) -> tuple[Tensor, ...]:
        """``(n, planes, h, w)``, multiples of the coarsest level's pixels, to one map each."""
        light, guides = features_nchw[:, : self.radiance], features_nchw[:, self.radiance :]
        skips = []
        for enter, enter_guides, block in zip(
            self.enter, self.enter_guides, self.encode, strict=True
        ):
            light, guides = block(F.relu(enter(light)), F.relu(enter_guides(guides)))
            skips.append((light, guides))
        maps: list[Tensor] = []
        for level in reversed(range(len(skips))):
            if level < len(skips) - 1:
                skip, skip_guides = skips[level]
                light = doubled(self.rise[level](light)) + skip
                guides = doubled(self.rise_guides[level](guides)) + skip_guides
            light, guides = self.decode[level](light, guides)
            both = torch.cat([light, guides], 1)
            maps.append(self.heads[level + 1](both))
        maps.append(self.heads[0](both))
        return tuple(reversed(maps))


def multi_branch_net(spec: ModelSpec) -> MultiBranchNet:
    """A network that gives the planes of `stillray.families.feature_reconstruction`."""
    network, decoder = spec.network, spec.decoder
    assert isinstance(network, BranchNetwork)
    assert isinstance(decoder, FeatureFilters)
    made = MultiBranchNet(network, [planes for planes, _ in network_outputs(spec)])
    start_heads(made.heads[0], target_layout(network.resolutions, decoder))
    return made


def start_heads(finest: nn.Module, layout: TargetLayout) -> None:
    """Let the planes of the picture's pixels begin with little of this frame's light alone, and of
    the last output."""
    bias = finest.bias
    assert isinstance(bias, Tensor)
    with torch.no_grad():
        of_pixels = bias.view(layout.planes, 4)
        of_pixels[layout.compose.stop - 1] = _NOT_ALONE
        of_pixels[layout.output] = _NOT_PAST


def halving(inputs: int, widths: tuple[int, ...]) -> nn.ModuleList:
    """Convolutions of 2x2 pixels, 2 apart, from so many planes to each level's width."""
    return nn.ModuleList(nn.Conv2d(a, b, 2, stride=2) for a, b in pairwise((inputs, *widths)))


def doubled(planes_nchw: Tensor) -> Tensor:
    """Every pixel four times."""
    return F.interpolate(planes_nchw, scale_factor=2.0, mode="nearest")

"""GuideNet: features in, guides and blend weights out (Meng et al. 2020, figure 2)."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor, nn

from stillray.model_spec import ModelSpec
from stillray.model_spec.decoders import BilateralGrids
from stillray.model_spec.networks import GuideNetwork
from stillray_training.networks.repvgg import RepVGGBlock


class GuideNet(nn.Module):
    """Two convolutions, with a dense block between them where the specification has one.

    differs: the convolutions are RepVGG blocks, which are trained as branches and run as one.

    Parameters
    ----------
    spec
        Its ``network`` gives features and widths; its ``decoder`` the number of grids.
    """

    #: Beginning of the names of the weights that meet the features.
    reads_features = "enter."
    #: Of the weights that meet what the dense block adds, behind what was there without it.
    reads_more: ClassVar[dict[str, int]] = {"leave.": 1}

    def __init__(self, spec: ModelSpec) -> None:
        super().__init__()
        network = spec.network
        assert isinstance(network, GuideNetwork)
        assert isinstance(spec.decoder, BilateralGrids)

        def block(width_in: int, width_out: int, *, activation: bool) -> RepVGGBlock:
            return RepVGGBlock(
                width_in,
                width_out,
                network.branches,
                identity=network.identity,
                activation=activation,
            )

        width = network.width
        self.enter = block(len(network.features), width, activation=True)
        self.dense = nn.ModuleList()
        for _ in range(network.dense_layers):
            self.dense.append(block(width, network.growth, activation=True))
            width += network.growth
        self.leave = block(width, 2 * spec.decoder.grids - 1, activation=False)

    def forward(self, features_nchw: Tensor) -> Tensor:
        """``(n, features, h, w)`` to ``(n, 2 m - 1, h, w)`` in [0, 1].

        A guide for each of m grids, then the weights that `stillray.families.bilateral_grid.shares`
        explains.
        """
        planes = self.enter(features_nchw)
        for layer in self.dense:
            planes = torch.cat([planes, layer(planes)], 1)
        maps: Tensor = self.leave(planes)
        return maps.sigmoid()

"""ImportanceNet: features in, importance and fusion logits out (Fan et al. 2021, figure 2)."""

from __future__ import annotations

from torch import Tensor, nn

from stillray.model_spec import ModelSpec
from stillray.model_spec.decoders import FusedKernels
from stillray.model_spec.networks import ImportanceNetwork
from stillray_training.networks.repvgg import RepVGGBlock


class ImportanceNet(nn.Module):
    """A chain of RepVGG blocks; the last has no ReLU, since logits may be negative.

    Parameters
    ----------
    spec
        Its ``network`` gives features and widths; its ``decoder`` the number of kernels m.
    """

    #: Beginning of the names of the weights that meet the features.
    reads_features = "blocks.0."

    def __init__(self, spec: ModelSpec) -> None:
        super().__init__()
        network = spec.network
        assert isinstance(network, ImportanceNetwork)
        assert isinstance(spec.decoder, FusedKernels)
        outputs = 2 * len(spec.decoder.kernel_sizes) * network.block**2
        widths = (len(network.features), *network.widths, outputs)
        last = len(widths) - 2
        self.blocks = nn.ModuleList(
            RepVGGBlock(
                widths[index],
                widths[index + 1],
                network.block_branches(index),
                identity=network.identity,
                activation=index != last,
                block=network.block if index == 0 else 1,
            )
            for index in range(len(widths) - 1)
        )

    def forward(self, features_nchw: Tensor) -> Tensor:
        """``(n, features, h, w)`` to ``(n, 2 m, h, w)``: m importance maps, then m fusion maps.

        On squares of 2x2 pixels ``(n, 8 m, h / 2, w / 2)``: four planes for one, as
        `stillray.families.depth_to_space` reads them.
        """
        for block in self.blocks:
            features_nchw = block(features_nchw)
        return features_nchw

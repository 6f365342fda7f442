"""PyramidNet: a U-Net that gives logits at every resolution."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from stillray.families.multi_resolution import level_planes
from stillray.families.pyramid_logits import level_layout, level_logits, logit_names
from stillray.model_spec import ModelSpec
from stillray.model_spec.decoders import FusedKernels, PyramidKernels
from stillray.model_spec.networks import PyramidNetwork
from stillray_training.networks.repvgg import RepVGGBlock

_UNRESOLVED = -3.0  # logit of a neighbour against the pixel itself, before training
_ALONE = -5.0  # of one of many neighbours of the finest level
_NO_SAMPLE_BLEND = -3.0  # and of the new sample's weight beside what was accumulated
_UNFILTERED = 3.0  # and of a pixel itself, against each neighbour that looks like it


class PyramidNet(nn.Module):
    """Features in, logits of every level out, finest first.

    A level is entered by a convolution of stride 2 and left by doubling pixels, which the
    convolutions that follow smooth. Skips are added, or appended where the spec says so. A finest
    level that works on blocks of 2x2 pixels is entered by such a convolution too, which sees the
    neighbours of every pixel in the block, and gives the logits of those pixels, four planes for
    one, and of the blocks.

    Parameters
    ----------
    network
        Features, widths and blocks.
    logits
        Planes to give at each level, finest first.
    """

    #: Beginning of the names of the weights that meet the features.
    reads_features = "enter.0."
    #: What the planes of its heads are for, by the names of the heads, where that is told.
    planes: dict[str, list[str]]
    #: Beginnings of the names of the weights that read more planes in a wider network, the first
    #: that fits, and how many maps of planes they read as one.
    reads_more: dict[str, int]

    def __init__(self, network: PyramidNetwork, logits: Sequence[int]) -> None:
        super().__init__()
        widths, levels, block = network.widths, len(network.widths), network.block

        def blocks(width_in: int, width: int, count: int) -> nn.Sequential:
            return nn.Sequential(
                *(
                    RepVGGBlock(
                        width_in if index == 0 else width,
                        width,
                        network.branches,
                        identity=network.identity,
                        activation=True,
                    )
                    for index in range(count)
                )
            )

        def convolution(width_in: int, width: int, size: int, stride: int = 1) -> nn.Conv2d:
            return nn.Conv2d(width_in, width, size, stride=stride, padding=size // 2)

        size = network.kernel_size
        first = nn.Conv2d(
            len(network.features), widths[0], size + block - 1, stride=block, padding=size // 2
        )
        self.enter = nn.ModuleList(
            [first, *(convolution(a, b, size, stride=2) for a, b in pairwise(widths))]
        )
        self.encode = nn.ModuleList(
            blocks(width, width, count)
            for width, count in zip(widths, network.encoder_blocks, strict=True)
        )
        self.rise = nn.ModuleList(
            convolution(widths[level + 1], widths[level], 1) for level in range(levels - 1)
        )
        self.decode = nn.ModuleList(
            blocks(
                widths[level] * (2 if network.concatenate[level] else 1),
                widths[level],
                network.decoder_blocks[level],
            )
            for level in range(levels - 1)
        )
        if block == 1:
            finest = [convolution(widths[0], logits[0], size)]
        else:
            finest = [convolution(widths[0], logits[0] * block**2, 1)]
            finest.append(convolution(widths[0], logits[1], 1))
        coarser = zip(widths[1:], logits[block:], strict=True)
        self.heads = nn.ModuleList(
            [*finest, *(convolution(width, planes, 1) for width, planes in coarser)]
        )
        self.block, self.planes = block, {}
        self.concatenate = network.concatenate
        self.reads_more = {
            f"decode.{level}.0.": 2 for level in range(levels - 1) if network.concatenate[level]
        } | {"": 1}

    def forward(self, features_nchw: Tensor) -> tuple[Tensor, ...]:
        """``(n, features, h, w)`` to one map a resolution; sizes as `kernel_pyramid.alignment`."""
        skips = []
        for enter, encode in zip(self.enter, self.encode, strict=True):
            features_nchw = encode(F.relu(enter(features_nchw)))
            skips.append(features_nchw)
        planes = skips.pop()
        logits = [self.heads[-1](planes)]
        for level in reversed(range(len(skips))):
            risen = F.interpolate(self.rise[level](planes), scale_factor=2.0, mode="nearest")
            skip = skips[level]
            joined = torch.cat([risen, skip], 1) if self.concatenate[level] else risen + skip
            planes = self.decode[level](joined)
            logits.append(self.heads[level + self.block - 1](planes))
        if self.block > 1:
            logits.append(self.heads[0](planes))
        return tuple(reversed(logits))


def kernel_pyramid_net(spec: ModelSpec) -> PyramidNet:
    """A network that gives the logits of `stillray.families.kernel_pyramid`."""
    network, decoder = spec.network, spec.decoder
    assert isinstance(network, PyramidNetwork)
    assert isinstance(decoder, PyramidKernels)
    levels = network.resolutions
    made = PyramidNet(network, [level_logits(level, levels, decoder) for level in range(levels)])
    with torch.no_grad():
        for level, head in enumerate(made.heads):
            layout = level_layout(level, levels, decoder)
            # of the finest level as many planes as a block has pixels
            pixels = network.block**2 if level == 0 else 1
            names = logit_names(level, levels, decoder)
            uses = [f"{name} {pixel}" for name in names for pixel in range(pixels)]
            made.planes[f"heads.{level}"] = uses
            assert isinstance(head, nn.Conv2d)
            assert head.bias is not None
            weight, bias = (part.unflatten(0, (-1, pixels)) for part in (head.weight, head.bias))
            # from plain doubling and blending: weights that know no such logits serve as a start
            for part in (weight, bias):
                part[layout.double] = part[layout.around] = 0
            bias[layout.around] = _UNRESOLVED if level else _ALONE
            # from an unresolved picture: even shares would blur it and hide what to learn
            bias[layout.resolve] = _UNRESOLVED
            bias[layout.sample_blend] = _NO_SAMPLE_BLEND
            weight[layout.filters] = 0
            bias[layout.filters][0::2], bias[layout.filters][1::2] = 0, _UNFILTERED
            weight[layout.features] *= 2  # surfaces should differ from the start
            bias[layout.features] = 0
    return made


def multi_resolution_net(spec: ModelSpec) -> PyramidNet:
    """A network that gives the logits of `stillray.families.multi_resolution`."""
    network, decoder = spec.network, spec.decoder
    assert isinstance(network, PyramidNetwork)
    assert isinstance(decoder, FusedKernels)
    levels = network.resolutions
    return PyramidNet(network, [level_planes(level, levels, decoder) for level in range(levels)])

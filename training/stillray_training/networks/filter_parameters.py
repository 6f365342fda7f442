"""The U-Net that sets the filter of a model that learns while it denoises.

Choi et al. 2024, section 4.4: two convolutions a level of 8, 16, 32, 16 and 8 filters of 3x3, two
poolings by maximum, two doublings, and a convolution of 1x1; its weights are given, not held.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from stillray.model_spec.network_weights import Shapes


def start(layout: Shapes, seed: int) -> Tensor:
    """Random weights ``(n,)``: uniform as Glorot and Bengio 2010, eq. 16; biases 0.

    differs: the biases of the last layer are such that a filter begins with half a window of like
    pixels and half of the past, where learning has somewhere to go; with 0 the first windows would
    hold their center alone. Validation scenes chose among a few (docs/decisions.md).
    """
    generator = torch.Generator().manual_seed(seed)
    parts = []
    for name, shape in layout:
        if len(shape) == 1:
            bias = torch.zeros(shape)
            if name == "out.bias":
                bias[:-1] = torch.tensor(_FIRST_BANDS)
            parts.append(bias)
            continue
        size = math.prod(shape[2:])
        bound = math.sqrt(6 / (size * (shape[0] + shape[1])))
        parts.append((torch.rand(shape, generator=generator) * 2 - 1).flatten() * bound)
    return torch.cat(parts)


#: Of both estimates, in logarithms; of albedo, normals and places.
_FIRST_BANDS = (0.1, 0.1, 0.25, 0.5, 0.5)


def split(weights: Tensor, layout: Shapes) -> dict[str, Tensor]:
    """A flat vector ``(n,)`` by names, each in its shape."""
    sizes = [math.prod(shape) for _, shape in layout]
    parts = weights.split(sizes)
    return {name: part.reshape(shape) for part, (name, shape) in zip(parts, layout, strict=True)}


class Operators:
    """How the network pools and doubles, as exporters want it for inference."""

    def pool(self, planes: Tensor) -> Tensor:
        """Maxima of 2x2 pixels."""
        return F.max_pool2d(planes, 2)

    def double(self, planes: Tensor) -> Tensor:
        """Every pixel four times."""
        return F.interpolate(planes, scale_factor=2, mode="nearest")


class Differentiable(Operators):
    """The same, of operators whose derivatives are made of ONNX's operators."""

    def pool(self, planes: Tensor) -> Tensor:
        """Maxima of 2x2 pixels; those that are equal share the slope."""
        n, c, h, w = planes.shape
        return planes.reshape(n, c, h // 2, 2, w // 2, 2).amax((3, 5))

    def double(self, planes: Tensor) -> Tensor:
        """Every pixel four times."""
        n, c, h, w = planes.shape
        wide = planes[:, :, :, None, :, None].expand(n, c, h, 2, w, 2)
        return wide.reshape(n, c, 2 * h, 2 * w)


def filter_parameters(
    weights: dict[str, Tensor], features: Tensor, operators: Operators | None = None
) -> Tensor:
    """The planes that set the filter.

    Parameters
    ----------
    weights
        By name, see `stillray.model_spec.network_weights`.
    features : (1, n, h, w)
        Height and width are multiples of 4, or of what the levels ask for.
    operators
        Those of inference unless given.

    Returns
    -------
    (1, parameters, h, w)
        Bands, and the logit of this frame's share.
    """
    run = operators or Operators()

    def block(name: str, planes: Tensor) -> Tensor:
        for index in range(2):
            kernel, bias = weights[f"{name}_{index}.weight"], weights[f"{name}_{index}.bias"]
            planes = F.relu(F.conv2d(planes, kernel, bias, padding=1))
        return planes

    levels = sum(name.startswith("down") for name in weights) // 4
    kept = [block("down_0", features)]
    for level in range(1, levels):
        kept.append(block(f"down_{level}", run.pool(kept[-1])))
    planes = kept[-1]
    for level in reversed(range(levels - 1)):
        planes = block(f"up_{level}", torch.cat([run.double(planes), kept[level]], 1))
    return F.conv2d(planes, weights["out.weight"], weights["out.bias"])

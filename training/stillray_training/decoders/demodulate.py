"""What light is divided by: the twin, in PyTorch, of `stillray.stages.demodulate`, for training and
for frame graphs."""

from __future__ import annotations

import torch
from torch import Tensor

from stillray.model_spec.stages import Demodulate


def is_black(albedo_nchw: Tensor, options: Demodulate) -> Tensor:
    """1 where no channel says anything, ``(n, 1, h, w)``."""
    return (albedo_nchw.amax(1, keepdim=True) <= options.black).to(torch.float32)


def divisor(albedo_nchw: Tensor, options: Demodulate) -> Tensor:
    """What radiance is divided by, ``(n, 3, h, w)``, see `demodulation_albedo`."""
    raised = albedo_nchw.clamp(options.floor, 1.0)
    # ones as a tensor: of a number torch's exporter makes a bound of the clamp, and gives up
    white = torch.ones_like(raised)
    return torch.where(is_black(albedo_nchw, options) > 0, white, raised) + options.specular

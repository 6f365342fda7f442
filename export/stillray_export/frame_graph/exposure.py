"""The brightness that a frame is relative to, the twin of `stillray.stages.exposure`."""

from __future__ import annotations

import torch
from torch import Tensor

from stillray.model_spec.stages import Transfer
from stillray_export.frame_graph.median import masked_median
from stillray_export.frame_graph.windows import area_means

_BLOCK = 8  # pixels
_TAPS = 2 * _BLOCK  # a lone cell has up to 15 pixels


def size_of(planes_nchw: Tensor) -> tuple[Tensor, Tensor]:
    """Height and width as numbers of the graph, float32 scalars."""
    height, width = planes_nchw.shape[2:]
    return torch.full((), height, dtype=torch.float32), torch.full((), width, dtype=torch.float32)


def frame_exposure(light_nchw: Tensor, options: Transfer) -> Tensor:
    """The scale that brings typical irradiance to ``middle``: a scalar.

    Parameters
    ----------
    light_nchw : (1, 1, h, w)
        Irradiance luminance.
    options
        The middle.
    """
    height, width = light_nchw.shape[2:]
    rows, columns = ((size / _BLOCK).floor().clamp(min=1) for size in size_of(light_nchw))
    # not the negative of a negative: a graph's division of integers rounds towards zero
    cells = ((height + _BLOCK - 1) // _BLOCK, (width + _BLOCK - 1) // _BLOCK)
    blocks = area_means(light_nchw, cells, (rows, columns), _TAPS)[0, 0]
    counted = (torch.arange(cells[0], dtype=torch.float32) < rows)[:, None] & (
        torch.arange(cells[1], dtype=torch.float32) < columns
    )
    lit = (counted & (blocks > 0)).to(torch.float32)
    typical, count = masked_median(blocks.flatten(), lit.flatten())
    exposure = (options.middle / typical).clamp(1e-30, 1e30)
    return torch.where(count > 0, exposure, 1.0)


def steady_exposure(now: Tensor, before: Tensor, options: Transfer) -> Tensor:
    """A running mean of the logarithm; ``now`` where ``before`` is 0, which is no past."""
    keep = options.exposure_memory
    steadied = (keep * before.clamp(min=1e-30).log() + (1 - keep) * now.log()).exp()
    return torch.where(before > 0, steadied, now)


def depth_scale(depth_nchw: Tensor) -> Tensor:
    """Mean depth of what was hit, a scalar; 1 where nothing was."""
    hit = (depth_nchw > 0).to(torch.float32).mean()
    return torch.where(hit > 0, depth_nchw.mean() / hit.clamp(min=1e-30), 1.0)

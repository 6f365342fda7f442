"""Windows over planes ``(1, c, h, w)``: means, extremes, neighbours, smaller and larger images."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

_AROUND = [(down, right) for down in (-1, 0, 1) for right in (-1, 0, 1)]


def repeated(planes_nchw: Tensor, by: int) -> Tensor:
    """With ``by`` more pixels on each side, which repeat the border."""
    return F.pad(planes_nchw, (by, by, by, by), mode="replicate")


def mirrored(planes_nchw: Tensor, multiple: int) -> Tensor:
    """Carried on to multiples of a size by `stillray.arrays.extend.mirrored`.

    ``Pad`` mirrors no further than a small frame is large.
    """

    def places(size: int) -> Tensor:
        there_and_back = torch.arange(size + -size % multiple) % (2 * size)
        return torch.minimum(there_and_back, 2 * size - 1 - there_and_back)

    height, width = planes_nchw.shape[2:]
    return planes_nchw[:, :, places(height)][..., places(width)]


def mean_around(planes_nchw: Tensor, size: int) -> Tensor:
    """Means of ``size x size`` windows, zeros outside."""
    return F.avg_pool2d(planes_nchw, size, stride=1, padding=size // 2)


def mean_with_border(planes_nchw: Tensor, size: int) -> Tensor:
    """Means of ``size x size`` windows, the border repeated."""
    return F.avg_pool2d(repeated(planes_nchw, size // 2), size, stride=1)


def most_around(planes_nchw: Tensor) -> Tensor:
    """The largest of 3x3 pixels; what is outside does not count."""
    return F.max_pool2d(planes_nchw, 3, stride=1, padding=1)


def least_around(planes_nchw: Tensor) -> Tensor:
    """The smallest of 3x3 pixels; what is outside does not count."""
    return -most_around(-planes_nchw)


def neighbours(planes_nchw: Tensor, outside: float) -> list[Tensor]:
    """The nine images that begin one pixel up or down and left or right, row by row."""
    height, width = planes_nchw.shape[2:]
    padded = F.pad(planes_nchw, (1, 1, 1, 1), value=outside)
    return [
        padded[..., 1 + down : 1 + down + height, 1 + right : 1 + right + width]
        for down, right in _AROUND
    ]


def even(planes_nchw: Tensor) -> Tensor:
    """With a row and a column of zeros where a size is odd."""
    height, width = planes_nchw.shape[2:]
    return F.pad(planes_nchw, (0, width % 2, 0, height % 2))


def halved(planes_nchw: Tensor) -> Tensor:
    """Means of 2x2 pixels; what sticks out is zeros."""
    return F.avg_pool2d(even(planes_nchw), 2)


def enlarged(planes_nchw: Tensor, factor: int, height: int, width: int) -> Tensor:
    """Linear interpolation to ``factor`` times the size, of which ``height x width`` is taken."""
    large = F.interpolate(
        planes_nchw, scale_factor=float(factor), mode="bilinear", align_corners=False
    )
    return large[..., :height, :width]


def every_second(planes_nchw: Tensor) -> Tensor:
    """Every second pixel of every second row, those of whole 2x2 blocks; a lone pixel itself."""
    height, width = planes_nchw.shape[2:]
    rows, columns = height // 2 * 2 + 1 // height, width // 2 * 2 + 1 // width
    return planes_nchw[..., :rows:2, :columns:2]


def whole_blocks(planes_nchw: Tensor) -> Tensor:
    """Means of whole 2x2 blocks, of the size of `every_second`."""
    height, width = planes_nchw.shape[2:]
    rows, columns = height // 2 + 1 // height, width // 2 + 1 // width
    return halved(planes_nchw)[..., :rows, :columns]


def area_means(
    planes_nchw: Tensor, cells: tuple[int, int], counted: tuple[Tensor, Tensor], taps: int
) -> Tensor:
    """Means over the cells of a coarser grid, as OpenCV's INTER_AREA takes them.

    Parameters
    ----------
    planes_nchw : (1, c, h, w)
    cells
        Rows and columns of the result.
    counted
        Rows and columns of the grid, float32 scalars, each no more than ``cells``: what lies
        beyond in the result means nothing.
    taps
        Pixels that a cell can touch along one axis, at most.

    Returns
    -------
    (1, c, rows, columns)
    """
    for axis, (size, count) in enumerate(zip(cells, counted, strict=True), start=2):
        planes_nchw = _area_means(planes_nchw, axis, size, count, taps)
    return planes_nchw


def _area_means(planes: Tensor, axis: int, cells: int, count: Tensor, taps: int) -> Tensor:
    length = planes.shape[axis]
    scale = length / count
    start = (torch.arange(cells, dtype=torch.float32) * scale)[:, None]
    pixel = start.floor() + torch.arange(taps, dtype=torch.float32)
    overlap = torch.minimum(start + scale, pixel + 1) - torch.maximum(start, pixel)
    weight = overlap.clamp(min=0) / scale
    at = pixel.clamp(0, length - 1).to(torch.int32).flatten()
    taken = planes.index_select(axis, at)
    one, channels, height, width = taken.shape
    if axis == 2:
        shape = taken.reshape(one, channels, cells, taps, width)
        return (shape * weight[:, :, None]).sum(3)
    return (taken.reshape(one, channels, height, cells, taps) * weight).sum(4)

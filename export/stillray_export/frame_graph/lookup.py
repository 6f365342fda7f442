"""Pixels at places between pixels, as OpenCV's ``remap`` finds them, by Gather alone.

GridSample takes places in [-1, 1], in which float32 is a thousandth of a pixel at 4K, and is not
there in every browser. An image is looked up as a list of pixels, ``(h w, channels)``: one Gather
brings all channels of a tap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

_KEYS = -0.75  # OpenCV's factor of cubic convolution


def pixels_of(planes_nchw: Tensor) -> Tensor:
    """``(1, c, h, w)`` as a list of pixels ``(h w, c)``."""
    return planes_nchw[0].permute(1, 2, 0).flatten(0, 1)


def planes_like(pixels: Tensor, like_nchw: Tensor) -> Tensor:
    """A list of pixels ``(h w, c)`` as planes ``(1, c, h, w)`` of the size of another image."""
    height, width = like_nchw.shape[2:]
    return pixels.reshape(height, width, pixels.shape[1]).permute(2, 0, 1)[None]


def grid(like_nchw: Tensor) -> Tensor:
    """Every pixel's own column and row, ``(1, 2, h, w)`` float32."""
    height, width = like_nchw.shape[2:]
    columns = torch.arange(width, dtype=torch.float32)[None, :].expand(height, width)
    rows = torch.arange(height, dtype=torch.float32)[:, None].expand(height, width)
    return torch.stack([columns, rows])[None]


@dataclass(frozen=True, eq=False)
class Tap:
    """One pixel of those that an interpolation takes, for each of ``n`` places.

    Attributes
    ----------
    index : (n,) int32
        In the list of the image's pixels; of the nearest pixel where it lies outside.
    weight : (n, 1) float32
    inside : (n, 1) float32
        1 where it lies in the image, else 0.
    """

    index: Tensor
    weight: Tensor
    inside: Tensor

    def of(self, pixels: Tensor) -> Tensor:
        """The pixels ``(n, c)``."""
        return pixels.index_select(0, self.index)


def linear_taps(places_nchw: Tensor, image_nchw: Tensor) -> list[Tap]:
    """The four taps of bilinear interpolation: top left, top right, bottom left, bottom right.

    Parameters
    ----------
    places_nchw : (1, 2, h, w)
        x and y, pixels, finite, below 2^31 in magnitude.
    image_nchw : (1, c, H, W)
        Whose size counts.
    """
    x, y = pixels_of(places_nchw).split(1, 1)
    left, top = x.floor(), y.floor()
    right, below = x - left, y - top
    return [
        _tap((left + column, top + row), share_x * share_y, image_nchw)
        for row, share_y in ((0, 1 - below), (1, below))
        for column, share_x in ((0, 1 - right), (1, right))
    ]


def mean_of(taps: Sequence[Tap], pixels: Tensor, *, zeros: bool) -> Tensor:
    """The weighted sum of taps, ``(n, c)``; what lies outside is 0, or the nearest pixel."""
    parts = [tap.of(pixels) * (tap.weight * tap.inside if zeros else tap.weight) for tap in taps]
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return total


def cubic_taps(places_nchw: Tensor, image_nchw: Tensor) -> list[Tap]:
    """The sixteen taps of cubic convolution (Keys 1981), row by row; as `linear_taps`."""
    x, y = pixels_of(places_nchw).split(1, 1)
    left, top = x.floor(), y.floor()
    across, down = _keys(x - left), _keys(y - top)
    return [
        _tap((left + (column - 1), top + (row - 1)), across[column] * down[row], image_nchw)
        for row in range(4)
        for column in range(4)
    ]


def _keys(part: Tensor) -> list[Tensor]:
    """Weights of the taps at -1, 0, 1 and 2, for a place between 0 and 1."""
    rest = 1 - part
    first = _KEYS * part * rest * rest
    last = _KEYS * part * part * rest
    second = ((_KEYS + 2) * part - (_KEYS + 3)) * part * part + 1
    return [first, second, 1 - first - second - last, last]


def _tap(at: tuple[Tensor, Tensor], weight: Tensor, image_nchw: Tensor) -> Tap:
    height, width = image_nchw.shape[2:]
    x, y = at
    near_x, near_y = x.clamp(0, width - 1), y.clamp(0, height - 1)
    inside = (x == near_x) & (y == near_y)
    index = near_y.to(torch.int32) * width + near_x.to(torch.int32)
    return Tap(index.flatten(), weight, inside.to(torch.float32))

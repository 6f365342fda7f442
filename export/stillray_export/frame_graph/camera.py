"""How still points move: the twin of `stillray.stages.specular_motion.camera_motion`.

Without sorting, lists of unknown length or float64: a fixed number of pixels, of which some do not
count, and least squares in float32, refined.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from stillray.stages import specular_motion as runtime
from stillray_export.frame_graph.exposure import size_of
from stillray_export.frame_graph.lookup import pixels_of
from stillray_export.frame_graph.median import masked_median

# Pixels that are looked at at most: 1,024 of large frames, every one of those up to 64x64.
_MOST = 4608
_TERMS = 9
_NEAREST = float(runtime._NEAREST)
_RIDGE = 1e-5  # of the mean square: what terms do not tell apart is shared among them
_REFINED = 4


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera's motion, see `stillray.stages.specular_motion.CameraMotion`.

    Attributes
    ----------
    coefficients : (9, 2)
        Of turning, then of travel.
    unit
        Of inverse depth, scalar.
    found
        1 where most of the frame moves so, else 0; scalar.
    """

    coefficients: Tensor
    unit: Tensor
    found: Tensor

    def parts(self, x: Tensor, y: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
        """Motion of points infinitely far away, and what depth adds: ``(1, 2, h, w)`` each.

        Parameters
        ----------
        x, y, depth : (1, 1, h, w)
            Places as `place` gives them; depth > 0.
        """
        one, by_x, by_y, by_xx, by_xy, by_yy, travel, travel_x, travel_y = (
            self.coefficients[i][None, :, None, None] for i in range(_TERMS)
        )
        far = (one + x * (by_x + by_xx * x)) + y * (by_y + by_yy * y) + by_xy * x * y
        near = (travel + travel_x * x + travel_y * y) * _inverse(depth, self.unit)
        return far, near


def place(at: Tensor, size: Tensor, longest: Tensor) -> Tensor:
    """Rows or columns with 0 in the frame's middle, 1 at the end of its longer side."""
    return (at - size / 2) / (longest / 2)


def camera_motion(motion_nchw: Tensor, depth_nchw: Tensor) -> Camera:
    """Learn how still points move from a frame's motion ``(1, 2, h, w)`` and depth."""
    depth, moved, x, y, counts = _samples(motion_nchw, depth_nchw)
    hit = counts * (depth > 0).to(torch.float32)
    unit, hits = masked_median(1 / depth.clamp(min=1e-30), hit)
    unit = torch.where(hits > 0, unit, 1.0)
    inverse = _inverse(depth, unit)
    plane = torch.stack([torch.ones_like(x), x, y, x * x, x * y, y * y], 1)
    terms = torch.cat([plane, plane[:, :3] * inverse[:, None]], 1)
    kept = hit * (inverse < _NEAREST).to(torch.float32)
    enough = (hits >= runtime._LEAST_SAMPLES).to(torch.float32)
    found = terms.new_zeros(_TERMS, 2)
    typical = unit
    for _ in range(runtime._ROUNDS):
        enough = enough * (kept.sum() >= runtime._LEAST_SAMPLES).to(torch.float32)
        found = _fit(terms, moved, kept)
        error = (terms @ found - moved).abs().amax(1)
        typical, _ = masked_median(error, hit)
        kept = hit * (error <= typical.clamp(min=runtime._AGREES)).to(torch.float32)
    agrees = (typical <= runtime._TRUSTED).to(torch.float32)
    return Camera(found, unit, enough * agrees)


def _samples(motion: Tensor, depth: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Depth, motion and place of a grid of pixels, and 1 where there is one of that number."""
    height, width = size_of(depth)
    step = (height * width / runtime._SAMPLES).sqrt().floor().clamp(min=1)
    start = (step / 2).floor()
    rows, columns = (((size - start) / step).ceil() for size in (height, width))
    number = torch.arange(_MOST, dtype=torch.float32)
    row = ((number + 0.5) / columns.clamp(min=1)).floor()
    column = number - row * columns
    counts = ((row < rows) & (columns > 0)).to(torch.float32)
    row = torch.minimum(start + row * step, height - 1)
    column = torch.minimum(start + column * step, width - 1)
    at = row.to(torch.int32) * depth.shape[3] + column.to(torch.int32)
    longest = torch.maximum(height, width)
    return (
        pixels_of(depth).index_select(0, at)[:, 0],
        pixels_of(motion).index_select(0, at) * counts[:, None],
        place(column, width, longest),
        place(row, height, longest),
        counts,
    )


def _inverse(depth: Tensor, unit: Tensor) -> Tensor:
    return (1 / (depth * unit).clamp(min=1e-30)).clamp(max=_NEAREST)


def _fit(terms: Tensor, moved: Tensor, kept: Tensor) -> Tensor:
    """Least squares over what is kept, ``(9, 2)``: Tikhonov's, iterated until it is the plain one.

    Where terms are alike, as inverse depth and place on one plane, the least of all solutions.
    """
    transposed = (terms * kept[:, None]).T
    square = transposed @ terms
    one = torch.eye(_TERMS)
    ridge = _RIDGE / _TERMS * (square * one).sum() + 1e-20
    inverse = _inverted(square + ridge * one)
    found = inverse @ (transposed @ moved)
    for _ in range(_REFINED):
        found = found + inverse @ (transposed @ (moved - terms @ found))
    return found


def _inverted(square: Tensor) -> Tensor:
    """The inverse of a positive definite matrix by Gauss and Jordan, unrolled."""
    one = torch.eye(_TERMS)
    rows = torch.cat([square, one], 1)
    for index in range(_TERMS):
        pivot = rows[index : index + 1] / rows[index : index + 1, index : index + 1]
        rows = rows - (rows[:, index : index + 1] - one[:, index : index + 1]) * pivot
    return rows[:, _TERMS:]

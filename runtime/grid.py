"""Reconstruction with bilateral grids (Meng et al. 2020, sections 4.2, 4.3 and 4.5).

Pixels are splatted into a grid at the place that their guide says, and read from it at the same
place: light spreads among pixels that are near and alike. Every result is a weighted mean of
irradiance, so no light is invented.

differs: a grid has all the cells that a tent can reach; eq. 8 has one too few at odd ends. A cell
is empty if nothing was splatted into it; eq. 13 takes a black one for empty. The last blend weight
is what the others leave of 1, each taking its share of the rest: never negative, where
``1 - w0 - w1`` can be; the price is that scales cannot be set off against each other to sharpen.

A tent of 8 or 16 pixels is a tent of 4 pixels, then one over the cells (linear B-splines refine).
So every scale is splatted and sliced at the finest spacing, where pixels of one phase, one from
each block, never meet in a cell: that is plain indexing, without the slow additions of equal
places.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import cv2
import numpy as np

from stillray.models_spec.loader import BilateralGrids, ModelSpec
from stillray.prepare import Prepared
from stillray.scratch import Scratch
from stillray.strips import Strips, strips_of
from stillray.timing import timed

#: Values of a guide, of which the paper has as many as an 8-bit image.
GUIDE_RANGE = 255.0
# Weight of a cell, in samples, below which it is empty: far below the least sample's least corner.
_EMPTY = np.float32(1e-30)
# Four float32 channels of a pixel or a cell as one element, which NumPy moves at once.
_FOUR = np.complex128
_HALF = np.float32(0.5)


def grid_cells(
    height: int, width: int, options: BilateralGrids, scale: int
) -> tuple[int, int, int]:
    """Rows, columns and depth of a grid, 0 being the finest scale."""
    spacing = options.spacing << scale
    depth = math.ceil(GUIDE_RANGE / (options.depth_spacing * 2**scale)) + 1
    # no quotients of negative numbers here: an exported graph rounds those the other way
    return (height - 1) // spacing + 2, (width - 1) // spacing + 2, depth


def reach(spec: ModelSpec) -> int:
    """Pixels from which light can come to a pixel, to each side: two that share a cell."""
    assert isinstance(spec.decoder, BilateralGrids)
    return 2 * (_unit(spec.decoder) - 1)


def method(spec: ModelSpec) -> str:
    """What the reconstruction does, in a few words."""
    assert isinstance(spec.decoder, BilateralGrids)
    count = spec.decoder.grids
    return "a bilateral grid" if count == 1 else f"{count} bilateral grids"


def reconstruct(
    prepared: Prepared,
    previous: np.ndarray | None,
    outputs: Sequence[np.ndarray],
    spec: ModelSpec,
    strips: Strips,
    timings: dict[str, float],
) -> np.ndarray:
    """Filter and re-modulate a frame, see `stillray.families.Family`."""
    assert isinstance(spec.decoder, BilateralGrids)
    (maps,) = outputs
    with timed(timings, "reconstruct"):
        return filter_grids(prepared.history.mean, prepared.divisor, maps, spec.decoder, strips)


def filter_grids(
    mean: np.ndarray,
    divisor: np.ndarray | None,
    maps: np.ndarray,
    options: BilateralGrids,
    strips: Strips,
) -> np.ndarray:
    """Splat a frame into its grids, slice them, blend and re-modulate.

    Parameters
    ----------
    mean : (h, w, 4) float32
        Irradiance, >= 0 and finite; and the samples that each pixel holds, >= 0, which it is
        splatted by when the options say so.
    divisor : (h, w, 3) float32 or None
        What radiance was divided by.
    maps : (2 m - 1, h, w) float32
        A guide for each of m grids, finest first; then, for all but the last, the share that a
        grid takes of what the finer ones have left. In [0, 1]; what lies beyond is taken for the
        nearer end, NaN for the middle.
    options
        The grids.
    strips
        Where the work runs.

    Returns
    -------
    (h, w, 3) float32
        Radiance: a convex combination of irradiance within `reach`, times the divisor; 0 where
        no pixel around counts.
    """
    if np.isnan(maps.max()):
        maps = np.nan_to_num(maps, nan=0.5)
    height, width = mean.shape[:2]
    unit = _unit(options)
    # strips of whole cells of the coarsest grid
    units = -(-height // unit), unit * width
    bounds = strips_of(*units)
    grids = [_strip_grids(bounds, width, options, scale, strips) for scale in range(options.grids)]

    def construct(rows: slice) -> None:
        own, scratch = slice(rows.start * unit, min(rows.stop * unit, height)), strips.scratch
        light = _light(mean[own], options, scratch)
        for scale, grid in enumerate(grids):
            _construct(light, maps[scale, own], grid[rows.start], options, scale, scratch)

    strips.run(construct, *units)
    for grid in grids:  # in order: the same sums for any number of threads
        for above, below in pairwise(grid.values()):
            above[-1] += below[0]
            np.copyto(below[0], above[-1])
    image = np.empty((height, width, 3), np.float32)

    def read(rows: slice) -> None:
        own = slice(rows.start * unit, min(rows.stop * unit, height))
        light = _read([grid[rows.start] for grid in grids], maps[:, own], options, strips.scratch)
        np.multiply(light[..., :3], 1 if divisor is None else divisor[own], out=image[own])

    strips.run(read, *units)
    return image


def _unit(options: BilateralGrids) -> int:
    """Spacing of the coarsest grid, pixels."""
    return options.spacing << (options.grids - 1)


def _strip_grids(
    bounds: list[slice], width: int, options: BilateralGrids, scale: int, strips: Strips
) -> dict[int, np.ndarray]:
    """A grid by the start of each strip; neighbours hold the row of cells between them both."""
    unit = _unit(options)
    _, columns, depth = grid_cells(1, -(-width // unit) * unit, options, scale)
    ends = [0]
    for rows in bounds:
        ends.append(ends[-1] + ((rows.stop - rows.start) << (options.grids - 1 - scale)) + 1)
    whole = strips.scratch.array(f"grid {scale}", (ends[-1], columns, depth, 4))
    return {
        rows.start: whole[start:stop]
        for rows, (start, stop) in zip(bounds, pairwise(ends), strict=True)
    }


def _construct(
    light: np.ndarray,
    guide: np.ndarray,
    grid: np.ndarray,
    options: BilateralGrids,
    scale: int,
    scratch: Scratch,
) -> None:
    """Splat a strip: the sums of eq. 10, before their division.

    Parameters
    ----------
    light : (h, w, 4) float32
        Weighted irradiance, and the weights.
    guide : (h, w) float32
    grid : (cells down, cells across, depth, 4) float32
        Written.
    """
    fine = _fine(grid, scale, scratch)
    fine.fill(0)
    cells = _as_one(fine).reshape(-1)
    at, far = _places(guide, fine.shape, options, scale, scratch)
    deep, near = (scratch.array(name, far.shape) for name in ("deep light", "near light"))
    _by_phase(_as_one(light), _as_one(near))
    np.multiply(near, far, out=deep)
    near *= np.subtract(1, far, out=far)
    found = scratch.array("found", (at[0, 0].size, 4))
    for phase, weight, offset in _corners(fine.shape, options.spacing):
        index = at[phase].reshape(-1)
        for deeper, part in enumerate((near, deep)):
            here = cells[offset + deeper :]
            np.take(here, index, out=_as_one(found), mode="clip")
            cv2.scaleAdd(part[phase].reshape(-1, 4), weight, found, dst=found)
            here[index] = _as_one(found)
    for _ in range(scale):
        fine = _coarser(fine, scratch)
    if scale:
        np.copyto(grid, fine)


def _read(
    grids: Sequence[np.ndarray], maps: np.ndarray, options: BilateralGrids, scratch: Scratch
) -> np.ndarray:
    """Slice a strip from its grids (eq. 13) and blend (eq. 15): ``(h, w, 4)``, the last is 1."""
    shape = maps.shape[1:]
    total = scratch.array("total", (*shape, 4))
    total.fill(0)
    factor, rest = scratch.array("factor", shape), scratch.array("rest", shape)
    rest.fill(1)
    for scale, grid in enumerate(grids):
        sums = _sliced(grid, maps[scale], options, scale, scratch)
        if scale + 1 < len(grids):
            share = np.clip(maps[len(grids) + scale], 0, 1, out=scratch.array("share", shape))
            np.multiply(rest, share, out=factor)
            rest -= factor
        else:
            np.copyto(factor, rest)
        found = cv2.extractChannel(sums, 3, dst=scratch.array("weight", shape))
        factor /= np.maximum(found, _EMPTY, out=found)
        cv2.accumulateProduct(sums, _four_times(factor, scratch), total)
    return total


def _sliced(
    grid: np.ndarray, guide: np.ndarray, options: BilateralGrids, scale: int, scratch: Scratch
) -> np.ndarray:
    """Numerators and, last, the denominator of eq. 13, ``(h, w, 4)``; the grid is overwritten."""
    # from sums to means, and 1 where a cell is not empty: empty ones have sums of exactly 0
    flat = grid.reshape(-1, grid.shape[2], 4)
    filled = cv2.extractChannel(flat, 3, dst=scratch.array("filled", flat.shape[:2]))
    np.reciprocal(np.maximum(filled, _EMPTY, out=filled), out=filled)
    flat *= _four_times(filled, scratch)
    fine = grid
    for step in range(scale):
        rows, columns = (2 * size - 1 for size in fine.shape[:2])
        coarse, fine = fine, scratch.array(f"fine {step}", (rows, columns, *grid.shape[2:]))
        _finer(coarse, fine)
    cells = _as_one(fine).reshape(-1)
    at, far = _places(guide, fine.shape, options, scale, scratch)
    deep, near = (scratch.array(name, far.shape) for name in ("deep light", "near light"))
    deep.fill(0)
    near.fill(0)
    found = scratch.array("found", (at[0, 0].size, 4))
    for phase, weight, offset in _corners(fine.shape, options.spacing):
        index = at[phase].reshape(-1)
        for deeper, part in enumerate((near, deep)):
            np.take(cells[offset + deeper :], index, out=_as_one(found), mode="clip")
            sums = part[phase].reshape(-1, 4)
            cv2.scaleAdd(found, weight, sums, dst=sums)
    deep *= far
    near *= np.subtract(1, far, out=far)
    near += deep
    sums = scratch.array("sums", (*guide.shape, 4))
    _from_phases(_as_one(near), _as_one(sums))
    return sums


def _light(mean: np.ndarray, options: BilateralGrids, scratch: Scratch) -> np.ndarray:
    """Irradiance times its weight, and the weight: ``(h, w, 4)``."""
    weights = scratch.array("weights", mean.shape)
    light = scratch.array("light", mean.shape)
    if not options.weigh_samples:
        np.copyto(light, mean)
        light[..., 3] = 1
        return light
    samples = cv2.extractChannel(mean, 3)
    cv2.merge([samples, samples, samples, np.ones_like(samples)], dst=weights)
    return np.multiply(mean, weights, out=light)


def _fine(grid: np.ndarray, scale: int, scratch: Scratch) -> np.ndarray:
    """A grid of the same depth at the finest spacing; the grid itself at scale 0."""
    if scale == 0:
        return grid
    rows, columns = (((size - 1) << scale) + 1 for size in grid.shape[:2])
    return scratch.array("fine", (rows, columns, *grid.shape[2:]))


def _places(
    guide: np.ndarray, cells: tuple[int, ...], options: BilateralGrids, scale: int, scratch: Scratch
) -> tuple[np.ndarray, np.ndarray]:
    """Where pixels lie in a grid (eq. 12).

    Parameters
    ----------
    guide : (h, w) float32
    cells
        Shape of the grid at the finest spacing.

    Returns
    -------
    at : (s, s, rows, columns) intp
        Flat index of the first of the eight cells around each pixel: blocks of s x s pixels, by
        the pixel's place in its block.
    far : (s, s, rows, columns, 4) float32
        How far the pixel is on its way to the next cell in depth, [0, 1], four times.
    """
    rows, columns, depth = cells[0] - 1, cells[1] - 1, cells[2]
    shape = (options.spacing, options.spacing, rows, columns)
    position, floor = scratch.array("position", shape), scratch.array("floor", shape)
    _by_phase(guide, position)
    np.clip(position, 0, 1, out=position)
    position *= np.float32(GUIDE_RANGE / (options.depth_spacing * 2**scale))
    np.floor(position, out=floor)
    np.minimum(floor, np.float32(depth - 2), out=floor)
    position -= floor
    at = scratch.array("at", shape, np.intp)
    np.copyto(at, floor, casting="unsafe")
    at += (np.arange(rows)[:, None] * cells[1] + np.arange(columns)) * depth
    return at, _four_times(position, scratch)


def _corners(cells: tuple[int, ...], spacing: int) -> Iterator[tuple[tuple[int, int], float, int]]:
    """Of every place in a block: weights and offsets of the cells around it, in the plane."""
    steps = [[(1 - place / spacing, 0), (place / spacing, 1)] for place in range(spacing)]
    for phase in np.ndindex(spacing, spacing):
        for weight_y, down in steps[phase[0]]:
            for weight_x, across in steps[phase[1]]:
                if weight_y and weight_x:
                    yield phase, weight_y * weight_x, (down * cells[1] + across) * cells[2]


def _by_phase(image: np.ndarray, out: np.ndarray) -> None:
    """``(h, w)`` into ``(s, s, rows, columns)``, padded with zeros."""
    out.fill(0)
    for down, across in np.ndindex(out.shape[:2]):
        part = image[down :: out.shape[0], across :: out.shape[1]]
        out[down, across, : part.shape[0], : part.shape[1]] = part


def _from_phases(phases: np.ndarray, out: np.ndarray) -> None:
    """`_by_phase` undone."""
    for down, across in np.ndindex(phases.shape[:2]):
        part = out[down :: phases.shape[0], across :: phases.shape[1]]
        part[...] = phases[down, across, : part.shape[0], : part.shape[1]]


def _coarser(fine: np.ndarray, scratch: Scratch) -> np.ndarray:
    """Sums at twice the spacing: a tent over the cells."""
    half = np.multiply(fine[1::2], _HALF, out=scratch.array("half rows", fine[1::2].shape))
    rows = fine[::2]
    rows[:-1] += half
    rows[1:] += half
    half = np.multiply(rows[:, 1::2], _HALF, out=scratch.array("half", rows[:, 1::2].shape))
    cells = rows[:, ::2]
    cells[:, :-1] += half
    cells[:, 1:] += half
    return cells


def _finer(coarse: np.ndarray, fine: np.ndarray) -> None:
    """Values at half the spacing, between the cells."""
    rows = fine[::2]
    rows[:, ::2] = coarse
    np.add(coarse[:, :-1], coarse[:, 1:], out=rows[:, 1::2])
    rows[:, 1::2] *= _HALF
    np.add(rows[:-1], rows[1:], out=fine[1::2])
    fine[1::2] *= _HALF


def _four_times(plane: np.ndarray, scratch: Scratch) -> np.ndarray:
    """The same value for each channel: ``(..., 4)``."""
    out = scratch.array("four", (*plane.shape, 4))
    flat = plane.reshape(-1, plane.shape[-1])
    cv2.merge([flat] * 4, dst=out.reshape(*flat.shape, 4))
    return out


def _as_one(image: np.ndarray) -> np.ndarray:
    """``(..., 4)`` float32 as ``(...)`` elements of four channels."""
    return image.view(_FOUR)[..., 0]

"""Reconstruction with bilateral grids (Meng et al. 2020, sections 4.2, 4.3 and 4.5).

Pixels are splatted into a grid at the place that their guide says, and read from it at the same
place: light spreads among pixels that are near and alike. Every result is a weighted mean of
irradiance, so no light is invented.

differs: a grid has all the cells that a tent can reach; eq. 8 has one too few at odd ends. A cell
is empty if nothing was splatted into it; eq. 13 takes a black one for empty. The last blend weight
is what the others leave of 1, each taking its share of the rest: never negative, where
``1 - w0 - w1`` can be; the price is that scales cannot be set off against each other to sharpen.

A grid is made and read one row of blocks at a time, between two rows of cells. Pixels are splatted
along x and depth into a slab of their own row, where those of one phase, one from each block, never
meet in a cell: that is plain indexing, without the slow additions at equal places. Along y the
slabs are then added up by the tent; and back the same way.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import cv2
import numpy as np

from stillray.arrays.bounds import at_least, at_most
from stillray.arrays.strips import Strips
from stillray.arrays.workspace import Workspace
from stillray.families.temporal_kernels import Looks, TemporalKernels
from stillray.model_spec.decoders import BilateralGrids
from stillray.model_spec.loader import ModelSpec
from stillray.stages.state import Filterable
from stillray.timing import timed

#: Values of a guide, of which the paper has as many as an 8-bit image.
GUIDE_RANGE = 255.0
# Weight of a cell, in samples, below which it is empty: far below the least sample's least corner.
_EMPTY = np.float32(1e-30)
# Four float32 channels of a pixel or a cell as one element, which NumPy moves at once.
_FOUR = np.complex128


def grid_cells(
    height: int, width: int, options: BilateralGrids, scale: int
) -> tuple[int, int, int]:
    """Rows, columns and depth of a grid, 0 being the finest scale."""
    spacing = options.spacing << scale
    depth = math.ceil(GUIDE_RANGE / (options.depth_spacing * 2**scale)) + 1
    # no quotients of negative numbers here: an exported graph rounds those the other way
    return (height - 1) // spacing + 2, (width - 1) // spacing + 2, depth


class BilateralGridModel(TemporalKernels):
    """A model of the family ``bilateral-grids``."""

    def __init__(self, spec: ModelSpec) -> None:
        assert isinstance(spec.decoder, BilateralGrids)
        self._options, count = spec.decoder, spec.decoder.grids
        self.method = "a bilateral grid" if count == 1 else f"{count} bilateral grids"
        self.cost = _cost(spec.decoder)
        # two pixels that share a cell; the depth of cells is that of the whole frame
        looks = Looks(reach=2 * (_unit(spec.decoder) - 1), receptive_field=None)
        super().__init__(spec, looks)

    def reconstruct(
        self,
        light: Filterable,
        outputs: Sequence[np.ndarray],
        strips: Strips,
        timings: dict[str, float],
    ) -> np.ndarray:
        """Filter and remodulate, see `TemporalKernels`."""
        (maps,) = outputs
        with timed(timings, "reconstruct"):
            image = filter_grids(light.mean, maps, self._options, strips)
        if (by := light.remodulation_albedo) is not None:

            def modulate(rows: slice) -> None:
                image[rows] *= by[rows]

            with timed(timings, "remodulate"):
                strips.run(modulate, *image.shape[:2])
        return image


def _cost(options: BilateralGrids) -> tuple[float, float]:
    """Operations and planes moved, a pixel."""
    operations, planes = 3.0, 4.0 + 3.0  # modulated; light and image
    for scale in range(options.grids):
        spacing = options.spacing << scale
        cells = grid_cells(1, 1, options, scale)[2] / spacing  # of a slab, a pixel
        corners = 2 * (2 - 1 / spacing)  # those beside a pixel in its row's slab, one depth or two
        # splatted, added up; interpolated, read; guide, two depths, share and blend of each channel
        operations += 2 * (corners * 4 * 2) + cells * 4 * (4 + 3) + 10 + 4 * 8
        planes += 2 * (1 + 4 + 4 * cells) + 1
    return operations, planes


def filter_grids(
    mean: np.ndarray,
    maps: np.ndarray,
    options: BilateralGrids,
    strips: Strips,
) -> np.ndarray:
    """Splat a frame into its grids, slice them and blend.

    Parameters
    ----------
    mean : (h, w, 4) float32
        Irradiance, >= 0 and finite; and the samples that each pixel holds, >= 0, which it is
        splatted by when the options say so.
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
        A convex combination of irradiance within `reach`; 0 where no pixel around counts.
    """
    if any(_has_nan(plane, strips) for plane in maps):
        maps = np.nan_to_num(maps, nan=0.5)
    height, width = mean.shape[:2]
    unit = _unit(options)
    # strips of whole cells of the coarsest grid
    units = -(-height // unit), unit * width
    grids = [
        _Grid(maps[scale], options, scale, strips.of(*units), strips.workspace)
        for scale in range(options.grids)
    ]

    def construct(rows: slice) -> None:
        own, workspace = slice(rows.start * unit, min(rows.stop * unit, height)), strips.workspace
        light = _light(mean[own], options, workspace)
        for grid in grids:
            grid.construct(rows, light, maps[grid.scale, own], workspace)

    strips.run(construct, *units)
    for grid in grids:  # in order: the same sums for any number of threads
        for above, below in pairwise(grid.parts.values()):
            above[-1] += below[0]
            np.copyto(below[0], above[-1])
    image = np.empty((height, width, 3), np.float32)

    def read(rows: slice) -> None:
        own = slice(rows.start * unit, min(rows.stop * unit, height))
        light = _blended(grids, rows, maps[:, own], strips.workspace)
        np.copyto(image[own], light[..., :3])

    strips.run(read, *units)
    return image


def _has_nan(plane: np.ndarray, strips: Strips) -> bool:
    strips.watch.look()
    return bool(np.isnan(plane.max()))


def _unit(options: BilateralGrids) -> int:
    """Spacing of the coarsest grid, pixels."""
    return options.spacing << (options.grids - 1)


class _Grid:
    """One grid of a frame, in parts: one a strip.

    Parameters
    ----------
    grid_guide : (h, w) float32
    options, scale
        Of the grid.
    bounds
        The strips, in units of the coarsest spacing.
    workspace
        Where the cells lie.
    """

    def __init__(
        self,
        grid_guide: np.ndarray,
        options: BilateralGrids,
        scale: int,
        bounds: list[slice],
        workspace: Workspace,
    ) -> None:
        self.scale, self.spacing = scale, options.spacing << scale
        height, width = grid_guide.shape
        _, columns, depth = grid_cells(height, width, options, scale)
        self._rate = np.float32(GUIDE_RANGE / (options.depth_spacing * 2**scale))
        self._last = np.float32(depth - 2)  # the deepest cell that is the first of two
        # only the depths between the least and the greatest grid_guide are kept
        self._first, deepest = (int(self._floor(edge)) for edge in cv2.minMaxLoc(grid_guide)[:2])
        self._cells = (columns, deepest - self._first + 2, 4)
        # neighbours share a row of cells, of which each has its own
        per_unit = _unit(options) // self.spacing
        ends = [0]
        for rows in bounds:
            ends.append(ends[-1] + (rows.stop - rows.start) * per_unit + 1)
        whole = workspace.array(f"grid {scale}", (ends[-1], *self._cells))
        #: Cells by the start of the strip, ``(rows, columns, depth, 4)``.
        self.parts = {
            rows.start: whole[start:stop]
            for rows, (start, stop) in zip(bounds, pairwise(ends), strict=True)
        }

    def _floor(self, grid_guide: float) -> np.float32:
        place = np.float32(min(max(grid_guide, 0), 1)) * self._rate
        return np.minimum(np.floor(place), self._last)

    def construct(
        self, rows: slice, light: np.ndarray, grid_guide: np.ndarray, workspace: Workspace
    ) -> None:
        """Splat a strip: the sums of eq. 10, before their division.

        Parameters
        ----------
        rows
            The strip.
        light : (h, w, 4) float32
            Weighted irradiance, and the weights.
        grid_guide : (h, w) float32
        """
        part = self.parts[rows.start]
        part.fill(0)
        at, far = self._places(grid_guide, workspace)
        near, deep = (workspace.array(name, far.shape) for name in ("near", "deep"))
        self._by_phase(_as_one(light), _as_one(near))
        np.multiply(near, far, out=deep)
        near *= np.subtract(1, far, out=far)
        slabs = workspace.array("slabs", (self.spacing, *self._cells))
        cells = _as_one(slabs).reshape(-1)
        flat, flat_slabs = (rows.reshape(*rows.shape[:2], -1) for rows in (part, slabs))
        found = workspace.array("found", (self.spacing * at.shape[2], 4))
        found_as_one = _as_one(found)
        for block in range(at.shape[1] // self.spacing):
            own = slice(block * self.spacing, (block + 1) * self.spacing)
            slabs.fill(0)
            for phase, weight, offset in self._sides():
                index = at[phase, own].reshape(-1)
                for deeper, splats in enumerate((near, deep)):
                    here = cells[offset + deeper :]
                    here.take(index, 0, found_as_one, "clip")
                    cv2.scaleAdd(splats[phase, own].reshape(-1, 4), weight, found, dst=found)
                    here[index] = found_as_one
            above, under = flat[block], flat[block + 1]
            for row, slab in enumerate(flat_slabs):
                cv2.scaleAdd(slab, 1 - row / self.spacing, above, dst=above)
                if row:
                    cv2.scaleAdd(slab, row / self.spacing, under, dst=under)

    def read(self, rows: slice, grid_guide: np.ndarray, workspace: Workspace) -> np.ndarray:
        """Numerators and, last, the denominator of eq. 13; the strip's cells are overwritten.

        Parameters
        ----------
        rows
            The strip.
        grid_guide : (h, w) float32

        Returns
        -------
        (h, w, 4) float32
        """
        part = self.parts[rows.start]
        # from sums to means, and 1 where a cell is not empty: empty ones have sums of exactly 0
        columns = part.reshape(-1, *part.shape[2:])
        filled = cv2.extractChannel(columns, 3, dst=workspace.array("filled", columns.shape[:2]))
        np.reciprocal(at_least(filled, _EMPTY, out=filled), out=filled)
        columns *= _four_times(filled, workspace)
        at, far = self._places(grid_guide, workspace)
        near, deep = (workspace.array(name, far.shape) for name in ("near", "deep"))
        near.fill(0)
        deep.fill(0)
        slabs = workspace.array("slabs", (self.spacing, *self._cells))
        cells = _as_one(slabs).reshape(-1)
        flat, flat_slabs = (rows.reshape(*rows.shape[:2], -1) for rows in (part, slabs))
        found = workspace.array("found", (self.spacing * at.shape[2], 4))
        found_as_one = _as_one(found)
        for block in range(at.shape[1] // self.spacing):
            own = slice(block * self.spacing, (block + 1) * self.spacing)
            above, under = flat[block], flat[block + 1]
            for row, slab in enumerate(flat_slabs):
                below = row / self.spacing
                cv2.addWeighted(above, 1 - below, under, below, 0, dst=slab)
            for phase, weight, offset in self._sides():
                index = at[phase, own].reshape(-1)
                for deeper, light in enumerate((near, deep)):
                    cells[offset + deeper :].take(index, 0, found_as_one, "clip")
                    sums = light[phase, own].reshape(-1, 4)
                    cv2.scaleAdd(found, weight, sums, dst=sums)
        deep *= far
        near *= np.subtract(1, far, out=far)
        near += deep
        sums = workspace.array("sums", (*grid_guide.shape, 4))
        for phase, light in enumerate(_as_one(near)):
            target = _as_one(sums)[:, phase :: self.spacing]
            target[...] = light[: target.shape[0], : target.shape[1]]
        return sums

    def _places(
        self, grid_guide: np.ndarray, workspace: Workspace
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where the pixels of a strip lie in the slabs of their rows (eq. 12).

        Returns
        -------
        at : (s, rows, columns) intp
            Flat index of the first of the four cells around each pixel of blocks of s columns, by
            the pixel's place in its block.
        far : (s, rows, columns, 4) float32
            How far the pixel is on its way to the next cell in depth, [0, 1], four times.
        """
        columns, depth, _ = self._cells
        shape = (self.spacing, -(-len(grid_guide) // self.spacing) * self.spacing, columns - 1)
        place, floor = workspace.array("place", shape), workspace.array("floor", shape)
        self._by_phase(grid_guide, place)
        np.clip(place, 0, 1, out=place)
        place *= self._rate
        np.floor(place, out=floor)
        at_most(floor, self._last, out=floor)
        place -= floor
        # pixels beyond the frame count nothing, but need a place
        at_least(floor, self._first, out=floor)
        at = workspace.array("at", shape, np.intp)
        np.copyto(at, floor, casting="unsafe")
        row = np.arange(shape[1])[:, None] % self.spacing
        at += (row * columns + np.arange(columns - 1)) * depth - self._first
        return at, _four_times(place, workspace)

    def _sides(self) -> Iterator[tuple[int, float, int]]:
        """Of every place in a block: weights and offsets of the cells to its left and right."""
        for phase in range(self.spacing):
            yield phase, 1 - phase / self.spacing, 0
            if phase:
                yield phase, phase / self.spacing, self._cells[1]

    def _by_phase(self, image: np.ndarray, out: np.ndarray) -> None:
        """``(h, w)`` into ``(s, rows, columns)``, padded with zeros."""
        out.fill(0)
        for phase, target in enumerate(out):
            part = image[:, phase :: self.spacing]
            target[: part.shape[0], : part.shape[1]] = part


def _blended(
    grids: Sequence[_Grid], rows: slice, maps: np.ndarray, workspace: Workspace
) -> np.ndarray:
    """The grids' strips, divided (eq. 13) and weighed (eq. 15): ``(h, w, 4)``, the last is 1."""
    shape = maps.shape[1:]
    total = workspace.array("total", (*shape, 4))
    total.fill(0)
    factor, rest = workspace.array("factor", shape), workspace.array("rest", shape)
    rest.fill(1)
    for grid in grids:
        sums = grid.read(rows, maps[grid.scale], workspace)
        if grid is grids[-1]:
            np.copyto(factor, rest)
        else:
            share = maps[len(grids) + grid.scale]
            np.multiply(rest, np.clip(share, 0, 1, out=factor), out=factor)
            rest -= factor
        found = cv2.extractChannel(sums, 3, dst=workspace.array("weight", shape))
        factor /= at_least(found, _EMPTY, out=found)
        cv2.accumulateProduct(sums, _four_times(factor, workspace), total)
    return total


def _light(mean: np.ndarray, options: BilateralGrids, workspace: Workspace) -> np.ndarray:
    """Irradiance times its weight, and the weight: ``(h, w, 4)``."""
    weights = workspace.array("weights", mean.shape)
    light = workspace.array("light", mean.shape)
    if not options.weigh_samples:
        np.copyto(light, mean)
        light[..., 3] = 1
        return light
    samples = cv2.extractChannel(mean, 3)
    cv2.merge([samples, samples, samples, np.ones_like(samples)], dst=weights)
    return np.multiply(mean, weights, out=light)


def _four_times(plane: np.ndarray, workspace: Workspace) -> np.ndarray:
    """The same value for each channel: ``(..., 4)``."""
    out = workspace.array("four", (*plane.shape, 4))
    flat = plane.reshape(-1, plane.shape[-1])
    cv2.merge([flat] * 4, dst=out.reshape(*flat.shape, 4))
    return out


def _as_one(image: np.ndarray) -> np.ndarray:
    """``(..., 4)`` float32 as ``(...)`` elements of four channels."""
    return image.view(_FOUR)[..., 0]

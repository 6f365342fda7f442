"""Frames in tiles, so that the network and the reconstruction fit into a given memory.

What is global to a frame is found on the whole frame: exposure, the unit of depth, the past at
each pixel. Only what takes most of the memory is done a tile at a time: features, network and
reconstruction. A tile overlaps its neighbours by all that a pixel can see, and begins where the
coarsest level of a pyramid does, so that its pixels are those of the whole frame but for rounding.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray.families.registry import FAMILIES
from stillray.model_spec.loader import ModelSpec
from stillray.stages.prepare import Prepared

#: Bytes of a process that has loaded a model and denoised nothing; measured, rounded up.
BASE_BYTES = 300 << 20
#: Bytes a pixel of the whole frame: the floor under any bound. It holds the buffers of the frame
#: in work, of the next and of the last, history, what is prepared, and the picture on its way out.
#: The peak of whole runs over 12 channels of 1280 x 720, less the model and its tile, was 210 with
#: wskp-3 and 270 with kpyr-5, which also remembers its output; 50 more for the accumulated albedo;
#: rounded up.
FRAME_BYTES = 380
#: Bytes a pixel of a tile: features, network and reconstruction; 840 measured for kpyr-5, 410 for
#: wskp-3, rounded up.
TILE_BYTES = 900
_LEAST_INNER = 64  # pixels, and no less than the overlap: smaller tiles would be little else
_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}


@dataclass(frozen=True)
class Tile:
    """A part of a frame, as ``(rows, columns)``.

    Attributes
    ----------
    inner
        Pixels that the tile gives.
    outer
        Pixels that it sees.
    """

    inner: tuple[slice, slice]
    outer: tuple[slice, slice]

    @property
    def within(self) -> tuple[slice, slice]:
        """Where the inner pixels lie among the outer."""
        rows, columns = (
            slice(inner.start - outer.start, inner.stop - outer.start)
            for inner, outer in zip(self.inner, self.outer, strict=True)
        )
        return rows, columns


def parse_memory(text: str) -> int:
    """Bytes of ``2G``, ``1.5G``, ``800M`` (powers of 1024).

    Raises
    ------
    InputError
        The text is no such amount.
    """
    hit = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?", text.strip(), re.IGNORECASE)
    if hit is None:
        raise InputError(f"max-memory must be an amount such as 2G or 800M, got {text}")
    return int(float(hit[1]) * _UNITS[hit[2].upper()])


def tiles_of(shape: tuple[int, int], size: int, halo: int, multiple: int) -> list[Tile]:
    """The tiles of a frame, from the top left.

    Parameters
    ----------
    shape
        Height and width, pixels.
    size
        Height and width of a tile with its overlap, at most.
    halo
        Overlap to each side, a multiple of ``multiple``.
    multiple
        What tiles begin at multiples of.
    """
    step = max((size - 2 * halo) // multiple * multiple, multiple)

    def along(extent: int) -> list[tuple[slice, slice]]:
        if extent <= size:
            return [(slice(0, extent), slice(0, extent))]
        return [
            (
                slice(start, min(start + step, extent)),
                slice(max(start - halo, 0), min(start + step + halo, extent)),
            )
            for start in range(0, extent, step)
        ]

    return [
        Tile(inner=(row, column), outer=(around_row, around_column))
        for row, around_row in along(shape[0])
        for column, around_column in along(shape[1])
    ]


def plan_tiles(shape: tuple[int, int], spec: ModelSpec, max_memory: int | None) -> list[Tile]:
    """The largest tiles with which a process stays below a memory.

    Parameters
    ----------
    shape
        Height and width, pixels.
    spec
        The model's.
    max_memory
        Bytes; None for one tile of the whole frame.

    Raises
    ------
    InputError
        The memory does not hold the buffers of the whole frame and one small tile.
    """
    height, width = shape
    multiple = FAMILIES[spec.family].multiple(spec)
    if max_memory is None:
        return tiles_of(shape, max(shape), 0, multiple)
    halo = overlap(spec)
    fixed = BASE_BYTES + FRAME_BYTES * height * width
    least = min(max(_LEAST_INNER, halo) + 2 * halo, max(shape))
    needed = fixed + TILE_BYTES * min(least, height) * min(least, width)
    if max_memory < needed:
        raise InputError(
            f"max-memory must be {needed / _UNITS['M']:.0f}M or more for {width} x {height} "
            f"pixels with {spec.name}, got {max_memory / _UNITS['M']:.0f}M"
        )
    pixels = (max_memory - fixed) // TILE_BYTES
    if pixels >= height * width:
        return tiles_of(shape, max(shape), halo, multiple)
    return tiles_of(shape, max(int(pixels**0.5), least), halo, multiple)


def overlap(spec: ModelSpec) -> int:
    """Pixels that a pixel of the result can see, to each side, rounded up to whole blocks.

    Raises
    ------
    InputError
        The family cannot be cut into tiles.
    """
    family = FAMILIES[spec.family]
    if family.receptive_field is None:
        raise InputError(f"max-memory must not be given with the family {spec.family}")
    multiple = family.multiple(spec)
    sees = family.reach(spec) + family.receptive_field(spec)
    return -(-sees // multiple) * multiple


def crop(prepared: Prepared, tile: Tile) -> Prepared:
    """The part of a prepared frame that a tile sees, in arrays of its own."""

    def cut(value: Any) -> Any:
        if isinstance(value, np.ndarray) and value.ndim >= 2:
            return np.ascontiguousarray(value[tile.outer])
        return value

    values: dict[str, Any] = {f.name: cut(getattr(prepared, f.name)) for f in fields(prepared)}
    if prepared.sample is not None:
        values["sample"] = np.ascontiguousarray(prepared.sample[:, *tile.outer])
    past = prepared.history
    values["history"] = replace(past, mean=cut(past.mean), guides=None)
    return replace(prepared, **values)

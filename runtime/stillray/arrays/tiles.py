"""Frames in overlapping tiles."""

from __future__ import annotations

from dataclasses import dataclass


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

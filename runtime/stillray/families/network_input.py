"""What a network is given, made a strip at a time: planes of numbers, or pixels in steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from stillray.arrays.extend import mirrored
from stillray.arrays.strips import Strips
from stillray.arrays.workspace import Workspace
from stillray.families.contract import Engine
from stillray.models.steps import Column, in_steps


class NetworkInput:
    """The input of an engine's network, of its kind.

    Parameters
    ----------
    engine
        What will run the network: its ``feature_columns``, if it has any, say what that takes.
    count
        Planes.
    full
        Height and width, of the network's alignment.
    workspace
        Where the input lies.
    strips
        In whose workspaces strips are made.

    Attributes
    ----------
    array
        ``(1, planes, H, W)`` float32, or ``(1, H, W, planes)`` uint8.
    """

    def __init__(
        self,
        engine: Engine,
        count: int,
        full: tuple[int, int],
        workspace: Workspace,
        strips: Strips,
    ) -> None:
        self._columns: tuple[Column, ...] | None = getattr(engine, "feature_columns", None)
        self._count, self._strips = count, strips
        if self._columns is None:
            self.array = workspace.array("features", (1, count, *full))
        else:
            self.array = workspace.array("features in steps", (1, *full, count), np.uint8)

    def fill(self, rows: slice, width: int, write: Callable[[np.ndarray], None]) -> None:
        """Fill some rows of the left ``width`` columns.

        Parameters
        ----------
        rows, width
            Pixels.
        write
            Writes the planes, ``(planes, rows, width)`` float32, where it is told.
        """
        if self._columns is None:
            write(self.array[0, :, rows, :width])
            return
        workspace, shape = self._strips.workspace, (rows.stop - rows.start, width)
        planes = workspace.array("planes of a strip", (self._count, *shape))
        write(planes)
        target = self.array[0, rows, :width]
        if target.flags.c_contiguous:
            in_steps(planes, self._columns, target, workspace)
        else:
            pixels = workspace.array("pixels of a strip", (*shape, self._count), np.uint8)
            target[...] = in_steps(planes, self._columns, pixels, workspace)

    def put(self, rows: slice, planes: Sequence[np.ndarray]) -> None:
        """Fill some rows, of the whole width, with planes ``(rows, W)`` float32 that lie apart."""
        if self._columns is None:
            for plane, target in zip(planes, self.array[0], strict=True):
                target[rows] = plane
            return
        in_steps(planes, self._columns, self.array[0, rows], self._strips.workspace)

    def mirror(self, height: int, width: int) -> None:
        """Carry on what was filled by its mirror image: the outputs are for light that is."""
        rows, columns = (1, 2) if self._columns is not None else (2, 3)
        found = np.moveaxis(self.array, (rows, columns), (0, 1))
        for at, place in enumerate(mirrored(width, found.shape[1])[width:], start=width):
            found[:height, at] = found[:height, place]
        for at, place in enumerate(mirrored(height, found.shape[0])[height:], start=height):
            found[at] = found[place]

"""What a network is given, made a strip at a time: planes of numbers, or pixels in steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from stillray.arrays.extend import mirrored
from stillray.arrays.strips import Strips
from stillray.arrays.workspace import Workspace
from stillray.families.contract import Engine
from stillray.models.steps import PixelLayout, in_steps


class NetworkInput:
    """The input of an engine's network, of its kind.

    Parameters
    ----------
    engine
        What will run the network: its ``feature_layout``, if it has any, says what that takes.
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
        ``(1, planes, H, W)`` float32, or ``(1, H, W, integers of a pixel)`` uint8.
    """

    def __init__(
        self,
        engine: Engine,
        count: int,
        full: tuple[int, int],
        workspace: Workspace,
        strips: Strips,
    ) -> None:
        self._layout: PixelLayout | None = getattr(engine, "feature_layout", None)
        self._count, self._strips = count, strips
        if self._layout is None:
            self.array = workspace.array("features", (1, count, *full))
        else:
            shape = (1, *full, self._layout.size)
            self.array = workspace.array("features in steps", shape, np.uint8)

    def fill(self, rows: slice, width: int, write: Callable[[np.ndarray], None]) -> None:
        """Fill some rows of the left ``width`` columns.

        Parameters
        ----------
        rows, width
            Pixels.
        write
            Writes the planes, ``(planes, rows, width)`` float32, where it is told.
        """
        if self._layout is None:
            write(self.array[0, :, rows, :width])
            return
        workspace, shape = self._strips.workspace, (rows.stop - rows.start, width)
        planes = workspace.array("planes of a strip", (self._count, *shape))
        write(planes)
        target = self.array[0, rows, :width]
        if target.flags.c_contiguous:
            in_steps(planes, self._layout, target, workspace)
        else:
            pixels = workspace.array("pixels of a strip", (*shape, self._layout.size), np.uint8)
            target[...] = in_steps(planes, self._layout, pixels, workspace)

    def put(self, rows: slice, planes: Sequence[np.ndarray]) -> None:
        """Fill some rows, of the whole width, with planes ``(rows, W)`` float32 that lie apart."""
        if self._layout is None:
            for plane, target in zip(planes, self.array[0], strict=True):
                target[rows] = plane
            return
        in_steps(planes, self._layout, self.array[0, rows], self._strips.workspace)

    def mirror(self, height: int, width: int) -> None:
        """Carry on what was filled by its mirror image: the outputs are for light that is."""
        rows, columns = (1, 2) if self._layout is not None else (2, 3)
        found = np.moveaxis(self.array, (rows, columns), (0, 1))
        for at, place in enumerate(mirrored(width, found.shape[1])[width:], start=width):
            found[:height, at] = found[:height, place]
        for at, place in enumerate(mirrored(height, found.shape[0])[height:], start=height):
            found[at] = found[place]

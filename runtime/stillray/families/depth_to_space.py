"""Logits that a network gave by blocks of 2x2 pixels."""

from __future__ import annotations

import copy

import cv2
import numpy as np

from stillray.arrays.strips import Strips


class DepthToSpace:
    """Maps of pixels, of which the network gave four smaller ones each, read as if it had not.

    They are interleaved a strip at a time, where they are used: done by the network, every map
    would be written and read once more.

    Parameters
    ----------
    blocks : (4 planes, H, W) float32 or uint8
        Four planes for each: of the top left pixels of 2x2 blocks, the top right, the bottom left,
        the bottom right.
    strips
        Where what is read lies, until the same planes are read again.

    Attributes
    ----------
    shape
        Of the maps: ``(planes, 2 H, 2 W)``.
    """

    def __init__(self, blocks: np.ndarray, strips: Strips) -> None:
        count, height, width = blocks.shape
        self._blocks = blocks.reshape(count // 4, 2, 2, height, width)
        self._strips = strips
        self._top = 0
        self.shape = (count // 4, 2 * height, 2 * width)

    def __len__(self) -> int:
        """The number of planes."""
        return self.shape[0]

    def near(self, rows: slice, width: int) -> DepthToSpace:
        """A window of the maps: those rows, and columns up to ``width``."""
        window = copy.copy(self)
        window._top += rows.start
        window.shape = (self.shape[0], rows.stop - rows.start, width)
        return window

    def __getitem__(self, at: tuple[int | slice, slice]) -> np.ndarray:
        """One plane, or some, and rows: ``(rows, w)`` or ``(planes, rows, w)``.

        A plane of its own lies where any other one did.
        """
        part, rows = at
        if isinstance(part, slice):
            return self._read(part, rows, f"planes {part.start} to {part.stop}")
        plane: np.ndarray = self._read(slice(part, part + 1), rows, "plane")[0]
        return plane

    def _read(self, part: slice, rows: slice, name: str) -> np.ndarray:
        top, bottom = self._top + rows.start, self._top + rows.stop
        blocks = self._blocks[part, ..., top // 2 : -(-bottom // 2), :]
        count, _, _, height, width = blocks.shape
        shape = (count, height, 2, width, 2)
        # networks in integers and in floats may take turns
        dtype = self._blocks.dtype.type
        whole = self._strips.workspace.array(f"{name}, {dtype.__name__}", shape, dtype)
        for plane, of_plane in zip(whole, blocks, strict=True):
            for line, pair in enumerate(of_plane):
                cv2.merge(list(pair), dst=plane[:, line])
        lines: np.ndarray = whole.reshape(count, 2 * height, 2 * width)
        return lines[:, top % 2 : top % 2 + bottom - top, : self.shape[2]]

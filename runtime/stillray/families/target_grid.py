"""The pixels of an enlarged picture: whose sample each of them takes, and where it was before."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.strips import Strips
from stillray.stages.motion_dilation import dilate_motion
from stillray.stages.reproject import positions_of


@dataclass(frozen=True, eq=False)
class Grid:
    """The picture's pixels on those of a frame, for one jitter.

    A frame's sample of pixel ``i`` lies at ``i + 0.5 + jitter``, in pixels of the frame; a pixel
    of the picture takes the nearest (Kazmierczyk et al. 2025, section 3.2).

    Attributes
    ----------
    shape
        Height and width of the picture.
    full
        The same, rounded up to what the network takes; what is beyond repeats the border.
    scale
        Pixels of the picture for one of the frame, along each axis.
    rows : (full height,) intp
        Row of the frame that a row of the picture takes.
    columns : (full width,) intp
    down, right : (full height,), (full width,) float32
        How far below and to the right of a pixel's centre its sample lies, pixels of the picture.
    """

    shape: tuple[int, int]
    full: tuple[int, int]
    scale: int
    rows: np.ndarray
    columns: np.ndarray
    down: np.ndarray
    right: np.ndarray

    @classmethod
    def of(
        cls, frame: tuple[int, int], scale: int, multiple: int, jitter: np.ndarray | None
    ) -> Grid:
        """The grid over a frame of a height and width.

        Parameters
        ----------
        frame
            Height and width, pixels.
        scale
            Of the picture.
        multiple
            What height and width of the network's input must be multiples of.
        jitter : (2,) or None
            As `stillray.Frame` has it; None: samples lie at the centres of their pixels.
        """
        x, y = (0.0, 0.0) if jitter is None else map(float, jitter)
        rows, down, high = _axis(frame[0], scale, multiple, y)
        columns, right, wide = _axis(frame[1], scale, multiple, x)
        shape = (frame[0] * scale, frame[1] * scale)
        return cls(shape, (high, wide), scale, rows, columns, down, right)

    def take(self, image: np.ndarray, rows: slice) -> np.ndarray:
        """Rows of the picture, ``(rows, full width, ...)``, of an image of the frame."""
        return np.take(image[self.rows[rows]], self.columns, axis=1)

    def taken(self, image: np.ndarray, strips: Strips, out: np.ndarray) -> np.ndarray:
        """`take` of all rows of the picture: written to ``out``, which is returned."""

        def work(rows: slice) -> None:
            out[rows] = self.take(image, rows)

        strips.run(work, *self.full)
        return out

    def past_positions(self, motion: np.ndarray, rows: slice) -> tuple[np.ndarray, np.ndarray]:
        """Where pixels of some rows were in the last picture, and whether that is in it.

        Parameters
        ----------
        motion : (h, w, 2) float32
            Of the frame, pixels of the frame, finite; see `dilated`.
        rows
            Of the picture.

        Returns
        -------
        positions : (rows, full width, 2) float32
            x and y, pixels of the picture, clamped to it.
        inside : (rows, full width) bool
            Whether they lay within half a pixel of it before.
        """
        height, width = self.shape
        positions = self.take(motion, rows)
        positions *= np.float32(self.scale)
        across = np.minimum(np.arange(self.full[1], dtype=np.float32), np.float32(width - 1))
        along = np.minimum(np.arange(self.full[0], dtype=np.float32), np.float32(height - 1))
        positions[..., 0] += across
        positions[..., 1] += along[rows, None]
        most = np.array([width - 1, height - 1], np.float32)
        near = (positions >= -0.5) & (positions <= most + np.float32(0.5))
        inside: np.ndarray = near[..., 0] & near[..., 1]
        np.clip(positions, 0, most, out=positions)
        return positions, inside


def _axis(
    size: int, scale: int, multiple: int, jitter: float
) -> tuple[np.ndarray, np.ndarray, int]:
    """Sample of each pixel along an axis, how far off it is, and the full size."""
    full = -(-size * scale // multiple) * multiple
    pixel = np.minimum(np.arange(full), size * scale - 1)
    index = np.clip(np.floor((pixel + 0.5) / scale - jitter), 0, size - 1).astype(np.intp)
    off = scale * (index + 0.5 + jitter) - (pixel + 0.5)
    return index, off.astype(np.float32), full


def dilated(motion: np.ndarray, depth: np.ndarray | None, strips: Strips) -> np.ndarray:
    """Motion of a frame, at silhouettes that of the nearest surface of the 3x3 pixels around.

    Parameters
    ----------
    motion : (h, w, 2) float32
        Finite.
    depth : (h, w) float32 or None
        0 where nothing was hit; without it motion stays as it is.
    strips
        Where the work runs.
    """
    if depth is None:
        return motion
    result = np.empty_like(motion)
    height, width = depth.shape
    still = np.zeros((height, width, 2), np.float32)

    def work(rows: slice) -> None:
        positions = positions_of(motion[rows], rows, out=result[rows])
        dilate_motion(positions, motion, depth, rows, strips.workspace)
        positions -= positions_of(still[rows], rows)

    strips.run(work, height, width)
    return result


def recalled(image: np.ndarray, positions: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
    """An image of four channels of the last picture at positions within it, bilinear.

    Parameters
    ----------
    image : (H, W, 4) float32
    positions : (h, w, 2) float32
        See `Grid.past_positions`.
    out : (h, w, 4) float32, optional
        Written and returned.
    """
    return cv2.remap(image, positions, None, cv2.INTER_LINEAR, out, cv2.BORDER_REPLICATE)

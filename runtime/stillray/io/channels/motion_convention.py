"""What a renderer's motion vectors mean, and what that makes of them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stillray.errors import InputError

# Rounds of following a vector back to where it came from, and how well it must meet itself.
_ROUNDS = 4
_MEETS = 0.75  # pixels: vectors are sampled nearest, which alone can be half a pixel off

UNITS = ("pixels", "frames", "half_frames", "widths")


@dataclass(frozen=True)
class MotionConvention:
    """How a layer's two components become motion as `Frame` wants it.

    Attributes
    ----------
    signs
        Factors of x and y, in that order, that make it previous minus current position, x right
        and y down: 1 and -1, or more where a vector spans only a part of a frame's time.
    swapped
        Whether the layer's first component is y.
    unit
        ``"pixels"``; ``"frames"``: 1 is the frame's width in x, its height in y;
        ``"half_frames"``: the frame spans -1 to 1; ``"widths"``: 1 is the width in both.
    stored
        ``"now"``: a vector lies where its surface is now. ``"before"``: where it was, in the
        file of the previous frame.
    """

    signs: tuple[float, float] = (1.0, 1.0)
    swapped: bool = False
    unit: str = "pixels"
    stored: str = "now"

    def __post_init__(self) -> None:
        if self.unit not in UNITS:
            raise InputError(f"unit must be one of {', '.join(UNITS)}, got {self.unit}")
        if self.stored not in ("now", "before"):
            raise InputError(f"stored must be now or before, got {self.stored}")

    def __str__(self) -> str:
        axes = "yx" if self.swapped else "xy"
        written = [axes[i] for i in (0, 1)]
        x, y = (written.index(axis) for axis in "xy")
        names = ("first", "second")
        terms = [
            f"{axis} = {_factor(sign)}{names[at]}"
            for axis, sign, at in (("x", self.signs[0], x), ("y", self.signs[1], y))
        ]
        where = "" if self.stored == "now" else ", read from the previous frame's file"
        return f"{', '.join(terms)} component, in {self.unit.replace('_', ' ')}{where}"

    def scales(self, height: int, width: int) -> tuple[float, float]:
        """Pixels that a unit of x and of y stand for, with their signs."""
        x, y = {
            "pixels": (1.0, 1.0),
            "frames": (width, height),
            "half_frames": (width / 2, height / 2),
            "widths": (width, width),
        }[self.unit]
        return self.signs[0] * x, self.signs[1] * y

    def displacement(self, vectors: np.ndarray, height: int, width: int) -> np.ndarray:
        """Previous minus current position in pixels, of vectors from a frame of that size.

        Parameters
        ----------
        vectors : (..., 2) float
            As the file has them.
        height, width
            Of the whole frame.

        Returns
        -------
        (..., 2) float32
        """
        if self.swapped:
            vectors = vectors[..., ::-1]
        scales = np.array(self.scales(height, width), np.float32)
        moved: np.ndarray = vectors.astype(np.float32) * scales
        return moved

    def motion(self, vectors: np.ndarray) -> np.ndarray:
        """Motion at the pixels of the current frame: previous minus current position.

        Parameters
        ----------
        vectors : (h, w, 2) float
            Of the current frame, or of the previous one where ``stored`` is ``"before"``.

        Returns
        -------
        (h, w, 2) float32
            Pixels, x right and y down. Where no vector of the previous frame arrives it points
            out of the frame, so that no history is taken.
        """
        height, width = vectors.shape[:2]
        if self.stored == "now":
            return self.displacement(vectors, height, width)
        row, column = np.mgrid[:height, :width].astype(np.float32)
        motion, lost = self.arriving(vectors, column, row)
        motion[lost] = (2 * width, 2 * height)
        return motion

    def arriving(
        self, vectors: np.ndarray, x: np.ndarray, y: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Motion at pixels of the current frame, from vectors that lie where surfaces were.

        Solves ``motion(q) = displacement(q + motion(q))``, following vectors back and forth.

        Parameters
        ----------
        vectors : (H, W, 2) float32
            As the previous frame's file has them.
        x, y : (h, w) float32
            Pixels of the current frame.

        Returns
        -------
        motion : (h, w, 2) float32
            Pixels.
        lost : (h, w) bool
            Where no vector arrives.
        """

        def displaced(motion: np.ndarray | float) -> np.ndarray:
            shift = np.broadcast_to(np.float32(motion), (*x.shape, 2))
            found = nearest(vectors, x + shift[..., 0], y + shift[..., 1])
            return np.nan_to_num(self.displacement(found, *vectors.shape[:2]), posinf=0, neginf=0)

        motion = displaced(0.0)
        for _ in range(_ROUNDS):
            motion = displaced(motion)
        apart = motion - displaced(motion)
        return motion, np.hypot(apart[..., 0], apart[..., 1]) > _MEETS


def nearest(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """An image at positions ``(h, w)``: the nearest pixel, the border's outside of the image.

    Vectors are never interpolated: one between those of two surfaces belongs to neither.
    """
    sampled: np.ndarray = cv2.remap(image, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    return sampled


def _factor(sign: float) -> str:
    if abs(sign) == 1:
        return "-" if sign < 0 else ""
    return f"{sign:g} "

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

    def displacement(self, vectors: np.ndarray) -> np.ndarray:
        """Previous minus current position, in pixels, still lying where the file has it.

        Parameters
        ----------
        vectors : (h, w, 2) float
            As the file has them.

        Returns
        -------
        (h, w, 2) float32
        """
        if self.swapped:
            vectors = vectors[..., ::-1]
        scales = np.array(self.scales(*vectors.shape[:2]), np.float32)
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
        displacement = self.displacement(vectors)
        return displacement if self.stored == "now" else _arriving(displacement)


def _arriving(before: np.ndarray) -> np.ndarray:
    """Motion at the pixels that vectors come to: solves ``motion(q) = before(q + motion(q))``."""
    height, width = before.shape[:2]
    row, column = np.mgrid[:height, :width].astype(np.float32)
    before = np.nan_to_num(before, posinf=0, neginf=0)
    motion = before
    for _ in range(_ROUNDS):
        motion = _nearest(before, column + motion[..., 0], row + motion[..., 1])
    back = _nearest(before, column + motion[..., 0], row + motion[..., 1])
    lost = np.hypot(*np.moveaxis(motion - back, -1, 0)) > _MEETS
    motion[lost] = (2 * width, 2 * height)
    return motion


def _nearest(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    # never interpolated: a vector between two surfaces' vectors belongs to neither
    sampled: np.ndarray = cv2.remap(image, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    return sampled


def _factor(sign: float) -> str:
    if abs(sign) == 1:
        return "-" if sign < 0 else ""
    return f"{sign:g} "

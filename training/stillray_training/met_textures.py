"""Textures that are finer than pixels, of which a few samples meet a part each."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stillray_training.fine_shapes import FINE, seen_through, softer_than_a_box

#: What an albedo is multiplied by, where a texture leaves it as it is.
WHITE = 255


@dataclass(frozen=True, eq=False)
class MetTexture:
    """A texture, finer than pixels.

    Attributes
    ----------
    fine : (FINE h, FINE w, 3) uint8
        What an albedo is multiplied by, times 255.
    spread
        Standard deviation of the pixel filter, in pixels; None for that of a box.
    """

    fine: np.ndarray
    spread: float | None

    @property
    def mean(self) -> np.ndarray:
        """Of endlessly many samples, ``(h, w, 3)`` float32 in (0, 1]."""
        planes = (plane.astype(np.float32) / WHITE for plane in cv2.split(self.fine))
        return np.dstack([seen_through(plane, self.spread) for plane in planes])

    def met(self, samples: float, rng: np.random.Generator) -> np.ndarray:
        """The mean of so many samples a pixel, 1 or more, ``(h, w, 3)`` float32."""
        height, width = shape = self.fine.shape[:2]
        pixels = np.indices((height // FINE, width // FINE))
        total = np.zeros((*pixels.shape[1:], 3), np.float32)
        count = max(round(samples), 1)
        for _ in range(count):
            at = ((pixels + self._within(pixels.shape, rng)) * FINE).astype(int)
            rows, columns = (np.clip(at[axis], 0, shape[axis] - 1) for axis in (0, 1))
            total += self.fine[rows, columns]
        return total / np.float32(WHITE * count)

    def _within(self, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
        """Where samples fall, from the top left of their pixels."""
        within, softer = rng.random(shape), softer_than_a_box(self.spread)
        return within + softer * rng.normal(size=shape) if softer else within


def in_bytes(colours: np.ndarray) -> np.ndarray:
    """Of [0, 1], but none black."""
    return np.clip(np.round(WHITE * colours), 1, WHITE).astype(np.uint8)

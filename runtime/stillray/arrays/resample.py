"""Images of half and of twice the size."""

from __future__ import annotations

import cv2
import numpy as np


def halve(image: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
    """Means of 2x2 blocks; written to ``out`` if given."""
    height, width = image.shape[:2]
    return cv2.resize(image, (width // 2, height // 2), dst=out, interpolation=cv2.INTER_AREA)


def double(image: np.ndarray) -> np.ndarray:
    """Every pixel twice along each axis."""
    height, width = image.shape[:2]
    return cv2.resize(image, (2 * width, 2 * height), interpolation=cv2.INTER_NEAREST)

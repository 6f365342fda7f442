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


def enlarge(image: np.ndarray, times: int) -> np.ndarray:
    """Radiance ``(h, w, 3)``, >= 0, at some times its size, by Lanczos.

    Of its logarithm: of radiance itself Lanczos draws black rims around what is bright.
    """
    height, width = image.shape[:2]
    size = (width * times, height * times)
    enlarged = cv2.resize(np.log1p(image), size, interpolation=cv2.INTER_LANCZOS4)
    return np.asarray(np.expm1(np.maximum(enlarged, 0)))

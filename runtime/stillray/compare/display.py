"""How radiance is shown: exposure, tone curve and PNG, the same for demo, metrics and reports."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from stillray.io.atomic import atomic_path

MAX_EXPOSURE = 8.0
DISPLAY_MEDIAN = 0.2  # where the median of a picture is shown; 1 is white


def display_exposure(reference: np.ndarray) -> float:
    """``min(8, 0.2 / median of the reference's mean radiance)``."""
    median = float(np.median(reference.mean(axis=-1)))
    return min(MAX_EXPOSURE, DISPLAY_MEDIAN / median) if median > 0 else MAX_EXPOSURE


def tone_map(radiance: np.ndarray, exposure: float) -> np.ndarray:
    """Expose, clip to [0, 1], power 1 / 2.2."""
    return np.clip(radiance * exposure, 0, 1) ** (1 / 2.2)


def write_png(path: Path, shown: np.ndarray) -> None:
    """Write a tone-mapped ``(h, w, 3)`` image as 8-bit PNG, complete or not at all."""
    pixels = np.rint(shown[..., ::-1] * 255).astype(np.uint8)
    with atomic_path(path) as temporary:
        temporary.write_bytes(cv2.imencode(".png", pixels)[1].tobytes())

"""What else a user could run: Open Image Denoise, through its Python package."""

from __future__ import annotations

import numpy as np

OIDN_QUALITIES = ("high", "balanced", "fast")


def open_image_denoise(
    color: np.ndarray, albedo: np.ndarray | None, normal: np.ndarray | None, quality: str
) -> np.ndarray:
    """Denoise HDR ``color`` with Open Image Denoise.

    Parameters
    ----------
    color, albedo, normal : (h, w, 3) float32
        As `stillray.Frame` has them.
    quality
        One of `OIDN_QUALITIES`.
    """
    import pyoidn

    return np.asarray(
        pyoidn.denoise(
            np.ascontiguousarray(color), albedo=albedo, normal=normal, hdr=True, quality=quality
        )
    )

"""Open Image Denoise, through its Python package: what most users run today."""

from __future__ import annotations

import numpy as np

from stillray.frame import Frame

OIDN_QUALITIES = ("high", "balanced", "fast")


def open_image_denoise(
    color: np.ndarray,
    albedo: np.ndarray | None,
    normal: np.ndarray | None,
    quality: str,
    *,
    clean_features: bool = False,
) -> np.ndarray:
    """Denoise HDR ``color`` with Open Image Denoise.

    Parameters
    ----------
    color, albedo, normal : (h, w, 3) float32
        As `stillray.Frame` has them.
    quality
        One of `OIDN_QUALITIES`.
    clean_features
        Whether albedo and normal have no noise.
    """
    import pyoidn

    return np.asarray(
        pyoidn.denoise(
            np.ascontiguousarray(color),
            albedo=albedo,
            normal=normal,
            hdr=True,
            quality=quality,
            clean_aux=clean_features,
        )
    )


class OpenImageDenoise:
    """`open_image_denoise` as a peer; it remembers nothing.

    Parameters
    ----------
    quality
        One of `OIDN_QUALITIES`.
    """

    def __init__(self, quality: str) -> None:
        self.quality = quality

    def denoise(self, frame: Frame) -> np.ndarray:
        """Denoise a frame: radiance ``(h, w, 3)``."""
        return open_image_denoise(frame.color, frame.albedo, frame.normal, self.quality)

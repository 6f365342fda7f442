"""Open Image Denoise, through its Python package: what most users run today."""

from __future__ import annotations

from dataclasses import replace

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


class PrefilteredOpenImageDenoise:
    """Open Image Denoise with albedo and normals denoised first, each by a network of its own.

    What Blender does unless told otherwise (its "Accurate" prefilter), and what Open Image
    Denoise's manual recommends for the best quality: three networks a frame for one, at high
    quality each larger than that one.

    Parameters
    ----------
    quality
        One of `OIDN_QUALITIES`, of all three.
    """

    def __init__(self, quality: str) -> None:
        import pyoidn

        self.quality = quality
        self._device = pyoidn.Device()
        self._device.commit()

    def denoise(self, frame: Frame) -> np.ndarray:
        """Denoise a frame: radiance ``(h, w, 3)``; features that are clean stay as they are."""
        frame = self.prefiltered(frame)
        return open_image_denoise(
            frame.color,
            frame.albedo,
            frame.normal,
            self.quality,
            clean_features=frame.clean_features,
        )

    def prefiltered(self, frame: Frame) -> Frame:
        """A frame whose albedo and normal, where it has them, are denoised."""
        if frame.clean_features:
            return frame
        clean = {
            name: self._filtered(name, plane)
            for name, plane in (("albedo", frame.albedo), ("normal", frame.normal))
            if plane is not None
        }
        return replace(frame, **clean, clean_features=bool(clean))  # type: ignore[arg-type]

    def _filtered(self, name: str, plane: np.ndarray) -> np.ndarray:
        import pyoidn

        given, made = np.ascontiguousarray(plane, np.float32), np.empty(plane.shape, np.float32)
        quality = getattr(pyoidn, f"OIDN_QUALITY_{self.quality.upper()}")
        with pyoidn.Filter(self._device, pyoidn.OIDN_FILTER_TYPE_RT) as run:
            run.set_image(name, given, pyoidn.OIDN_FORMAT_FLOAT3)
            run.set_image(pyoidn.OIDN_IMAGE_OUTPUT, made, pyoidn.OIDN_FORMAT_FLOAT3)
            run.set_int("quality", quality)
            run.commit()
            run.execute()
        error = self._device.get_error()
        if error is not None:
            raise RuntimeError(f"Open Image Denoise, {name}: {error}")
        return made

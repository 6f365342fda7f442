"""Cameras, and where a world point falls in a pixel grid.

A camera is a ``(4, 4)`` camera-to-world matrix in Mitsuba's convention (x left, y up, z forward)
and a horizontal field of view in degrees.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Where the camera is and how wide it sees."""

    to_world: np.ndarray  # (4, 4) float64
    fov_x: float  # degrees

    def project(self, position: np.ndarray, height: int, width: int) -> tuple[np.ndarray, ...]:
        """Pixel coordinates and camera z of world positions.

        Parameters
        ----------
        position
            ``(..., 3)`` world positions.
        height, width
            Size of the picture in pixels.

        Returns
        -------
        x, y, z
            Pixels (x right, y down, pixel centres at .5) and depth along the view direction.
        """
        rotation, origin = self.to_world[:3, :3], self.to_world[:3, 3]
        local = (position - origin) @ rotation
        focal = 0.5 * width / np.tan(np.radians(self.fov_x) / 2)
        z = local[..., 2]
        safe = np.where(np.abs(z) > 1e-9, z, 1e-9)
        return (
            0.5 * width - focal * local[..., 0] / safe,
            (0.5 * height - focal * local[..., 1] / safe),
            z,
        )


def look_at(origin: np.ndarray, target: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Camera-to-world matrix of a camera at ``origin`` that looks at ``target``."""
    forward = (target - origin) / np.linalg.norm(target - origin)
    left = np.cross(up, forward)
    left /= np.linalg.norm(left)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = left, np.cross(forward, left), forward
    matrix[:3, 3] = origin
    return matrix

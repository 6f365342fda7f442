"""Cameras: smooth seeded paths, and where a world point falls in a pixel grid.

A camera is a ``(4, 4)`` camera-to-world matrix in Mitsuba's convention (x left, y up, z forward)
and a horizontal field of view in degrees.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FAR = 1e6  # focal lengths: far enough that a camera's own move does not shift the point


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

    def far_points(self, height: int, width: int) -> np.ndarray:
        """``(height, width, 3)`` points through the pixel centres, almost at infinity."""
        focal = 0.5 * width / np.tan(np.radians(self.fov_x) / 2)
        row, column = np.mgrid[0:height, 0:width] + 0.5
        local = np.stack(
            [0.5 * width - column, 0.5 * height - row, np.full_like(row, focal)], axis=-1
        )
        return self.to_world[:3, 3] + FAR * (local @ self.to_world[:3, :3].T)


def look_at(origin: np.ndarray, target: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Camera-to-world matrix of a camera at ``origin`` that looks at ``target``."""
    forward = (target - origin) / np.linalg.norm(target - origin)
    left = np.cross(up, forward)
    left /= np.linalg.norm(left)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = left, np.cross(forward, left), forward
    matrix[:3, 3] = origin
    return matrix


def smooth_path(
    rng: np.random.Generator,
    start: Camera,
    distance: float,
    frames: int,
    *,
    speed: float,
) -> list[Camera]:
    """A hand-held move: constant velocity and a slow sway, seeded.

    Parameters
    ----------
    rng
        Source of randomness.
    start
        First camera.
    distance
        Distance to what the camera looks at, world units.
    frames
        Number of cameras.
    speed
        Translation a frame as a fraction of ``distance``.
    """
    origin = start.to_world[:3, 3]
    left, up, forward = start.to_world[:3, :3].T
    velocity = rng.normal(size=3) * np.array([1.0, 0.4, 1.0])
    velocity *= speed * distance / np.linalg.norm(velocity)
    drift = rng.normal(size=2) * speed * 0.5 * distance
    phase, rate = rng.uniform(0, 2 * np.pi), rng.uniform(0.3, 0.9)
    path = []
    for frame in range(frames):
        sway = 0.3 * speed * distance * (np.sin(rate * frame + phase) - np.sin(phase))
        move = velocity * frame + np.array([0.0, sway, 0.0])
        at = origin + left * move[0] + up * move[1] + forward * move[2]
        target = origin + forward * distance + (left * drift[0] + up * drift[1]) * frame
        path.append(Camera(to_world=look_at(at, target, up), fov_x=start.fov_x))
    return path

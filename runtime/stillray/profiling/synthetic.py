"""Frames to measure on where no render is at hand: a small room under 1-sample noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import cv2
import numpy as np

from stillray.frame import Frame

# Larger frames are tiled from this size: what a pixel costs depends on its neighbours only.
_WIDEST = 640  # pixels
_HIGHEST = 360
_HALF_ROOM = np.array([3.0, 1.5, 4.0], np.float32)  # metres; x right, y down, z into the picture
_LAMP = np.array([0.8, -1.3, 0.5], np.float32)
_WALLS = np.array([[0.7, 0.25, 0.2], [0.6, 0.6, 0.55], [0.35, 0.45, 0.65]], np.float32)  # by axis
_WINDOW = (-1.6, -0.9, 0.7, 0.6)  # in the far wall: left, top, width, height; sky behind it
_SKY = np.array([2.0, 2.6, 3.6], np.float32)
# The side walls are of bricks, whose joints break up a tenth of the frame, as clutter does: of the
# bundled sequence, 11 % of the pixels look back at more than one surface.
_BRICKS = np.array([6.0, 3.0], np.float32)  # a metre, up and along
_JOINT = 0.2  # share of a brick
_UNLIT = 0.5  # share of the pixels whose one path found no light
_FIREFLY = 3e-4  # share of the pixels whose path found far too much


@dataclass(frozen=True, kw_only=True)
class _Pose:
    """Where everything is in one frame: metres, radians."""

    eye: tuple[float, float, float]
    yaw: float
    centres: tuple[tuple[float, float, float], ...]


_RADII = (0.6, 0.45, 0.3)
_COLOURS = np.array([[0.8, 0.5, 0.15], [0.2, 0.55, 0.25], [0.0, 0.0, 0.0]], np.float32)
# The camera swings between two poses and a ball rolls with it: each is the other's past.
_POSES = (
    _Pose(
        eye=(0.0, 0.0, -3.8),
        yaw=0.0,
        centres=((-0.9, 0.9, 0.4), (1.1, 1.05, 1.2), (0.25, 1.2, -0.8)),
    ),
    _Pose(
        eye=(0.02, -0.005, -3.77),
        yaw=0.004,
        centres=((-0.9, 0.9, 0.4), (1.1, 1.05, 1.2), (0.29, 1.2, -0.78)),
    ),
)


def swing(height: int, width: int, seed: int = 0) -> tuple[Frame, Frame]:
    """Two frames of a moving camera; each one's motion leads to the other, so they can alternate.

    Color, albedo, normal, depth and motion are there. There is all that a denoiser finds hard:
    pixels without light, fireflies, an albedo of 0 on a surface, background, and a moving object
    that uncovers what was behind it. The same seed gives the same frames.

    Parameters
    ----------
    height, width
        Pixels. Beyond 640 x 360 the frame is tiled.
    seed
        Of the noise.
    """
    size = min(height, _HIGHEST), min(width, _WIDEST)
    rng = np.random.default_rng(seed)
    first, second = _POSES
    frames = _render(first, second, *size, rng), _render(second, first, *size, rng)
    return tiled(frames[0], height, width), tiled(frames[1], height, width)


def tiled(frame: Frame, height: int, width: int) -> Frame:
    """A frame repeated, and cut, to a size.

    What lay behind a seam differs in depth or normal from what is before it, so that reprojection
    refuses it as it refuses what comes into view.
    """
    if frame.shape == (height, width):
        return frame
    rows, columns = -(-height // frame.shape[0]), -(-width // frame.shape[1])
    buffers: dict[str, Any] = {
        field.name: np.ascontiguousarray(cv2.repeat(array, rows, columns)[:height, :width])
        for field in fields(frame)
        if field.name != "jitter" and isinstance(array := getattr(frame, field.name), np.ndarray)
    }
    return replace(frame, **buffers)


def _render(now: _Pose, before: _Pose, height: int, width: int, rng: np.random.Generator) -> Frame:
    x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    focal = np.float32(0.8 * width)
    way = np.empty((height, width, 3), np.float32)
    way[..., 0], way[..., 1] = (x + 0.5 - width / 2) / focal, (y + 0.5 - height / 2) / focal
    way[..., 2] = 1  # so that the way's length in steps is the camera's z
    way = way @ _turn(now.yaw).T
    eye = np.array(now.eye, np.float32)
    depth, thing, axis = _first_hit(eye, way, now.centres)
    place = eye + way * depth[..., None]
    normal = _normals(place, way, thing, axis, now.centres)
    albedo = _albedo(place, thing, axis)
    motion = _motion(place, thing, now, before, focal)
    light = _LAMP - place
    distance = np.maximum(np.linalg.norm(light, axis=-1), 0.3)
    facing = np.maximum(np.einsum("yxc,yxc->yx", normal, light), 0) / distance
    irradiance = 0.15 + 2.5 * facing / distance**2
    noise = rng.standard_exponential((height, width), np.float32) / (1 - _UNLIT)
    noise[rng.random((height, width), np.float32) < _UNLIT] = 0
    flies = rng.random((height, width), np.float32) < _FIREFLY
    noise[flies] = 10 ** rng.uniform(2, 4, np.count_nonzero(flies))
    # a surface without albedo is a mirror, of which the noise shows as it is
    shine = np.where(albedo.max(axis=-1, keepdims=True) > 0, albedo, np.float32(0.6))
    color = shine * (irradiance * noise)[..., None]
    window = (thing == len(_RADII)) & (axis == 2) & _in_window(place)
    color[window], albedo[window], normal[window], depth[window] = _SKY, 0, 0, 0
    return Frame(color=color, albedo=albedo, normal=normal, depth=depth, motion=motion)


def _turn(yaw: float) -> np.ndarray:
    """From camera to room."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]], np.float32)


def _first_hit(
    eye: np.ndarray, way: np.ndarray, centres: Sequence[tuple[float, float, float]]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depth, which ball was hit (their number: a wall), and the wall's axis."""
    # from inside a box a ray leaves by the nearest of the three planes that it moves towards
    with np.errstate(divide="ignore"):
        to_walls = (np.copysign(_HALF_ROOM, way) - eye) / way
    axis = np.argmin(to_walls, axis=-1).astype(np.uint8)
    depth = to_walls.min(axis=-1)
    thing = np.full(depth.shape, len(_RADII), np.uint8)
    squared = np.einsum("yxc,yxc->yx", way, way)
    for index, (centre, radius) in enumerate(zip(centres, _RADII, strict=True)):
        apart = np.array(centre, np.float32) - eye
        along = way @ apart
        under = along**2 - squared * (apart @ apart - radius**2)
        ball = (along - np.sqrt(np.maximum(under, 0))) / squared
        nearer = (under > 0) & (ball < depth)
        depth[nearer], thing[nearer] = ball[nearer], index
    return depth, thing, axis


def _normals(
    place: np.ndarray,
    way: np.ndarray,
    thing: np.ndarray,
    axis: np.ndarray,
    centres: Sequence[tuple[float, float, float]],
) -> np.ndarray:
    walls = axis[..., None] == np.arange(3, dtype=np.uint8)
    normal = np.where(walls, -np.sign(way), np.float32(0))
    bricks = place[..., 1:] * _BRICKS
    bricks -= np.floor(bricks)
    joint = (axis == 0) & (bricks.min(axis=-1) < _JOINT)
    normal[joint] = normal[joint] * np.float32(0.8) + np.array([0, 0.6, 0], np.float32)
    for index, (centre, radius) in enumerate(zip(centres, _RADII, strict=True)):
        on = thing == index
        normal[on] = (place[on] - np.array(centre, np.float32)) / radius
    return normal


def _albedo(place: np.ndarray, thing: np.ndarray, axis: np.ndarray) -> np.ndarray:
    albedo = _WALLS[axis]
    tile = np.floor(place[..., 0] * 2) + np.floor(place[..., 2] * 2)
    albedo[(axis == 1) & (tile % 2 == 0)] *= 0.4  # floor and ceiling: a chequerboard
    grain = 1 + 0.15 * np.sin(23 * place[..., 1]) * np.sin(19 * place[..., 0] + 7 * place[..., 2])
    albedo *= grain[..., None]
    for index, colour in enumerate(_COLOURS):
        albedo[thing == index] = colour
    return albedo


def _motion(
    place: np.ndarray, thing: np.ndarray, now: _Pose, before: _Pose, focal: np.float32
) -> np.ndarray:
    """Where each point was in the previous frame, minus where it is: pixels."""
    earlier = place.copy()
    for index, (centre, past) in enumerate(zip(now.centres, before.centres, strict=True)):
        if centre != past:
            earlier[thing == index] += np.subtract(past, centre, dtype=np.float32)

    def on_screen(points: np.ndarray, pose: _Pose) -> np.ndarray:
        seen = (points - np.array(pose.eye, np.float32)) @ _turn(pose.yaw)
        projected: np.ndarray = focal * seen[..., :2] / seen[..., 2:]
        return projected

    return on_screen(earlier, before) - on_screen(place, now)


def _in_window(place: np.ndarray) -> np.ndarray:
    left, top, width, height = _WINDOW
    across, down = place[..., 0] - left, place[..., 1] - top
    inside: np.ndarray = (across > 0) & (across < width) & (down > 0) & (down < height)
    return inside

"""Camera moves: smooth, seeded, defined at any time, so that a shutter can be open in between."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from stillray.errors import InputError
from stillray_training.simulate.camera import Camera, look_at

CameraPath = Callable[[float], Camera]  # time in frames to camera

MOVES = ("still", "dolly", "orbit", "handheld")


def camera_path(
    move: str, rng: np.random.Generator, start: Camera, distance: float, *, speed: float
) -> CameraPath:
    """A camera move that begins at ``start`` at time 0.

    Parameters
    ----------
    move
        ``"still"``; ``"dolly"``: straight on, looking ahead; ``"orbit"``: around what it looks at;
        ``"handheld"``: a slow drift with sway and shake.
    rng
        Direction and phases of the move.
    start
        The camera at time 0.
    distance
        Distance to what the camera looks at, metres.
    speed
        Translation a frame as a fraction of ``distance``, 0 or more.

    Raises
    ------
    InputError
        There is no such move.
    """
    if move not in MOVES:
        raise InputError(f"move must be of {', '.join(MOVES)}, got {move}")
    origin = start.to_world[:3, 3]
    left, up, forward = start.to_world[:3, :3].T
    step = speed * distance
    heading = rng.normal(size=3) * np.array([1.0, 0.25, 1.0])
    heading /= np.linalg.norm(heading)
    drift = rng.normal(size=2) * 0.4 * step
    phases, rates = rng.uniform(0, 2 * np.pi, 6), rng.uniform(0.3, 1.1, 6)
    side = float(rng.choice([-1.0, 1.0]))

    def sway(time: float, axis: int) -> float:
        wave = np.sin(rates[axis] * time + phases[axis]) - np.sin(phases[axis])
        return float(wave)

    def dolly(time: float) -> tuple[np.ndarray, np.ndarray]:
        move = (left * heading[0] + up * heading[1] + forward * heading[2]) * step * time
        return origin + move, origin + forward * distance + (left * drift[0] + up * drift[1]) * time

    def orbit(time: float) -> tuple[np.ndarray, np.ndarray]:
        angle = side * speed * time
        back = -forward * np.cos(angle) + left * np.sin(angle)
        lift = up * 0.3 * heading[1] * step * time
        return origin + forward * distance + back * distance + lift, origin + forward * distance

    def handheld(time: float) -> tuple[np.ndarray, np.ndarray]:
        at, target = dolly(0.5 * time)
        at = at + 0.6 * step * (left * sway(time, 0) + up * sway(time, 1) + forward * sway(time, 2))
        return at, target + 0.8 * step * (left * sway(time, 3) + up * sway(time, 4))

    aims = {"dolly": dolly, "orbit": orbit, "handheld": handheld}

    def path(time: float) -> Camera:
        if move == "still" or speed == 0:
            return start
        at, target = aims[move](time)
        return Camera(to_world=look_at(at, target, up), fov_x=start.fov_x)

    return path


def recorded_path(file: Path, frames: int) -> CameraPath:
    """The cameras of a JSON file, one a frame, such as the ``sequence.json`` of a sequence.

    Parameters
    ----------
    file
        Holds a list ``cameras``, or ``frames``, of objects with ``camera_to_world`` and, unless
        the file has one for all, ``fov_x_deg``.
    frames
        How many are needed.

    Raises
    ------
    InputError
        The file cannot be read, or does not hold that many cameras.
    """
    try:
        record = json.loads(file.read_text(encoding="utf-8"))
        cameras = [
            Camera(
                to_world=np.array(entry["camera_to_world"], float).reshape(4, 4),
                fov_x=float(entry.get("fov_x_deg", record.get("fov_x_deg"))),
            )
            for entry in record.get("cameras") or record["frames"]
        ]
    except OSError as error:
        raise InputError(f"cameras must be a readable file, got {file}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError(
            f"cameras must be JSON with camera_to_world and fov_x_deg a frame, got {file}"
        ) from None
    if len(cameras) < frames:
        raise InputError(f"cameras must hold {frames}, got {len(cameras)} in {file}")

    def path(time: float) -> Camera:
        # whole frames; the first has none before it and is seen as standing still
        return cameras[max(round(time), 0)]

    return path

"""Light that changes where surfaces stay: shadows and bright patches that move, lamps switched."""

from __future__ import annotations

import cv2
import numpy as np

from stillray_training.draws import log_uniform

_DARKEST = 0.1  # of the light that is left inside, the least
_BRIGHT = 0.3  # share of shades that are brighter inside, not darker
_PARTS = (0.1, 0.7)  # of the picture that is inside
_SPEEDS = (1.0, 16.0)  # pixels a frame
_WAITING = 0.5  # share of shades that stand still at first: a long past holds until they move
_LATEST = 8  # of the last frames, in one of which those begin to move
_SOFTEST = 0.5  # width of the edge in standard deviations of the field that makes the shape


def switched(shape: tuple[int, int], frames: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Factors of the light of some frames in a row, all of which changes at one of them.

    Parameters
    ----------
    shape, frames
        As for `moving_shade`.
    rng
        Draws the frame, and the factor.

    Returns
    -------
    list of (h, w, 1) float32 arrays
        1 before, then 0.1 to 10.
    """
    at = int(rng.integers(1, max(frames, 2)))
    factor = np.float32(_DARKEST ** rng.uniform(-1, 1))
    return [
        np.full((*shape, 1), factor if frame >= at else 1, np.float32) for frame in range(frames)
    ]


def moving_shade(
    shape: tuple[int, int], frames: int, rng: np.random.Generator, *, scale: int = 1
) -> list[np.ndarray]:
    """Factors of the light of some frames in a row.

    Parameters
    ----------
    shape
        Height and width.
    frames
        How many.
    rng
        Draws the shape, its edge from hard to soft, how much light is left inside, its way, and
        when it begins to move.
    scale
        Pixels of ``shape`` to one of a frame: speeds are of frames.

    Returns
    -------
    list of (h, w, 1) float32 arrays
        1 outside; inside 0.1 to 1, or 1 to 10.
    """
    height, width = shape
    coarse = rng.normal(size=rng.integers(2, 9, 2)).astype(np.float32)
    field = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    level = np.quantile(field, 1 - rng.uniform(*_PARTS))
    softness = float(field.std()) * _SOFTEST * rng.random() ** 2 + 1e-6
    stops = np.log(_DARKEST) * rng.random()
    if rng.random() < _BRIGHT:
        stops = -stops
    angle = rng.uniform(0, 2 * np.pi)
    speed = scale * log_uniform(rng, _SPEEDS)
    waits = rng.random() < _WAITING
    still = max(0, frames - 1 - int(rng.integers(1, _LATEST + 1))) if waits else 0
    factors = []
    for frame in range(frames):
        far = speed * max(0, frame - still)
        across, down = far * np.cos(angle), far * np.sin(angle)
        way = np.array([[1, 0, across], [0, 1, down]], np.float32)
        moved = cv2.warpAffine(field, way, (width, height), borderMode=cv2.BORDER_REFLECT)
        inside = np.clip((moved - level) / softness + 0.5, 0, 1)
        factors.append(np.exp(stops * inside)[..., None].astype(np.float32))
    return factors

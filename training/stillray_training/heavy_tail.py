"""Samples of a heavy tail, painted into rendered frames: caustics that nobody clamps.

Renderers that bound no sample write a few that are hundreds to millions of times as bright as the
picture: paths that found a lamp by chance, by way of something glossy. The brighter, the rarer, and
each decade holds as much of the light as the next; what is painted is so, too, and the reference is
given its mean. A network that has only met clamped samples takes two of them side by side for a
lamp.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from stillray.frame import Frame
from stillray_training.draws import log_uniform
from stillray_training.small_lamps import usual_light

# Of usual light, below which a sample is noise like any other, and beyond which there is none.
_LEAST = 3.0
_MOST = (30.0, 1e6)
_OFTEN = (3e-3, 0.2)  # samples of usual light and more, of all; a classroom of LuxCore has 0.07
_PLACES = (1.0, 3.0)  # powers of e by which they come more often in places than elsewhere
_COARSE = (2, 7)  # such places along an edge, and one more than the most
_TEXTURE = (0.1, 3.0)  # least and most light that they are measured by, of the picture's usual


@dataclass(frozen=True, eq=False)
class Tail:
    """What rare samples add to a picture.

    A sample is brighter than ``v`` times the light that it is measured by as often as
    ``often / v``, from `_LEAST` to `most`.

    Attributes
    ----------
    often : (h, w) float32
        How often.
    light : (h, w, 3) float32
        Radiance that they are measured by.
    most
        Of that, the brightest.
    """

    often: np.ndarray
    light: np.ndarray
    most: float


def draw_tail(reference: np.ndarray, rng: np.random.Generator) -> Tail:
    """A tail that hardly shows, up to one that holds nearly all of a frame's energy.

    Parameters
    ----------
    reference : (h, w, 3)
        The picture's radiance without noise, whose colors and textures it takes.
    rng
        Draws how often, where, and how bright.
    """
    height, width = reference.shape[:2]
    often = np.full((height, width), log_uniform(rng, _OFTEN), np.float32)
    if rng.random() < 0.5:
        coarse = rng.normal(size=rng.integers(*_COARSE, 2)).astype(np.float32)
        field = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
        often *= np.exp(np.float32(rng.uniform(*_PLACES)) * (field - field.max()))
    return Tail(often, light_of(reference), log_uniform(rng, _MOST))


def light_of(reference: np.ndarray) -> np.ndarray:
    """What rare samples of a picture are measured by: its light, neither dark nor bright."""
    usual = usual_light(reference)
    return np.clip(reference, _TEXTURE[0] * usual, _TEXTURE[1] * usual).astype(np.float32)


def reference_with(reference: np.ndarray, tail: Tail) -> np.ndarray:
    """A picture's radiance ``(h, w, 3)`` and the mean of what rare samples add to it."""
    mean = tail.often * np.float32(np.log(tail.most / _LEAST))
    lit: np.ndarray = reference + mean[..., None] * tail.light
    return lit.astype(np.float32)


def frame_with(frame: Frame, tail: Tail, samples: float, rng: np.random.Generator) -> Frame:
    """A frame of so many samples a pixel, with those that are rare among them."""
    height, width = frame.shape
    share = 1 / _LEAST - 1 / tail.most
    counts = rng.poisson(tail.often * (samples * share))
    rows, columns = np.nonzero(counts)
    found = np.repeat(np.arange(len(rows)), counts[rows, columns])
    brightness = 1 / (rng.random(len(found)) * share + 1 / tail.most)
    total = np.zeros((height, width), np.float32)
    total[rows, columns] = np.bincount(found, brightness, len(rows)) / samples
    return replace(frame, color=frame.color + total[..., None] * tail.light)

"""Samples thinned out: frames as noisy as those of scenes that are harder to light.

A renderer that meets its lamps by chance writes mostly black samples and a few bright ones. Of
scenes that are lit easily the same is had by roulette: a sample stays with some probability and
counts as much more, which leaves the mean as it is. Lamps and skies in view stay, since every
sample meets those.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from stillray.frame import Frame
from stillray_training.draws import log_uniform
from stillray_training.small_lamps import usual_light

_KEPT = (0.03, 0.7)  # of all samples
_PLACES = 1.5  # most powers of e between places where more are kept, and where fewer
_COARSE = (2, 7)  # such places along an edge, and one more than the most
_SHINES = 8.0  # times the picture's usual light, above which a pixel shows what shines itself


def draw_kept(reference: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The probability ``(h, w)`` by which each sample of a pixel stays, in (0, 1].

    Parameters
    ----------
    reference : (h, w, 3)
        The picture's radiance without noise.
    rng
        Draws it: alike all over, or more in places.
    """
    height, width = reference.shape[:2]
    kept = np.full((height, width), log_uniform(rng, _KEPT), np.float32)
    if rng.random() < 0.5:
        coarse = rng.uniform(-1, 1, rng.integers(*_COARSE, 2)).astype(np.float32)
        field = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)
        kept *= np.exp(np.float32(_PLACES / 2) * field)
    kept[reference.mean(axis=-1) > _SHINES * usual_light(reference)] = 1
    return np.clip(kept, _KEPT[0] / 2, 1)


def thinned(frame: Frame, kept: np.ndarray, samples: float, rng: np.random.Generator) -> Frame:
    """A frame of so many samples a pixel, of which a part stays and counts as much more.

    Where samples of a pixel are alike it is exactly what roulette does to each.
    """
    count = max(round(samples), 1)
    factor = rng.binomial(count, kept) / (count * kept)
    return replace(frame, color=frame.color * factor[..., None].astype(np.float32))

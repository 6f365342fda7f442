"""Frames of less noise and a few fireflies, which one sample a pixel never shows.

A network that has only met noise takes a lone firefly in a clean picture for light, and a clean
picture for noise.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from stillray.frame import Frame

# Samples a pixel; 0 for so many that no noise is left. A share of one sample's noise in their place
# taught networks to leave frames of 16 samples a pixel as they are: it has no noise but in the few
# pixels that were lit.
_SAMPLES = (0, 4, 16, 64)
_MOST_NOISE = np.float32(1000)  # a sample over its reference: no more is known where that is black
# Fireflies a pixel. A pixel's share of the loss is small: of 2e-4, kpyr-5s learned to leave pixels
# of little noise alone, and fireflies with them.
_MOST = 1e-2
_BRIGHTER = (1.0, 6.0)  # powers of ten above the frame's median
_SIZES = ((1, 2, 3), (0.6, 0.25, 0.15))  # edges of clusters in pixels, and how often they come


def quiet_frame(frame: Frame, reference: np.ndarray, rng: np.random.Generator) -> Frame:
    """A frame as more samples a pixel would show it, and fireflies put in.

    Parameters
    ----------
    frame
        A noisy frame; its motion is dropped, since the frames before it are not quiet.
    reference : (h, w, 3)
        Its radiance without noise.
    rng
        Draws how many samples, and the fireflies: single pixels and clusters, of one colour or
        white.

    Returns
    -------
    Frame
    """
    height, width = frame.shape
    color = reference * _noise(frame, reference, int(rng.choice(_SAMPLES)), rng)
    usual = float(np.median(reference.mean(axis=-1))) or 1.0
    # clusters keep their shape where they meet the border
    mask = np.zeros((height, width, 3), np.float32)
    # cubed: from hardly any to many
    for _ in range(rng.poisson(rng.random() ** 3 * _MOST * height * width)):
        size = int(rng.choice(_SIZES[0], p=_SIZES[1]))
        tint = rng.random(3) ** 2 if rng.random() < 0.5 else np.ones(3)
        light = usual * 10 ** rng.uniform(*_BRIGHTER) * tint
        corner = int(rng.integers(width)), int(rng.integers(height))
        end = corner[0] + size - 1, corner[1] + size - 1
        cv2.rectangle(mask, corner, end, light.tolist(), cv2.FILLED)
    color = np.where(mask > 0, mask, color)
    return replace(frame, color=color.astype(np.float32), motion=None)


def _noise(
    frame: Frame, reference: np.ndarray, samples: int, rng: np.random.Generator
) -> np.ndarray | np.float32:
    """What a reference is multiplied by: the frame's own noise, averaged over as many places."""
    if samples == 0:
        return np.float32(1)
    lit = reference > 0
    ratio = np.divide(np.nan_to_num(frame.color), reference, out=np.ones_like(reference), where=lit)
    np.clip(ratio, 0, _MOST_NOISE, out=ratio)
    total = np.zeros_like(ratio)
    for _ in range(samples):
        shift = rng.integers(frame.shape[0]), rng.integers(frame.shape[1])
        total += np.roll(ratio, shift, axis=(0, 1))
    # the mean over the frame is 1, as of an unbiased renderer
    return total / np.maximum(total.mean(), np.float32(1e-6))

"""Frames of little noise and a few fireflies, which one sample a pixel never shows.

A network that has only met noise takes a lone firefly in a clean picture for light, and a clean
picture for noise.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from stillray.frame import Frame

_NOISE = (0.0, 0.1, 0.25, 0.5)  # shares of the frame's noise that are kept
# Fireflies a pixel. A pixel's share of the loss is small: of 2e-4, kpyr-5s learned to leave pixels
# of little noise alone, and fireflies with them.
_MOST = 1e-2
_BRIGHTER = (1.0, 6.0)  # powers of ten above the frame's median
_SIZES = ((1, 2, 3), (0.6, 0.25, 0.15))  # edges of clusters in pixels, and how often they come


def quiet_frame(frame: Frame, reference: np.ndarray, rng: np.random.Generator) -> Frame:
    """A frame with part of its noise taken away, and fireflies put in.

    Parameters
    ----------
    frame
        A noisy frame; its motion is dropped, since the frames before it are not quiet.
    reference : (h, w, 3)
        Its radiance without noise.
    rng
        Draws how much noise is left, and the fireflies: single pixels and clusters, of one colour
        or white.

    Returns
    -------
    Frame
    """
    noise = np.float32(rng.choice(_NOISE))
    color = reference + noise * (np.nan_to_num(frame.color) - reference)
    color = add_fireflies(color, reference, rng)
    return replace(frame, color=color.astype(np.float32), motion=None)


def add_fireflies(color: np.ndarray, reference: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A picture ``(h, w, 3)`` with fireflies: single pixels and clusters, colored or white."""
    height, width = color.shape[:2]
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
    return np.where(mask > 0, mask, color)

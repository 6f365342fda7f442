"""Soft patterns of 4 to 48 pixels, faint as often as not: ripples, caustics, clouds, marble.

Where no albedo shows a pattern it lies in the noise. A network that has met hard edges and letters
alone takes what is soft and faint for noise of many pixels, and smears the waves of a pool.
"""

from __future__ import annotations

import cv2
import numpy as np

from stillray_training.draws import log_uniform
from stillray_training.fine_shapes import anywhere

_WAVES = (4.0, 48.0)  # pixels, from crest to crest in the middle of the picture
_BAND = 0.35  # standard deviation of their logarithm
_LONG = (1.0, 6.0)  # length of a crest by what is between two
_CONTRAST = (0.05, 0.8)  # of the light, standard deviation
_RIDGES = 0.4  # share of the patterns that are bright lines, as caustics
_LEAST = 0.05  # of the light, that a pattern leaves
_MOST = 4.0  # times the light, of its brightest
_TINT = 0.3  # most that a channel differs in contrast
_NEARER = (0.4, 2.5)  # size at one border by that at the other, seen in perspective
_WHOLE = 0.6  # share of the patterns that fill the picture
_SOFT = (0.0, 6.0)  # pixels, of the border of others


def draw_ripples(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """What light is multiplied by where a surface has such a pattern.

    Parameters
    ----------
    shape
        Height and width, pixels.
    rng
        Draws sizes, stretch, direction, contrast and colour, and the part of the picture.

    Returns
    -------
    (h, w, 3) float32
        Positive, 1 in the mean; 1 beyond the pattern.
    """
    waves = _in_perspective(_noise(tuple(3 * size for size in shape), rng), shape, rng)
    if rng.random() < _RIDGES:
        waves = np.exp(-2 * np.abs(waves)).astype(np.float32)
        waves = (waves - waves.mean()) / max(float(waves.std()), 1e-6)
    contrast = log_uniform(rng, _CONTRAST) * (1 + _TINT * rng.uniform(-1, 1, 3))
    pattern = np.clip(1 + waves[..., None] * contrast, _LEAST, _MOST)
    pattern /= pattern.mean((0, 1))
    if rng.random() >= _WHOLE:
        pattern = 1 + (pattern - 1) * _part(shape, rng)[..., None]
    return pattern.astype(np.float32)


def _noise(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """Noise of a band of wavelengths, of mean 0 and deviation 1, float32."""
    turned, stretch = rng.uniform(0, np.pi), np.sqrt(log_uniform(rng, _LONG))
    y, x = np.meshgrid(np.fft.fftfreq(shape[0]), np.fft.rfftfreq(shape[1]), indexing="ij")
    across = (x * np.cos(turned) + y * np.sin(turned)) / stretch
    along = (y * np.cos(turned) - x * np.sin(turned)) * stretch
    octaves = np.log(np.maximum(np.hypot(across, along), 1e-6) * log_uniform(rng, _WAVES))
    weight = np.exp(-0.5 * (octaves / _BAND) ** 2)
    waves = np.fft.irfft2(np.fft.rfft2(rng.normal(size=shape)) * weight, shape)
    return (waves / max(float(waves.std()), 1e-12)).astype(np.float32)


def _in_perspective(
    waves: np.ndarray, shape: tuple[int, int], rng: np.random.Generator
) -> np.ndarray:
    """A part of a pattern, smaller towards one border."""
    height, width = shape
    size = log_uniform(rng, _NEARER) ** (np.arange(height) / max(height - 1, 1) - 0.5)
    x = (np.arange(width) - width / 2) / size[:, None] + 1.5 * width
    y = np.cumsum(1 / size)[:, None] + np.zeros(width) + height
    return cv2.remap(
        waves, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REFLECT,
    )  # fmt: skip


def _part(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """A half of the picture, cut along any line, 1 there and 0 beyond, sharply or softly."""
    x, y = anywhere(shape, rng)
    angle = rng.uniform(0, 2 * np.pi)
    rows, columns = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    far = (columns - x) * np.cos(angle) + (rows - y) * np.sin(angle)
    return np.clip(far / max(rng.uniform(*_SOFT), 1e-3) + 0.5, 0, 1)

"""Textures with detail of every size, met by a few samples a pixel: pictures, wood, cloth.

Dead leaves: shapes whose sizes follow a power law hide one another, and what is left has the
statistics of natural pictures (Lee, Mumford and Huang 2001, Occlusion Models for Natural Images).
What is smaller than a pixel is noise of few samples, what is a pixel and larger is not; a network
that has seen stripes and tiles alone takes both for noise, and smears the petals of a picture.
"""

from __future__ import annotations

import cv2
import numpy as np

from stillray_training.draws import log_uniform
from stillray_training.fine_shapes import FINE, anywhere, ellipse, rectangle
from stillray_training.met_textures import WHITE, MetTexture, in_bytes

_SMALLEST, _LARGEST = (0.3, 3.0), 32.0  # radii, pixels: the smallest of a texture; the largest
_STRETCHED = (1.0, 8.0)  # width by height: wood, and floors that are looked along
_CONTRAST = (0.1, 1.0)  # of the albedo, what the darkest leaf takes away
_COLOURED = 0.15  # standard deviation of a leaf's channels
_BRIGHTEST = (0.3, 1.0)  # of the ground's channels
_COVERED = 2.5  # times, by leaves that are drawn
_MOST = 20_000  # leaves
_WHOLE = 0.5  # share of the textures that fill the picture
_EDGES = (16.0, 128.0)  # pixels, of the others


def draw_leaves(
    shape: tuple[int, int], spread: float | None, rng: np.random.Generator
) -> MetTexture:
    """Leaves all over a picture, or on a thing in it.

    Parameters
    ----------
    shape
        Height and width, pixels.
    spread
        As `MetTexture` has it.
    rng
        Draws sizes, stretch, colours and the place.
    """
    ground = rng.uniform(*_BRIGHTEST, 3)
    contrast = log_uniform(rng, _CONTRAST)
    fine = np.empty([FINE * size for size in shape] + [3], np.uint8)
    fine[:] = in_bytes(ground * (1 - contrast / 2))
    stretch = np.sqrt(log_uniform(rng, _STRETCHED))
    turned, unruly = rng.uniform(0, 180), rng.choice([2.0, 180.0])
    radii = _radii(shape, rng)
    places = rng.uniform(0, 1, (len(radii), 2)) * shape[::-1]
    angles = turned + unruly * rng.uniform(-0.5, 0.5, len(radii))
    darker = 1 - contrast * rng.random((len(radii), 1))
    colours = in_bytes(ground * darker + _COLOURED * contrast * rng.normal(size=(len(radii), 3)))
    for place, radius, angle, colour in zip(places, radii, angles, colours, strict=True):
        sides = 2 * FINE * radius * np.array([stretch, 1 / stretch])
        box = (tuple(FINE * place), tuple(np.maximum(sides, 1)), float(angle))
        cv2.ellipse(fine, box, colour.tolist(), cv2.FILLED)
    if rng.random() >= _WHOLE:
        draw = ellipse if rng.random() < 0.5 else rectangle
        sides = (log_uniform(rng, _EDGES), log_uniform(rng, _EDGES))
        thing = draw(shape, anywhere(shape, rng), sides, rng.uniform(0, 180))
        fine[thing == 0] = WHITE
    return MetTexture(fine, spread)


def _radii(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Of leaves that cover a picture: as many of each size as cover the same area, pixels."""
    smallest = log_uniform(rng, _SMALLEST)
    low, high = smallest**-2, _LARGEST**-2
    radii = 1 / np.sqrt(low - rng.random(_MOST) * (low - high))
    covered = np.cumsum(np.pi * radii**2)
    return radii[: 1 + np.searchsorted(covered, _COVERED * shape[0] * shape[1])]

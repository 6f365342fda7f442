"""Frames of little noise and a few fireflies, which one sample a pixel never shows.

A network that has only met noise takes a lone firefly in a clean picture for light, and a clean
picture for noise.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from stillray.frame import Frame
from stillray_training.film import DEVIATIONS, film_weights

_NOISE = (0.0, 0.1, 0.25, 0.5)  # shares of the frame's noise that are kept
# Fireflies a pixel. A pixel's share of the loss is small: of 2e-4, kpyr-5s learned to leave pixels
# of little noise alone, and fireflies with them.
_MOST = 1e-2
_BRIGHTER = (1.0, 6.0)  # powers of ten above the frame's median
_DARK = 0.02  # albedo below which a texture's noise is not looked for
_SIZES = ((1, 2, 3), (0.6, 0.25, 0.15))  # edges of clusters in pixels, and how often they come
_EVEN = 2  # edge up to which their pixels are alike


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
    light = fireflies(reference, rng)
    color = np.where(light > 0, light, color)
    return replace(frame, color=color.astype(np.float32), motion=None)


def uneven_frame(
    frame: Frame, reference: np.ndarray, albedo: np.ndarray | None, rng: np.random.Generator
) -> Frame:
    """A frame that keeps its noise in a part of the picture: surfaces that face a way, or patches.

    Sun and lamps leave most of a picture without noise, and faces in half-shadow with much. A
    network that never saw both together took the noise there for texture, since all around it the
    picture was clean. Textures keep the noise of the frame's own albedo: light without noise shows
    them as that says.

    Parameters
    ----------
    frame
        A noisy frame.
    reference : (h, w, 3)
        Its radiance without noise.
    albedo : (h, w, 3) or None
        Its albedo with less noise than the frame's; None where the frame has none.
    rng
        Draws the part, and how much noise is left elsewhere: none to a third.
    """
    height, width = frame.shape
    if frame.normal is not None and rng.random() < 0.5:
        way = rng.normal(size=3)
        field = frame.normal @ (way / np.linalg.norm(way)).astype(np.float32)
    else:
        coarse = rng.normal(size=rng.integers(2, 9, 2)).astype(np.float32)
        field = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    inside = field >= np.quantile(field, rng.uniform(0.3, 0.9))
    kept = np.where(inside, 1.0, rng.random() ** 2 / 3)[..., None].astype(np.float32)
    clean = reference
    if frame.albedo is not None and albedo is not None:
        # where next to nothing is reflected, the ratio would be noise
        textured = np.minimum(frame.albedo, albedo) > _DARK
        ratio = np.divide(frame.albedo, albedo, out=np.ones_like(albedo), where=textured)
        clean = reference * ratio
    color = clean + kept * (np.nan_to_num(frame.color) - clean)
    return replace(frame, color=color.astype(np.float32))


def fireflies(reference: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Single pixels and clusters, colored or white, ten to a million times as bright as a picture.

    Parameters
    ----------
    reference : (h, w, 3)
        The picture without any.
    rng
        Draws them.

    Returns
    -------
    (h, w, 3) float32 array
        Their radiance; 0 where there are none.
    """
    height, width = reference.shape[:2]
    usual = float(np.median(reference.mean(axis=-1))) or 1.0
    # clusters keep their shape where they meet the border
    light = np.zeros((height, width, 3), np.float32)
    # cubed: from hardly any to many
    for _ in range(rng.poisson(rng.random() ** 3 * _MOST * height * width)):
        size = int(rng.choice(_SIZES[0], p=_SIZES[1]))
        tint = rng.random(3) ** 2 if rng.random() < 0.5 else np.ones(3)
        value = usual * 10 ** rng.uniform(*_BRIGHTER) * tint
        top, left = int(rng.integers(height)), int(rng.integers(width))
        part = light[top : top + size, left : left + size]
        shape = _cluster(size, rng)[: part.shape[0], : part.shape[1], None]
        part[:] = shape * value
    return light


def _cluster(size: int, rng: np.random.Generator) -> np.ndarray:
    """The shape of a cluster of 1 to 3 pixels along each edge, 1 at its brightest.

    One pixel, or as a pixel filter spreads a sample: between four pixels evenly, around the middle
    of one less to the sides. Blocks of 3x3 that are bright alike are lamps.
    """
    if size <= _EVEN:
        return np.ones((size, size))
    weights = film_weights(rng.uniform(*DEVIATIONS))[1:-1]
    return np.outer(weights, weights) / weights.max() ** 2

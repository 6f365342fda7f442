"""Albedos that are noise: materials of which each sample draws one, painted over albedos.

What glass writes is the albedo of what is seen in it or through it, by chance; so do coats and
mixed materials. Their albedo has the noise of samples everywhere, at any count, and of scenes of
primitives a few pixels in a thousand show any.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stillray.frame import Frame
from stillray_training.draws import log_uniform
from stillray_training.fine_shapes import anywhere, ellipse, laid_over, rectangle, seen_through

_MOST = 4  # things of a picture that are of such materials
_EDGES = (4.0, 96.0)  # pixels, of a thing
_SHARES = (0.02, 0.98)  # of samples that draw the other material, in the middle of a thing
_RIM = (1.0, 6.0)  # power by which that grows to 1 at its rim, as what glass mirrors does
_RIMMED = 0.5  # share of the things of which it does
_GLINTS = 0.5  # share of the pictures that have glints
_MOST_GLINTS = 6
_GLINT_EDGES = (1.0, 16.0)  # pixels
_GLINT_SHARES = (0.03, 0.6)
_SHINING = (0.8, 30.0)  # albedo that renderers write of a lamp that is seen: its light


@dataclass(frozen=True, eq=False)
class Mixture:
    """Another material that some samples meet.

    Attributes
    ----------
    share : (h, w) float32
        The probability that a sample of a pixel draws it, [0, 1].
    albedo : (h, w, 3) float32
        What it writes then; of lamps above 1.
    """

    share: np.ndarray
    albedo: np.ndarray


def draw_mixtures(
    reference: np.ndarray, spread: float | None, rng: np.random.Generator
) -> list[Mixture]:
    """Things of mixed materials, and glints of lamps in them.

    Parameters
    ----------
    reference : (h, w, 3)
        An albedo without noise: things mirror it, or one colour.
    spread
        Standard deviation of the render's pixel filter, in pixels; None for that of a box.
    rng
        Draws their places, shapes, materials and how often samples meet them.
    """
    shape = reference.shape[:2]
    mixtures = []
    for _ in range(int(rng.integers(1, _MOST + 1))):
        inside, radius = _thing(shape, rng)
        share = np.full(shape, rng.uniform(*_SHARES), np.float32)
        if rng.random() < _RIMMED:
            share += (1 - share) * np.minimum(radius, 1) ** rng.uniform(*_RIM)
        mixtures.append(
            Mixture(
                share=seen_through(inside, spread) * share,
                albedo=_seen(reference, rng),
            )
        )
    if rng.random() < _GLINTS:
        for _ in range(int(rng.integers(1, _MOST_GLINTS + 1))):
            sides = (log_uniform(rng, _GLINT_EDGES), log_uniform(rng, _GLINT_EDGES))
            glint = ellipse(shape, anywhere(shape, rng), sides, rng.uniform(0, 180))
            light = np.float32(log_uniform(rng, _SHINING))
            mixtures.append(
                Mixture(
                    share=seen_through(glint, spread) * np.float32(rng.uniform(*_GLINT_SHARES)),
                    albedo=np.broadcast_to(light, reference.shape),
                )
            )
    return mixtures


def mixed_reference(reference: np.ndarray, mixtures: list[Mixture]) -> np.ndarray:
    """What an albedo ``(h, w, 3)`` becomes of endlessly many samples, [0, 1] float32."""
    for mixture in mixtures:
        reference = laid_over(reference, mixture.albedo, mixture.share[..., None])
    return np.clip(reference, 0, 1).astype(np.float32)


def mixed_frame(
    frame: Frame, mixtures: list[Mixture], samples: float, rng: np.random.Generator
) -> Frame:
    """A frame whose color is an albedo, of which so many samples a pixel draw their materials.

    Parameters
    ----------
    frame
        Mixtures stay where they are from frame to frame.
    mixtures
        The last in front of the others.
    samples
        Of a pixel, 1 or more.
    rng
        Draws the materials.
    """
    albedo, count = frame.color, max(round(samples), 1)
    for mixture in mixtures:
        met = rng.binomial(count, mixture.share[..., None]) / count
        albedo = laid_over(albedo, mixture.albedo, met)
    return replace(frame, color=np.clip(albedo, 0, 1).astype(np.float32))


def _thing(shape: tuple[int, int], rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Where a thing is, as finely as `seen_through` takes it, and how far a pixel is from its
    middle to its rim."""
    middle = anywhere(shape, rng)
    sides = (log_uniform(rng, _EDGES), log_uniform(rng, _EDGES))
    draw = ellipse if rng.random() < 0.6 else rectangle
    down, across = np.indices(shape, np.float32)
    radius = np.hypot(2 * (across - middle[0]) / sides[0], 2 * (down - middle[1]) / sides[1])
    return draw(shape, middle, sides, 0.0), radius


def _seen(reference: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """What samples see that draw the other material: the picture elsewhere, mirrored, or a colour,
    ``(h, w, 3)`` float32."""
    kind = rng.integers(4)
    if kind == 0:
        colour = np.float32(rng.integers(2))  # black or white, as mirrors are
        return np.broadcast_to(colour, reference.shape)
    if kind == 1:
        return np.broadcast_to(rng.random(3).astype(np.float32), reference.shape)
    moved = np.roll(reference[:, ::-1], tuple(rng.integers(0, reference.shape[:2])), (0, 1))
    return np.ascontiguousarray(moved, np.float32)

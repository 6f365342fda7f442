"""What a network of two branches reads: a frame and what is remembered, at the picture's pixels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.bounds import at_most
from stillray.families.feature_reconstruction import Accumulated, Enlarged

#: Of the mu-law (Kalantari and Ramamoorthi 2017): a three-hundredth of white lies at a third.
MU = 5000.0
#: Exposed radiance beyond it is read as it: the curve then ends at 2.1.
MOST_LIGHT = 1e4
#: Wavelengths over 2 pi of the sines that tell a count, as Vaswani et al. 2017 space them.
PERIODS = (1.0, 100.0)
FARTHEST = 69.0  # logarithm of the depth of what was not hit: 1e30


@dataclass(frozen=True, eq=False)
class Surfaces:
    """What else is known of a frame, at the picture's pixels.

    Attributes
    ----------
    normal : (H, W, 3) float32 or None
    roughness : (H, W) float32 or None
    depth : (H, W) float32 or None
        0 where nothing was hit.
    depth_unit
        Mean depth of what was hit.
    """

    normal: np.ndarray | None
    roughness: np.ndarray | None
    depth: np.ndarray | None
    depth_unit: float

    def of_rows(self, rows: slice) -> Surfaces:
        """The same of some rows."""

        def part(image: np.ndarray | None) -> np.ndarray | None:
            return None if image is None else image[rows]

        return Surfaces(part(self.normal), part(self.roughness), part(self.depth), self.depth_unit)


def tone_map(radiance: np.ndarray, exposure: float) -> np.ndarray:
    """``log(1 + mu x) / log(1 + mu)`` of exposed radiance, [0, 1] for what a display shows."""
    exposed = at_most(radiance, MOST_LIGHT / exposure) * np.float32(exposure)
    exposed *= np.float32(MU)
    exposed += 1
    mapped = cv2.log(exposed, dst=exposed)  # a seventh of the time of np.log1p, 6e-7 off at most
    mapped /= np.float32(np.log1p(MU))
    return mapped


def log_depth(depth: np.ndarray) -> np.ndarray:
    """Logarithm of depth; `FARTHEST` where nothing was hit."""
    far = np.float32(FARTHEST)
    with np.errstate(divide="ignore"):
        result: np.ndarray = np.where(depth > 0, np.log(depth), far)
    return np.clip(result, -far, far)


@dataclass(frozen=True, eq=False)
class Known:
    """All that planes are made of, at the picture's pixels.

    Attributes
    ----------
    frame, surfaces
        This frame; planes of what is missing are 0.
    accumulated
        Before this frame; all of it is 0 where it is not known.
    output : (H, W, 4) float32
        The last picture, and the logarithm of its depth; 0 where it is not known.
    exposure
        1 / radiance.
    offsets : (H,), (W,) float32
        See `stillray.families.target_grid.Grid`.
    """

    frame: Enlarged
    surfaces: Surfaces
    accumulated: Accumulated
    output: np.ndarray
    exposure: float
    offsets: tuple[np.ndarray, np.ndarray]

    def of_rows(self, rows: slice) -> Known:
        """The same of some rows."""
        frame, kept, (down, right) = self.frame, self.accumulated, self.offsets
        return Known(
            frame=Enlarged(frame.color[rows], frame.albedo[rows], frame.specular[rows]),
            surfaces=self.surfaces.of_rows(rows),
            accumulated=Accumulated(kept.light[rows], kept.albedo[rows], kept.specular[rows]),
            output=self.output[rows],
            exposure=self.exposure,
            offsets=(down[rows], right),
        )


def fill_planes(names: Sequence[str], out: np.ndarray, known: Known) -> None:
    """Fill the planes that a network asks for.

    Parameters
    ----------
    names
        Of `stillray.model_spec.loader.RADIANCE_FEATURES` and ``GUIDE_FEATURES``; some twice.
    out : (len(names), H, W) float32
        Written: values of a few units.
    known
        What they are made of.
    """
    found = dict(_light_planes(known))
    found.update(_count_planes(known.accumulated, set(names)))
    found.update(_surface_planes(known))
    found["offset.y"] = np.broadcast_to(known.offsets[0][:, None], out.shape[1:])
    found["offset.x"] = np.broadcast_to(known.offsets[1], out.shape[1:])
    for name, target in zip(names, out, strict=True):
        target[...] = found.get(name, 0)


def _light_planes(known: Known) -> Iterator[tuple[str, np.ndarray]]:
    """Light, tone-mapped, and albedos."""
    frame, kept = known.frame, known.accumulated
    for name, image in (("color", frame.color), ("past", kept.light), ("output", known.output)):
        yield from _channels(name, tone_map(image[..., :3], known.exposure))
    yield from _channels("albedo", frame.albedo)
    yield from _channels("specular", frame.specular)
    yield from _channels("past_albedo", kept.albedo)
    yield from _channels("past_specular", kept.specular)


def _count_planes(kept: Accumulated, wanted: set[str]) -> Iterator[tuple[str, np.ndarray]]:
    """Samples of what was accumulated, as sines and cosines."""
    images = {"past": kept.light, "past_albedo": kept.albedo, "past_specular": kept.specular}
    for name, image in images.items():
        for index, period in enumerate(PERIODS):
            angle = image[..., 3] / np.float32(period)
            for place, wave in ((2 * index, np.sin), (2 * index + 1, np.cos)):
                if f"{name}.count.{place}" in wanted:
                    yield f"{name}.count.{place}", wave(angle)


def _surface_planes(known: Known) -> Iterator[tuple[str, np.ndarray]]:
    """What is given of the surfaces, and where another one was before."""
    surfaces = known.surfaces
    if surfaces.normal is not None:
        yield from zip(("normal.x", "normal.y", "normal.z"), _last(surfaces.normal), strict=True)
    if surfaces.roughness is not None:
        yield "roughness", surfaces.roughness
    if surfaces.depth is not None:
        yield "depth", surfaces.depth / (surfaces.depth + np.float32(surfaces.depth_unit))
        change = np.clip(known.output[..., 3] - log_depth(surfaces.depth), -1, 1)
        remembered = known.accumulated.light[..., 3] > 0
        yield "depth.change", np.where(remembered, change, np.float32(0))


def _channels(name: str, image: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    yield from zip((f"{name}.r", f"{name}.g", f"{name}.b"), _last(image), strict=False)


def _last(image: np.ndarray) -> Iterator[np.ndarray]:
    return (image[..., channel] for channel in range(image.shape[-1]))

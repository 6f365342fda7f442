"""What a network of two branches reads: a frame and what is remembered, at the picture's pixels."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.bounds import at_most
from stillray.arrays.strips import planes_of
from stillray.arrays.workspace import Workspace
from stillray.families.feature_reconstruction import Accumulated, Enlarged

#: Of the mu-law (Kalantari and Ramamoorthi 2017): a three-hundredth of white lies at a third.
MU = 5000.0
#: Exposed radiance beyond it is read as it: the curve then ends at 2.1.
MOST_LIGHT = 1e4
#: Wavelengths over 2 pi of the sines that tell a count, as Vaswani et al. 2017 space them.
PERIODS = (1.0, 100.0)
_COLORS = 3
FARTHEST = 69.0  # logarithm of the depth of what was not hit: 1e30


@dataclass(frozen=True, eq=False)
class Surfaces:
    """What else is known of a frame, at the picture's pixels.

    Attributes
    ----------
    normal : (H, W, 3) float32 or None
    roughness : (H, W) float32 or None
    depth, log_depth : (H, W) float32 or None
        0 where nothing was hit; see `log_depth`.
    depth_unit
        Mean depth of what was hit.
    """

    normal: np.ndarray | None
    roughness: np.ndarray | None
    depth: np.ndarray | None
    log_depth: np.ndarray | None
    depth_unit: float

    def of_rows(self, rows: slice) -> Surfaces:
        """The same of some rows."""

        def part(image: np.ndarray | None) -> np.ndarray | None:
            return None if image is None else image[rows]

        return Surfaces(
            part(self.normal),
            part(self.roughness),
            part(self.depth),
            part(self.log_depth),
            self.depth_unit,
        )


def tone_map(radiance: np.ndarray, exposure: float, out: np.ndarray) -> np.ndarray:
    """``log(1 + mu x) / log(1 + mu)`` of exposed radiance, [0, 1] for what a display shows."""
    at_most(radiance, MOST_LIGHT / exposure, out=out)
    out *= np.float32(exposure * MU)
    out += 1
    cv2.log(out, dst=out)  # a seventh of the time of np.log1p, 6e-7 off at most
    out *= np.float32(1 / np.log1p(MU))
    return out


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
    offsets : (H,), (W,) float32
        See `stillray.families.target_grid.Grid`.
    """

    frame: Enlarged
    surfaces: Surfaces
    accumulated: Accumulated
    output: np.ndarray
    offsets: tuple[np.ndarray, np.ndarray]

    def of_rows(self, rows: slice) -> Known:
        """The same of some rows."""
        frame, kept, (down, right) = self.frame, self.accumulated, self.offsets
        return Known(
            frame=Enlarged(
                frame.color[rows], frame.albedo[rows], frame.specular[rows], frame.exposure
            ),
            surfaces=self.surfaces.of_rows(rows),
            accumulated=Accumulated(kept.light[rows], kept.albedo[rows], kept.specular[rows]),
            output=self.output[rows],
            offsets=(down[rows], right),
        )


def planes_by_name(names: Sequence[str], known: Known, workspace: Workspace) -> list[np.ndarray]:
    """The planes that a network asks for, ``(H, W)`` float32 each: values of a few units.

    Parameters
    ----------
    names
        Of `stillray.model_spec.planes.RADIANCE_FEATURES` and ``GUIDE_FEATURES``; some twice.
    known
        What they are made of.
    workspace
        Where they lie.
    """
    frame, kept = known.frame, known.accumulated

    def split(name: str, image: np.ndarray) -> np.ndarray:
        height, width, channels = image.shape
        return planes_of(image, out=workspace.array(f"planes of {name}", (channels, height, width)))

    found: dict[str, np.ndarray] = {}
    counts: dict[str, np.ndarray] = {}
    for name, image in (("color", frame.color), ("past", kept.light), ("output", known.output)):
        light = split(name, image)
        tone_map(light[:_COLORS], known.frame.exposure, out=light[:_COLORS])
        found.update(_colors(name, light))
        counts[name] = light[-1]
    for name, image in (
        ("albedo", frame.albedo),
        ("specular", frame.specular),
        ("past_albedo", kept.albedo),
        ("past_specular", kept.specular),
    ):
        albedo = split(name, image)
        found.update(_colors(name, albedo))
        counts[name] = albedo[-1]
    wanted = set(names)
    for name in ("past", "past_albedo", "past_specular"):
        found.update(_waves(name, counts[name], wanted, workspace))
    if known.surfaces.normal is not None:
        normal = split("normal", known.surfaces.normal)
        found.update(zip(("normal.x", "normal.y", "normal.z"), normal, strict=True))
    found.update(_distances(known, counts))
    shape = frame.color.shape[:2]
    found["offset.y"] = np.broadcast_to(known.offsets[0][:, None], shape)
    found["offset.x"] = np.broadcast_to(known.offsets[1], shape)
    nothing = np.broadcast_to(np.float32(0), shape)
    return [found.get(name, nothing) for name in names]


def _colors(name: str, planes: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    yield from zip((f"{name}.r", f"{name}.g", f"{name}.b"), planes, strict=False)


def _waves(
    name: str, count: np.ndarray, wanted: set[str], workspace: Workspace
) -> Iterator[tuple[str, np.ndarray]]:
    """Samples of what was accumulated, as sines and cosines."""
    for index, period in enumerate(PERIODS):
        angle = count / np.float32(period)
        for place, wave in ((2 * index, np.sin), (2 * index + 1, np.cos)):
            plane = f"{name}.count.{place}"
            if plane in wanted:
                yield plane, wave(angle, out=workspace.array(plane, count.shape))


def _distances(known: Known, counts: Mapping[str, np.ndarray]) -> Iterator[tuple[str, np.ndarray]]:
    """What else is given of the surfaces, and where another one was before."""
    surfaces = known.surfaces
    if surfaces.roughness is not None:
        yield "roughness", surfaces.roughness
    if surfaces.depth is not None and surfaces.log_depth is not None:
        yield "depth", surfaces.depth / (surfaces.depth + np.float32(surfaces.depth_unit))
        change = np.clip(counts["output"] - surfaces.log_depth, -1, 1)
        change[counts["past"] <= 0] = 0
        yield "depth.change", change

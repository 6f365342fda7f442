"""Patches of sequences to learn from, turned, recolored and painted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from stillray.errors import InputError
from stillray.families.target_grid import Grid
from stillray.frame import Frame
from stillray.model_spec import ModelSpec
from stillray.model_spec.decoders import FeatureFilters
from stillray.model_spec.training import Training
from stillray.stages.accumulate import bounded
from stillray_training.paint import blackened, repainted
from stillray_training.quiet import fireflies
from stillray_training.shade import moving_shade, switched
from stillray_training.upscaling.clip import Clip, of_several_samples
from stillray_training.upscaling.tails import with_tail
from stillray_training.upscaling.windows import through_window

_SWITCHED = 0.25  # share of the changes of light that are of all of it at once
_BLACK = 0.3  # share of painted patches whose light is not painted
_WANDERING = 0.5  # share of fireflies that come a pixel on with every frame
#: A frame of a patch: arrays by name, channels first.
Sample = dict[str, np.ndarray]


class ClipSampler:
    """Draws augmented patches of consecutive frames; the n-th batch depends on seed and n only.

    A batch has the recipe's frames, after none to ``warm_frames`` others, as far as the first of
    its sequences has so many; the rest of it is of sequences that are as long. ``fresh_share`` of
    the batches have none of those: first frames would be rare among long pasts. The last frame of
    a patch has a reference.

    Parameters
    ----------
    clips
        What to draw from.
    spec
        The model's specification.
    """

    def __init__(self, clips: list[Clip], spec: ModelSpec) -> None:
        assert isinstance(spec.decoder, FeatureFilters)
        recipe, self._scale = spec.training, spec.decoder.scale
        self._clips, self._spec = clips, spec
        self._side = recipe.patch // self._scale
        for clip in clips:
            least = min(clip.frames[0].shape)
            if len(clip.frames) < recipe.frames or least < self._side:
                raise InputError(
                    f"sequences must have {recipe.frames} frames of {self._side} pixels each way, "
                    f"got {len(clip.frames)} of {least}"
                )
        longest = max(len(clip.frames) for clip in clips)
        if longest < recipe.frames + recipe.warm_frames:
            raise InputError(
                f"one sequence at least must have {recipe.frames + recipe.warm_frames} frames "
                f"(training.warm_frames {recipe.warm_frames}), the longest has {longest}"
            )

    def batch(self, step: int) -> list[Sample]:
        """A batch of one training step: for each frame its arrays, ``(n, c, h, w)``."""
        recipe = self._spec.training
        rng = np.random.default_rng([recipe.seed, step])
        first = self._clips[rng.integers(len(self._clips))]
        warm = min(recipe.warm_frames, len(first.frames) - recipe.frames)
        if recipe.fresh_share and rng.random() < recipe.fresh_share:
            warm = 0
        count = recipe.frames + int(rng.integers(warm + 1))
        long = [clip for clip in self._clips if len(clip.frames) >= count]
        others = [long[rng.integers(len(long))] for _ in range(recipe.batch - 1)]
        clips = [self._patch(clip, rng, count) for clip in (first, *others)]
        return [
            {name: np.stack([clip[at][name] for clip in clips]) for name in clips[0][at]}
            for at in range(count)
        ]

    def _patch(self, clip: Clip, rng: np.random.Generator, count: int) -> list[Sample]:
        recipe = self._spec.training
        if clip.still and recipe.window_share and rng.random() < recipe.window_share:
            clip = through_window(clip, self._spec, rng)
        if clip.still and recipe.mean_share and rng.random() < recipe.mean_share:
            clip = of_several_samples(clip, count, rng)
        if recipe.tail_share and rng.random() < recipe.tail_share:
            clip = with_tail(clip, self._spec, rng)
        latest = len(clip.frames) - count
        starts = [at for at in range(latest + 1) if clip.references[at + count - 1] is not None]
        first = starts[rng.integers(len(starts))]
        height, width = clip.frames[0].shape
        top = int(rng.integers(height - self._side + 1))
        left = int(rng.integers(width - self._side + 1))
        change = _Change.drawn(rng, recipe)
        lights: list[np.ndarray | None] = [None] * count
        if recipe.firefly_share and rng.random() < recipe.firefly_share:
            shown = clip.references[first + count - 1]
            assert shown is not None
            lights = list(self._fireflies(shown.color, count, rng))
        samples = [
            self._sample(clip, first + number, (top, left), change, light)
            for number, light in enumerate(lights)
        ]
        side = (self._side * self._scale,) * 2
        if recipe.shade_share and rng.random() < recipe.shade_share:
            if rng.random() < _SWITCHED:
                shades = switched(side, count, rng)
            else:
                shades = moving_shade(side, count, rng, scale=self._scale)
            for sample, shade in zip(samples, shades, strict=True):
                # on the samples as they lie on the picture: each has the light of its place there
                self._multiply(sample, shade, ["color", "wanted"])
        if recipe.paint_share and rng.random() < recipe.paint_share:
            self._paint(samples, side, rng)
        return samples

    def _paint(
        self, samples: list[Sample], shape: tuple[int, int], rng: np.random.Generator
    ) -> None:
        """Multiply albedos by a texture, and the light by it too, unless it is black."""
        names = ["albedo", "specular", "wanted_albedo", "wanted_specular"]
        if rng.random() < _BLACK:
            paints = blackened(shape, len(samples), rng)
        else:
            paints = repainted(shape, len(samples), rng)
            names += ["color", "wanted"]
        for sample, paint in zip(samples, paints, strict=True):
            self._multiply(sample, paint, names)

    def _multiply(self, sample: Sample, factor: np.ndarray, names: list[str]) -> None:
        """Multiply what lies on the picture by ``(h, w, 1 or 3)``; with color, the frame's own."""
        for name in names:
            sample[name] = sample[name] * _planes(factor)
        if "color" in names:
            size = (self._side, self._side)
            own = cv2.resize(factor, size, interpolation=cv2.INTER_AREA)
            sample["shown"] = sample["shown"] * _planes(own)

    def _fireflies(
        self, reference: np.ndarray, count: int, rng: np.random.Generator
    ) -> Iterator[np.ndarray]:
        """Fireflies of frames in a row, ``(h, w, 3)`` each, 0 where there is none.

        Half of them come one pixel on with every frame, as a thing that moves has them.
        """
        # of a picture as bright as this one, and as large as a patch
        like = cv2.resize(reference, (self._side, self._side), interpolation=cv2.INTER_AREA)
        wandering = rng.random() < _WANDERING
        way = rng.integers(-1, 2, 2)
        light = fireflies(like, rng)
        for number in range(count):
            if wandering:
                yield np.roll(light, tuple(way * number), (0, 1))
            else:
                yield fireflies(like, rng)

    def _sample(
        self,
        clip: Clip,
        at: int,
        corner: tuple[int, int],
        change: _Change,
        fireflies_hwc: np.ndarray | None,
    ) -> Sample:
        frame, reference = clip.frames[at], clip.references[at]
        low = _window(corner, self._side, 1)
        high = _window(corner, self._side, self._scale)
        assert frame.motion is not None
        assert frame.jitter is not None
        motion = change.vectors(change.image(frame.motion[low]))
        jitter = change.vectors(frame.jitter * np.float32("jitter" not in change.without))
        multiple = 1  # patches are of whole blocks already
        grid = Grid.of((self._side, self._side), self._scale, multiple, jitter)
        every = slice(0, grid.full[0])
        positions, inside = grid.past_positions(np.ascontiguousarray(motion), every)

        if fireflies_hwc is not None:
            frame = self._lit(frame, low, fireflies_hwc, clip.exposures[at])

        def seen(image: np.ndarray) -> np.ndarray:
            return _planes(grid.take(change.image(image[low]), every))

        light = change.colors(frame.color)
        given = change.features(frame)
        right = np.broadcast_to(grid.right, grid.full)
        down = np.broadcast_to(grid.down[:, None], grid.full)
        known = reference is not None
        if reference is None:  # zeros, which `known` says are nothing
            nothing = np.zeros((*(self._scale * size for size in frame.shape), 3), np.float32)
            reference = Frame(color=nothing, albedo=nothing, specular_albedo=nothing)
        truth = change.references(reference)
        return {
            "color": seen(light),
            **{name: seen(image) for name, image in given.items()},
            "shown": _planes(change.image(light[low])),
            "moved": _planes(motion),
            "rows": grid.rows.astype(np.float32),
            "columns": grid.columns.astype(np.float32),
            "offset": np.stack([right, down]).astype(np.float32),
            "positions": positions,
            "inside": inside[None].astype(np.float32),
            "exposure": np.full((1, 1, 1), clip.exposures[at] * change.exposure, np.float32),
            "depth_unit": np.full((1, 1, 1), clip.depth_units[at], np.float32),
            **{name: _planes(change.image(image[high])) for name, image in truth.items()},
            "known": np.full((1, 1, 1), known, np.float32),
        }

    def _lit(
        self, frame: Frame, at: tuple[slice, slice], light: np.ndarray, exposure: float
    ) -> Frame:
        """A frame with fireflies in a window, as far as the runtime lets them through."""
        spec, color = self._spec, frame.color.copy()
        lit = np.where(light > 0, light, color[at])
        color[at] = bounded(lit, exposure, spec.transfer, spec.temporal)
        return replace(frame, color=color)


@dataclass(frozen=True, eq=False)
class _Change:
    """An augmentation, the same for all frames of a patch."""

    transposed: bool
    mirrored: tuple[bool, bool]  # x, y
    order: np.ndarray  # of the colours
    gain: np.ndarray
    rotation: np.ndarray  # of normals
    exposure: float
    without: frozenset[str]

    @classmethod
    def drawn(cls, rng: np.random.Generator, recipe: Training) -> _Change:
        """A random one of those of a recipe."""
        q, r = np.linalg.qr(rng.normal(size=(3, 3)))
        names = ("albedo", "specular", "normal", "roughness", "depth")
        stops = recipe.exposure_stops
        without = {name for name in names if rng.random() < recipe.drop_feature}
        if recipe.plain_share and rng.random() < recipe.plain_share:
            without |= {"jitter", "specular", "roughness"}
        return cls(
            transposed=bool(rng.integers(2)),
            mirrored=(bool(rng.integers(2)), bool(rng.integers(2))),
            order=rng.permutation(3),
            gain=np.exp(rng.normal(size=3) * 0.15).astype(np.float32),
            rotation=(q * np.sign(np.diag(r))).astype(np.float32),
            exposure=float(2 ** rng.uniform(-stops, stops)),
            without=frozenset(without),
        )

    def image(self, image: np.ndarray) -> np.ndarray:
        """Turned."""
        if self.transposed:
            image = image.swapaxes(0, 1)
        across, along = self.mirrored
        return image[:: -1 if along else 1, :: -1 if across else 1]

    def vectors(self, vectors: np.ndarray) -> np.ndarray:
        """Vectors ``(..., 2)`` turned like images."""
        if self.transposed:
            vectors = vectors[..., ::-1]
        signs = [-1 if mirrored else 1 for mirrored in self.mirrored]
        return vectors * np.array(signs, np.float32)

    def colors(self, image: np.ndarray) -> np.ndarray:
        """Radiance with its colours changed."""
        return image[..., self.order] * self.gain

    def features(self, frame: Frame) -> dict[str, np.ndarray]:
        """Features by the names of the network's inputs; zeros where left out."""
        assert frame.albedo is not None
        assert frame.specular_albedo is not None
        assert frame.normal is not None
        assert frame.roughness is not None
        assert frame.depth is not None
        found = {
            "albedo": frame.albedo[..., self.order],
            "specular": frame.specular_albedo[..., self.order],
            "normal": frame.normal @ self.rotation,
            "roughness": frame.roughness,
            "depth": frame.depth,
        }
        return {
            name: np.zeros_like(image) if name in self.without else image
            for name, image in found.items()
        }

    def references(self, reference: Frame) -> dict[str, np.ndarray]:
        """What is to come out; albedos that are left out are 0 there too."""
        assert reference.albedo is not None
        assert reference.specular_albedo is not None
        albedos = {"albedo": reference.albedo, "specular": reference.specular_albedo}
        return {
            "wanted": self.colors(reference.color),
            **{
                f"wanted_{name}": image[..., self.order] * np.float32(name not in self.without)
                for name, image in albedos.items()
            },
        }


def _window(corner: tuple[int, int], side: int, scale: int) -> tuple[slice, slice]:
    top, left = (scale * start for start in corner)
    return slice(top, top + scale * side), slice(left, left + scale * side)


def _planes(image: np.ndarray) -> np.ndarray:
    image = image[..., None] if image.ndim == 2 else image
    return np.ascontiguousarray(image.transpose(2, 0, 1), np.float32)

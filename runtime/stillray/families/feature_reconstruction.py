"""Enlarging, accumulating and denoising by Gaussians of feature distances.

Kazmierczyk et al. 2025, section 3.4: a frame is enlarged by a 3x3 filter whose weights fall with
the distance of predicted features, added to what was accumulated, divided by both albedos, denoised
at several resolutions, multiplied again, composed and mixed with the last output. What the paper
leaves open, or does otherwise:

- A filter's weight is ``exp(i_q - |f_p - f_q|^2)``: beside the distance a pixel has an importance
  of its own, whoever looks at it, so that a firefly can be left out.
- A past of ``n`` samples weighs ``n e^k`` against one of this frame, ``k`` predicted: logits of 0
  give the plain mean. The samples that a mean is worth are one over the sum of its squared weights.
- The partitioning pyramid (Balint et al. 2023): a pixel gives predicted shares of its light to the
  coarser levels, which are weighted means; from the coarsest on every level is mixed with the next,
  of twice its size, and filtered. So a filter smooths what was doubled, and ends it at edges. The
  coarsest level may go through several filters, whose pixels lie further apart first: there,
  where a pixel is 64, reach costs next to nothing.
- Light over diffuse albedo, over specular albedo, light as it is and this frame's light alone are
  composed by weights that add up to 1.

So every step is a convex combination: no light is invented.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.bounds import at_most
from stillray.arrays.resample import halve
from stillray.arrays.strips import STRIP_PIXELS, Strips, interleave, planes_of, with_halo
from stillray.families.filter_layout import GaussianPlanes, level_layout, target_layout
from stillray.families.gaussian import Weights, framed, gaussian, measured, share_of_bright
from stillray.families.logit_maps import LogitMaps, holds_nan, without_nan
from stillray.model_spec.decoders import FeatureFilters
from stillray.model_spec.stages import Demodulate
from stillray.models.steps import Output
from stillray.stages.demodulate import demodulation_planes

_PLANES = 9  # light over diffuse albedo, over specular albedo, and as it is


@dataclass(frozen=True, eq=False)
class Enlarged:
    """A frame at the picture's pixels, none of it filtered, ``(H, W, 3)`` float32.

    Attributes
    ----------
    color
        Radiance, finite and >= 0.
    albedo, specular
        In [0, 1]; zeros where there is none.
    exposure
        1 / radiance.
    """

    color: np.ndarray
    albedo: np.ndarray
    specular: np.ndarray
    exposure: float = 1.0


@dataclass(frozen=True, eq=False)
class Accumulated:
    """What was accumulated, ``(H, W, 4)`` float32: means, and the samples that they are worth.

    Attributes
    ----------
    light, albedo, specular
        As in `Enlarged`.
    """

    light: np.ndarray
    albedo: np.ndarray
    specular: np.ndarray

    @classmethod
    def empty(cls, shape: tuple[int, int]) -> Accumulated:
        """Room for means of a height and width."""
        return cls(*(np.empty((*shape, 4), np.float32) for _ in range(3)))


@dataclass(frozen=True, eq=False)
class Past:
    """What is remembered, at the pixels of this frame.

    Attributes
    ----------
    accumulated
        With no samples where the past is not known.
    output : (H, W, 4) float32
        The last picture; the fourth channel is not looked at.
    recalled : (H, W) float32 or None
        What light and picture weigh, as a share of what the network says; None: all of it.
    """

    accumulated: Accumulated
    output: np.ndarray
    recalled: np.ndarray | None = None


@dataclass(frozen=True, kw_only=True)
class Rules:
    """The numbers of a specification that a reconstruction obeys.

    Attributes
    ----------
    filters
        Features and the bound of logits.
    demodulate
        What light is divided by.
    max_samples
        That a mean is worth at most.
    most_blur
        Square pixels of the picture that a past may be blurred by looking between its pixels, see
        `stillray.stages.reproject.bound_blur`; 0: by any number.
    sharp_contrast
        Of the last output's edges, at which accumulated light is looked up as sharply as it, see
        `stillray.stages.reproject.Edges`; 0: nowhere.
    """

    filters: FeatureFilters
    demodulate: Demodulate
    max_samples: float
    most_blur: float = 0.0
    sharp_contrast: float = 0.0


def reconstruct(
    frame: Enlarged,
    past: Past | None,
    outputs: Sequence[Output],
    rules: Rules,
    strips: Strips,
    room: Accumulated,
) -> tuple[np.ndarray, Accumulated]:
    """The picture of a frame, and what is accumulated with it.

    Parameters
    ----------
    frame
        Of a size that all levels divide.
    past
        None where there is none.
    outputs
        The network's planes, the picture's by blocks of 2x2 pixels first, then a level each; any
        values, what is not a number counts as 0.
    rules
        Of the specification.
    strips
        Where the work runs.
    room
        Where what is accumulated lies.

    Returns
    -------
    image : (H, W, 3) float32
        Radiance: a convex combination of the light around, accumulated and new, each as it is or
        with the colour of another surface, and of the last output.
    accumulated
        For the next frame.
    """
    image, accumulated = _Reconstruction(frame, past, outputs, rules, strips, room).run()
    if np.isnan(image.max()) and holds_nan(outputs):
        outputs = without_nan(outputs)
        image, accumulated = _Reconstruction(frame, past, outputs, rules, strips, room).run()
    return image, accumulated


class _Reconstruction:
    """One frame's reconstruction: what its steps share."""

    def __init__(
        self,
        frame: Enlarged,
        past: Past | None,
        outputs: Sequence[Output],
        rules: Rules,
        strips: Strips,
        room: Accumulated,
    ) -> None:
        self._frame, self._past, self._rules, self._strips = frame, past, rules, strips
        self._size = (frame.color.shape[0], frame.color.shape[1])
        self._levels = len(outputs)
        self._layout = target_layout(self._levels, rules.filters)
        bound = rules.filters.logit_bound
        self._maps = [
            LogitMaps(given, bound, strips, by_blocks=level == 0)
            for level, given in enumerate(outputs)
        ]
        # this frame's light, filtered; what a frame leaves nothing of lies in the workspace
        self._enlarged = strips.workspace.array("enlarged light", (3, *self._size))
        self._light = strips.workspace.array("accumulated light", (4, *self._size))
        # by accumulated albedo and specular albedo
        self._divisors = strips.workspace.array("divisors", (6, *self._size))
        self._kept = room

    def run(self) -> tuple[np.ndarray, Accumulated]:
        self._filter(0, 3, self._layout.light, self._fill_color, self._accumulate_light)
        self._filter(0, 6, self._layout.guides, self._fill_guides, self._accumulate_guides)
        pools = self._pooled()
        coarser: np.ndarray | None = None
        for level in reversed(range(1, self._levels)):
            layout = level_layout(level, self._levels, self._rules.filters)
            coarser = self._denoised(level, pools[level - 1], layout.coarser, coarser)
        image = np.empty((*self._size, 3), np.float32)

        def fill(rows: slice, out: np.ndarray) -> None:
            self._light_planes(rows, out)
            if coarser is not None:
                self._mix(0, self._layout.coarser, coarser, rows, out)

        def finish(rows: slice, planes: np.ndarray) -> None:
            self._compose(rows, planes, image[rows])

        self._filter(0, _PLANES, self._layout.denoise, fill, finish)
        return image, self._kept

    def _logits(self, level: int, places: slice, rows: slice) -> np.ndarray:
        """Some rows of a level's maps, bounded: ``(n, rows, w)``."""
        shape = (places.stop - places.start, rows.stop - rows.start, self._size[1] >> level)
        return self._maps[level].numbers(places, rows, np.empty(shape, np.float32))

    def _weight(self, level: int, place: int, rows: slice) -> np.ndarray:
        """The weight that a map's rows stand for, ``(rows, w)``."""
        shape = (rows.stop - rows.start, self._size[1] >> level)
        return self._maps[level].weight(place, rows, np.empty(shape, np.float32))

    def _of_past(self, place: int, rows: slice) -> np.ndarray:
        """The weight that a map gives the past's light or picture, as far as it is recalled."""
        weight = self._weight(0, place, rows)
        if self._past is not None and self._past.recalled is not None:
            weight *= self._past.recalled[rows]
        return weight

    def _filter(
        self,
        level: int,
        channels: int,
        planes: GaussianPlanes,
        fill: Callable[[slice, np.ndarray], None],
        finish: Callable[[slice, np.ndarray], None],
        distance: int = 1,
    ) -> None:
        """Filter what ``fill`` writes for rows, ``(channels, rows, w)``; ``finish`` takes it."""
        height, width = self._size[0] >> level, self._size[1] >> level
        maps, strips = self._maps[level], self._strips
        tone, exposure = self._rules.filters.filter_tone, self._frame.exposure

        def work(rows: slice) -> None:
            workspace = strips.workspace
            near, _ = with_halo(rows, distance, height)
            high = rows.stop - rows.start + 2 * distance
            top = distance - (rows.start - near.start)
            filled = slice(top, top + near.stop - near.start)
            inside = slice(distance, distance + width)
            count = self._rules.filters.features
            parts = [
                framed(
                    workspace.array(name, (size, high, width + 2 * distance)), filled, distance
                )
                for name, size in (
                    ("values", channels), ("features", count), ("norms", 1), ("weight", 1)
                )
            ]  # fmt: skip
            values, features, norms, weight = parts
            fill(near, values[:, filled, inside])
            maps.numbers(planes.features, near, features[:, filled, inside])
            measured(features[:, filled, inside], norms[0, filled, inside])
            maps.weight(planes.importance, near, weight[0, filled, inside])
            if tone and channels == _PLANES:
                share = workspace.array("share", (near.stop - near.start, width))
                share_of_bright(values[6:, filled, inside], exposure, tone, share)
                weight[0, filled, inside] *= share
            out = workspace.array("filtered", (channels, high - 2 * distance, width))
            itself = weight[0, distance : high - distance, inside]
            weights = Weights(features, norms[0], weight[0], itself)
            gaussian(values, weights, out, workspace, distance)
            finish(rows, out)

        strips.run(work, height, width)

    def _fill_color(self, rows: slice, out: np.ndarray) -> None:
        out[:] = self._frame.color[rows].transpose(2, 0, 1)

    def _fill_guides(self, rows: slice, out: np.ndarray) -> None:
        out[:3] = self._frame.albedo[rows].transpose(2, 0, 1)
        out[3:] = self._frame.specular[rows].transpose(2, 0, 1)

    def _accumulate_light(self, rows: slice, planes: np.ndarray) -> None:
        self._enlarged[:, rows] = planes
        past = None if self._past is None else self._past.accumulated.light
        self._accumulate(rows, 0, planes, past, self._light[:, rows])
        interleave(self._light[:, rows], out=self._kept.light[rows])

    def _accumulate_guides(self, rows: slice, planes: np.ndarray) -> None:
        past = None if self._past is None else self._past.accumulated
        diffuse, specular = (None, None) if past is None else (past.albedo, past.specular)
        albedos, workspace = (self._kept.albedo, self._kept.specular), self._strips.workspace
        for index, (before, kept) in enumerate(zip((diffuse, specular), albedos, strict=True)):
            part = slice(3 * index, 3 * index + 3)
            albedo = workspace.array("accumulated albedo", (4, *planes.shape[1:]))
            self._accumulate(rows, 1 + index, planes[part], before, albedo)
            interleave(albedo, out=kept[rows])
            divisors, options = self._divisors[part, rows], self._rules.demodulate
            demodulation_planes(albedo[:3], options, divisors, workspace)

    def _accumulate(
        self, rows: slice, index: int, new: np.ndarray, past: np.ndarray | None, out: np.ndarray
    ) -> None:
        """The mean of the past and of rows ``(3, rows, w)`` of this frame: ``(4, rows, w)``."""
        if past is None:
            out[:3] = new
            out[3] = 1
            return
        place = self._layout.keep.start + index
        factor = self._weight(0, place, rows) if index else self._of_past(place, rows)
        before = planes_of(past[rows], out=self._strips.workspace.array("before", out.shape))
        held = np.multiply(factor, before[3], out=before[3])  # what it weighs against this frame
        total = held + 1
        np.multiply(total, total, out=out[3])
        factor *= held
        factor += 1
        out[3] /= factor
        at_most(out[3], self._rules.max_samples, out=out[3])
        for mean, was, now in zip(out[:3], before, new, strict=False):
            # two products, since a difference would cancel where a firefly meets a dark past
            np.multiply(held, was, out=mean)
            mean += now
            mean /= total

    def _light_planes(self, rows: slice, out: np.ndarray) -> None:
        """Accumulated light over diffuse albedo, over specular albedo, and as it is."""
        light = self._light[:3, rows]
        np.divide(light, self._divisors[:3, rows], out=out[:3])
        np.divide(light, self._divisors[3:, rows], out=out[3:6])
        out[6:] = light

    def _pooled(self) -> list[np.ndarray]:
        """Light planes of the coarser levels, ``(9, h, w)``: weighted means of what they are given.

        differs: Balint et al. 2023 add up what levels are given; here it is a mean, so that a
        level says the same however much it was given.
        """
        height, width = self._size[0] // 2, self._size[1] // 2
        count = self._levels - 1
        sums = [
            self._strips.workspace.array(f"sums {level}", (_PLANES + 1, height, width))
            for level in range(count)
        ]

        def work(rows: slice) -> None:
            fine = slice(2 * rows.start, 2 * rows.stop)
            planes = self._strips.workspace.array(
                "light planes", (_PLANES, fine.stop - fine.start, 2 * width)
            )
            self._light_planes(fine, planes)
            held = self._light[3, fine]
            shares = _shares(self._logits(0, self._layout.partition, fine))
            for level, share in zip(sums, shares[1:], strict=True):
                share *= held
                level[_PLANES, rows] = halve(share)
                for plane, target in zip(planes, level, strict=False):
                    target[rows] = halve(plane * share)

        self._strips.run(work, height, width, pixels=STRIP_PIXELS // 4)
        return [self._means(level, steps) for steps, level in enumerate(sums)]

    def _means(self, sums: np.ndarray, steps: int) -> np.ndarray:
        """Means of sums ``(10, h, w)``, halved so many times: ``(9, h >> steps, w >> steps)``."""
        height, width = (size >> steps for size in sums.shape[1:])
        means = self._strips.workspace.array(f"means {steps}", (_PLANES, height, width))

        def work(rows: slice) -> None:
            level = sums[:, rows.start << steps : rows.stop << steps]
            for _ in range(steps):
                level = np.stack([halve(plane) for plane in level])
            np.divide(level[:_PLANES], level[_PLANES], out=means[:, rows])

        self._strips.run(work, height, width, pixels=max(STRIP_PIXELS >> 2 * steps, 1))
        return means

    def _denoised(
        self, level: int, pool: np.ndarray, coarser: int | None, below: np.ndarray | None
    ) -> np.ndarray:
        """A coarser level, mixed with the next and filtered, ``(9, h, w)``."""
        layout = level_layout(level, self._levels, self._rules.filters)
        source, other = pool, self._strips.workspace.array(f"level {level}", pool.shape)

        def fill(rows: slice, out: np.ndarray) -> None:
            out[:] = source[:, rows]
            if coarser is not None and below is not None:
                self._mix(level, coarser, below, rows, out)

        def finish(rows: slice, planes: np.ndarray) -> None:
            other[:, rows] = planes

        for distance in layout.distances:
            self._filter(level, _PLANES, layout.denoise, fill, finish, distance)
            source, other = other, source
        return source

    def _mix(self, level: int, logit: int, below: np.ndarray, rows: slice, out: np.ndarray) -> None:
        """Mix rows of a level with the next coarser one, of twice its size."""
        share, rest = _sigmoids(self._weight(level, logit, rows))
        first = rows.start // 2
        source = below[:, first : -(-rows.stop // 2)]
        height, width = (2 * size for size in source.shape[1:])
        twice = self._strips.workspace.array("twice", (height, width))
        inside = twice[rows.start - 2 * first :][: len(share)]
        for plane, target in zip(source, out, strict=True):
            cv2.resize(plane, (width, height), dst=twice, interpolation=cv2.INTER_NEAREST)
            target *= rest
            cv2.accumulateProduct(inside, share, target)

    def _compose(self, rows: slice, planes: np.ndarray, image: np.ndarray) -> None:
        """Multiply by albedos, compose, and mix with the last output."""
        workspace = self._strips.workspace
        plain, *by_albedo, alone = _shares(self._logits(0, self._layout.compose, rows))
        light = workspace.array("composed", (3, *planes.shape[1:]))
        np.multiply(planes[6:], plain, out=light)
        for part, share in zip((slice(0, 3), slice(3, 6)), by_albedo, strict=True):
            divisors = self._divisors[part, rows]
            for plane, divisor, total in zip(planes[part], divisors, light, strict=True):
                plane *= share
                cv2.accumulateProduct(plane, divisor, total)
        for plane, total in zip(self._enlarged[:, rows], light, strict=True):
            cv2.accumulateProduct(plane, alone, total)
        if self._past is not None:
            keep, leave = _sigmoids(self._of_past(self._layout.output, rows))
            unknown = self._past.accumulated.light[rows, :, 3] <= 0
            keep[unknown], leave[unknown] = 0, 1
            light *= leave
            output = planes_of(
                self._past.output[rows], out=workspace.array("before", (4, *keep.shape))
            )
            for plane, total in zip(output, light, strict=False):
                cv2.accumulateProduct(plane, keep, total)
        interleave(light, out=image)


def _shares(logits: np.ndarray) -> np.ndarray:
    """Softmax of planes ``(n, h, w)`` and of one more before them, of logit 0."""
    weights = np.concatenate([np.ones_like(logits[:1]), np.exp(logits)])
    weights /= weights.sum(axis=0)
    return weights


def _sigmoids(odds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shares of one to the other, which is 1, and of that; what is given is written over."""
    rest: np.ndarray = np.reciprocal(odds + 1)
    odds *= rest
    return odds, rest

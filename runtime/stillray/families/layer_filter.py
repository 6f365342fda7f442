"""Other layers of a frame, filtered exactly as its color was: their sums stay sums.

All that kernels do to color is linear once their weights are known: the demodulation albedo, what a
sample weighs, where the past is taken from, the kernels, the blends, the resolve. So a layer goes
the way of the color again with the color's weights, and with a past of its own. Where layers add up
to the color, what comes out adds up to the denoised color, to float rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Protocol

import cv2
import numpy as np

from stillray.arrays.strips import Strips, interleave, planes_of
from stillray.arrays.workspace import Workspace
from stillray.families.contract import Context
from stillray.model_spec.loader import ModelSpec
from stillray.stages import accumulate as acc
from stillray.stages import previous_output
from stillray.stages import reproject as rep
from stillray.stages.decide import TemporalPlan
from stillray.stages.prepare import discontinuities
from stillray.stages.repair import fill
from stillray.stages.state import Filterable, LayerPast, Prepared

_ROUNDING = 1e-5  # relative: what a factor may differ from 1 by rounding alone


class Kernels(Protocol):
    """What filters: see `stillray.families.temporal_kernels.TemporalKernels`."""

    spec: ModelSpec
    sharp: bool

    def reconstruct(
        self,
        light: Filterable,
        outputs: Sequence[np.ndarray],
        strips: Strips,
        timings: dict[str, float],
    ) -> np.ndarray:
        """The radiance of what was accumulated."""
        ...

    def frozen(
        self, light: Filterable, outputs: Sequence[np.ndarray], strips: Strips
    ) -> Sequence[np.ndarray]:
        """Outputs that filter other light as they filtered the color's."""
        ...


class FilteredLayers:
    """Filters layers of a frame that has just been denoised, and collects what they remember.

    Parameters
    ----------
    kernels
        That filtered the frame.
    plan, prepared
        The frame as it was planned, and prepared with its ``sample``.
    outputs
        Of the network.
    context
        Where the work runs.
    """

    def __init__(
        self,
        kernels: Kernels,
        plan: TemporalPlan,
        prepared: Prepared,
        outputs: Sequence[np.ndarray],
        context: Context,
    ) -> None:
        self._kernels, self._plan, self._prepared = kernels, plan, prepared
        self._outputs, self._strips = outputs, context.strips
        #: By name, what the next frame needs.
        self.pasts: dict[str, LayerPast] = {}

    def __call__(self, name: str, radiance: np.ndarray, *, irradiance: bool = False) -> np.ndarray:
        """Filter a layer, see `stillray.families.contract.LayerFilter`."""
        prepared, past = self._prepared, self._plan.moved
        albedo = None if irradiance else prepared.demodulation_albedo
        light = self._repaired(radiance)
        light = light * self._factor if albedo is None else light / albedo * self._factor
        new, weight = planes_of(light), self._weight
        mean, sample = cv2.merge([light, weight]), None
        if self._accumulated is not None and past is not None:
            mean = self._accumulated(past.layers[name].mean, new)
            sample = np.concatenate([new, self._sample[3:]])
        own = Filterable(
            mean=mean,
            sample=sample,
            remodulation_albedo=None if irradiance else prepared.remodulation_albedo,
            previous=self._previous(name),
        )
        image = self._kernels.reconstruct(own, self._frozen, self._strips, {})
        if self._plan.wants.temporal:
            output: np.ndarray | None = None
            if self._plan.wants.previous_output:
                output = previous_output.keep(image, self._strips)
            self.pasts[name] = LayerPast(mean=mean, output=output)
        return image

    def _repaired(self, radiance: np.ndarray) -> np.ndarray:
        light = np.where(np.isfinite(radiance), radiance, np.float32(0))
        broken = self._plan.buffers.broken
        if broken is not None:
            light[broken] = 0
            light = fill(light, ~broken)
        return light

    def _previous(self, name: str) -> np.ndarray | None:
        past = self._plan.moved
        if past is None or self._follow is None:
            return None
        output = past.layers[name].output
        if output is None:
            return None
        return previous_output.forget_uncovered(self._follow(output), output, self._prepared)

    @cached_property
    def _sample(self) -> np.ndarray:
        """This frame's irradiance and what its samples weigh in new pixels, ``(4, h, w)``."""
        sample = self._prepared.sample
        return planes_of(self._prepared.history.mean) if sample is None else sample

    @property
    def _weight(self) -> np.ndarray:
        """What this frame's samples weighed beside the past, ``(h, w)``."""
        weight = self._prepared.sample_weight
        return self._sample[3] if weight is None else weight

    @cached_property
    def _frozen(self) -> Sequence[np.ndarray]:
        light = Filterable(mean=self._prepared.history.mean)
        return self._kernels.frozen(light, self._outputs, self._strips)

    @cached_property
    def _factor(self) -> np.ndarray:
        """What each pixel of the color was darkened by as an outlier, ``(h, w, 1)``.

        See `stillray.stages.accumulate.clamp_fireflies`: all channels of a pixel
        alike, so their sums tell.
        """
        color, albedo = self._plan.buffers.color, self._prepared.demodulation_albedo
        irradiance = color if albedo is None else color / albedo
        total = np.ones((1, 3), np.float32)
        before, after = cv2.transform(irradiance, total), self._sample[:3].sum(axis=0)
        factor = np.ones_like(before)
        np.divide(after, before, out=factor, where=before > 0)
        factor[np.abs(factor - 1) < _ROUNDING] = 1
        return factor[..., None]

    @cached_property
    def _follow(self) -> Callable[[np.ndarray], np.ndarray] | None:
        """How the previous outputs of layers are brought to these pixels."""
        past = self._plan.moved
        if past is None or past.output is None:
            return None
        positions = self._prepared.picture_positions
        return previous_output.layer_resampler(
            past.output, positions, self._strips, sharp=self._kernels.sharp
        )

    @cached_property
    def _accumulated(self) -> Callable[[np.ndarray, np.ndarray], np.ndarray] | None:
        """From a layer's past ``(h, w, 4)`` and its light ``(3, h, w)`` to its mean as the past's.

        None without a past.
        """
        past, prepared, strips = self._plan.moved, self._prepared, self._strips
        if past is None or prepared.motion is None:
            return None
        motion, before, now = prepared.motion, past.surface_guides, prepared.history.surface_guides
        weight, options = self._weight, self._kernels.spec.temporal
        mask: np.ndarray | None = None
        if before is not None and now is not None and motion.any():
            mask = discontinuities(before, strips, Workspace())

        def accumulated(mean: np.ndarray, light: np.ndarray) -> np.ndarray:
            result, previous = np.empty_like(mean), rep.PreviousFrame(mean, before, mask)

            def work(rows: slice) -> None:
                workspace = strips.workspace
                positions = rep.positions_of(motion[rows], rows) if motion[rows].any() else None
                geometry = None if now is None else planes_of(now[rows])
                warped = rep.reproject(previous, geometry, positions, rows, options, workspace)
                planes = planes_of(warped, out=workspace.array("mean", (4, *warped.shape[:2])))
                if prepared.history_confidence is not None:
                    planes[3] *= prepared.history_confidence[rows]
                prepared.counts.held_by_pixel(planes[3], rows)
                own = prepared.counts.weight_by_pixel(weight[rows], rows)
                acc.accumulate(light[:, rows], own, planes, options, workspace)
                prepared.counts.by_frame(planes[3], rows)
                interleave(planes, out=result[rows])

            strips.run(work, *mean.shape[:2])
            return result

        return accumulated

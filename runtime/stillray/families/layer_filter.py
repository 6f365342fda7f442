"""Other layers of a frame, filtered exactly as its color was: their sums stay sums.

All that kernels do to color is linear once their weights are known: the demodulation albedo, what a
sample weighs, where the past is taken from, the kernels, the blends, the resolve. So a layer goes
the way of the color again with the color's weights, and with a past of its own. Where layers add up
to the color, what comes out adds up to the denoised color, to float rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import cv2
import numpy as np

from stillray.arrays.gain import multiply_all
from stillray.arrays.strips import Strips, interleave, planes_of
from stillray.arrays.workspace import Workspace
from stillray.families.contract import Context, Layer
from stillray.families.views import mean_picture
from stillray.model_spec.loader import ModelSpec
from stillray.pixel_filter import filter_sharpness
from stillray.stages import accumulate as acc
from stillray.stages import previous_output
from stillray.stages import reproject as rep
from stillray.stages.decide import TemporalPlan
from stillray.stages.lamps import Restored, own_light
from stillray.stages.prepare import discontinuities
from stillray.stages.recall import believed
from stillray.stages.repair import fill
from stillray.stages.state import Filterable, LayerPast, Prepared, filterable

_ROUNDING = 1e-5  # relative: what a factor may differ from 1 by rounding alone

#: Of a network: arrays; `InSteps` where a family takes integers.
Outputs = Sequence[Any]


class Kernels(Protocol):
    """What filters: see `stillray.families.temporal_kernels.TemporalKernels`."""

    spec: ModelSpec
    sharp: bool

    def reconstruct(
        self,
        light: Filterable,
        outputs: Outputs,
        strips: Strips,
        timings: dict[str, float],
    ) -> np.ndarray:
        """The radiance of what was accumulated."""
        ...

    def frozen(self, light: Filterable, outputs: Outputs, strips: Strips) -> Sequence[np.ndarray]:
        """Outputs that filter other light as they filtered the color's."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Shading:
    """What was put back into a picture after it was filtered.

    Attributes
    ----------
    gain : (h, w) float32 or None
        What it was multiplied by, see `stillray.stages.relief`; None where it was not.
    texture : (h, w) float32 or None
        What it was multiplied by then, see `stillray.stages.texture`; None where it was not.
    restored
        The light of small lamps then, and what was there before, see `stillray.stages.lamps`;
        None where nobody looked for it.
    rare : (h, w) float32 or None
        What it was multiplied by last, see `stillray.stages.rare_light`; None where it was not.
    """

    gain: np.ndarray | None = None
    texture: np.ndarray | None = None
    restored: tuple[Restored, np.ndarray] | None = None
    rare: np.ndarray | None = None


class FilteredLayers:
    """Filters layers of a frame that has just been denoised, and collects what they remember.

    Parameters
    ----------
    kernels
        That filtered the frame.
    plan, prepared
        The frame as it was planned, and prepared with its ``sample``.
    outputs
        Of the network, for each view of the frame whose pictures were averaged.
    shading
        What was put back into the picture.
    context
        Where the work runs.
    """

    def __init__(
        self,
        kernels: Kernels,
        plan: TemporalPlan,
        prepared: Prepared,
        outputs: Sequence[Outputs],
        shading: Shading,
        context: Context,
    ) -> None:
        self._kernels, self._plan, self._prepared = kernels, plan, prepared
        self._outputs, self._shading, self._strips = outputs, shading, context.strips
        #: By name, what the next frame needs.
        self.pasts: dict[str, LayerPast] = {}

    def __call__(self, name: str, layer: Layer) -> np.ndarray:
        """Filter a layer, see `stillray.families.contract.LayerFilter`."""
        prepared, past = self._prepared, self._plan.moved
        albedo = None if layer.irradiance else prepared.demodulation_albedo
        accumulated = None if past is None else self._accumulated
        new, mean = self._demodulated(layer, albedo, alone=accumulated is None)
        sample: np.ndarray | None = None
        if accumulated is not None and past is not None:
            mean = accumulated(past.layers[name].mean, new[:3], layer.is_light)
            sample = new
        assert mean is not None
        own = Filterable(
            mean=self._believed(mean, sample),
            sample=sample,
            remodulation_albedo=None if layer.irradiance else prepared.remodulation_albedo,
            previous=self._previous(name, sharp=layer.is_light),
            filter_sharpness=filter_sharpness(prepared.filter_spread),
            recalled=prepared.recalled,
        )
        image = mean_picture(
            self._kernels.reconstruct(own, outputs, self._strips, {}) for outputs in self._frozen
        )
        for gain in (self._shading.gain, self._shading.rare):
            if gain is not None and layer.is_light:
                multiply_all(image, gain, self._strips)
        if self._plan.wants.temporal:
            output: np.ndarray | None = None
            if self._plan.wants.previous_output:
                output = previous_output.keep(image, self._strips)
            self.pasts[name] = LayerPast(mean=mean, output=output)
        # what follows is not remembered, as of the picture
        if self._shading.texture is not None and layer.is_light:
            multiply_all(image, self._shading.texture, self._strips)
        if self._shading.restored is not None:
            restored, _ = self._shading.restored
            light, at = own_light(own.sample, own.mean), (restored.rows, restored.columns)
            # a lamp's light is gained, too: it comes before the gain, as in the picture
            rare = 1.0 if self._shading.rare is None else self._shading.rare[*at, None]
            image[at] /= rare
            restored.put_back(image, light, own.remodulation_albedo)
            image[at] *= rare
        return image

    def _demodulated(
        self, layer: Layer, albedo: np.ndarray | None, *, alone: bool
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """A layer's irradiance as the color's was weighed.

        Parameters
        ----------
        layer, albedo
            The layer, and what it is divided by.
        alone
            Whether there is no past.

        Returns
        -------
        new : (4, h, w) float32
            Irradiance, and what its samples weigh in new pixels.
        mean : (h, w, 4) float32 or None
            The same with what they weigh beside the past, if it is all there is.
        """
        light = self._repaired(layer.radiance)
        factor = self._factor if layer.is_light else None
        weights, weight, shape = self._sample[3], self._weight, light.shape[:2]
        new = np.empty((4, *shape), np.float32)
        mean = np.empty((*shape, 4), np.float32) if alone else None

        def work(rows: slice) -> None:
            own = light[rows] if albedo is None else light[rows] / albedo[rows]
            if factor is not None:
                own = own * factor[rows, :, None]
            planes_of(own, out=new[:3, rows])
            new[3, rows] = weights[rows]
            if mean is not None:
                cv2.merge([own, weight[rows]], dst=mean[rows])

        self._strips.run(work, *shape)
        return new, mean

    def _believed(self, mean: np.ndarray, sample: np.ndarray | None) -> np.ndarray:
        """What is filtered of a layer's accumulated light ``(h, w, 4)``, as of the color's."""
        agreed = self._prepared.agreed
        if sample is None or agreed is None:
            return mean
        return believed(mean, sample, agreed, self._strips, np.empty_like(mean))

    def _repaired(self, radiance: np.ndarray) -> np.ndarray:
        broken, light = self._plan.buffers.broken, np.empty(radiance.shape, np.float32)

        def work(rows: slice) -> None:
            light[rows] = np.where(np.isfinite(radiance[rows]), radiance[rows], np.float32(0))
            if broken is not None:
                light[rows][broken[rows]] = 0

        self._strips.run(work, *radiance.shape[:2])
        return light if broken is None else fill(light, ~broken, self._strips)

    def _previous(self, name: str, *, sharp: bool) -> np.ndarray | None:
        past, strips = self._plan.moved, self._strips
        if past is None or past.output is None:
            return None
        output = past.layers[name].output
        if output is None:
            return None
        if sharp:
            here = self._follow(output)
        else:
            here = previous_output.resample(output, self._prepared.picture_positions, strips)
        return previous_output.forget_uncovered(here, output, self._prepared, strips)

    @cached_property
    def _sample(self) -> np.ndarray:
        """This frame's irradiance and what its samples weigh in new pixels, ``(4, h, w)``."""
        sample, mean = self._prepared.sample, self._prepared.history.mean
        if sample is not None:
            return sample
        planes = np.empty((4, *mean.shape[:2]), np.float32)

        def work(rows: slice) -> None:
            planes[:, rows] = planes_of(mean[rows])

        self._strips.run(work, *mean.shape[:2])
        return planes

    @property
    def _weight(self) -> np.ndarray:
        """What this frame's samples weighed beside the past, ``(h, w)``."""
        weight = self._prepared.sample_weight
        return self._sample[3] if weight is None else weight

    @cached_property
    def _frozen(self) -> list[Outputs]:
        light = filterable(self._prepared, None)
        return [self._kernels.frozen(light, each, self._strips) for each in self._outputs]

    @cached_property
    def _factor(self) -> np.ndarray:
        """What each pixel of the color was darkened by as an outlier, ``(h, w)``.

        See `stillray.stages.accumulate.clamp_fireflies`: all channels of a pixel
        alike, so their sums tell.
        """
        color, albedo = self._plan.buffers.color, self._prepared.demodulation_albedo
        total, sample = np.ones((1, 3), np.float32), self._sample
        factor = np.empty(color.shape[:2], np.float32)

        def work(rows: slice) -> None:
            irradiance = color[rows] if albedo is None else color[rows] / albedo[rows]
            before, after = cv2.transform(irradiance, total), sample[:3, rows].sum(axis=0)
            found = factor[rows]
            found.fill(1)
            np.divide(after, before, out=found, where=before > 0)
            found[np.abs(found - 1) < _ROUNDING] = 1

        self._strips.run(work, *color.shape[:2])
        return factor

    @cached_property
    def _follow(self) -> Callable[[np.ndarray], np.ndarray]:
        """How the previous outputs of layers of light are brought to these pixels."""
        past, positions = self._plan.moved, self._prepared.picture_positions
        assert past is not None
        assert past.output is not None
        return previous_output.layer_resampler(
            past.output, positions, self._strips, sharp=self._kernels.sharp
        )

    @cached_property
    def _accumulated(self) -> Callable[[np.ndarray, np.ndarray, bool], np.ndarray] | None:
        """From a layer's past ``(h, w, 4)`` and its light ``(3, h, w)`` to its mean as the past's.

        And whether it is sharpened as the color is. None without a past.
        """
        past, prepared, strips = self._plan.moved, self._prepared, self._strips
        if past is None or prepared.motion is None:
            return None
        motion, before, now = prepared.motion, past.surface_guides, prepared.history.surface_guides
        weight, options = self._weight, self._kernels.spec.temporal
        mask: np.ndarray | None = None
        if motion.any() and before is not None and now is not None:
            mask = discontinuities(before, strips, Workspace())

        def accumulated(mean: np.ndarray, light: np.ndarray, sharp: bool) -> np.ndarray:
            result = np.empty_like(mean)
            previous = rep.PreviousFrame(mean, before, mask, self._edges if sharp else None)

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

    @cached_property
    def _edges(self) -> rep.Edges | None:
        """Where layers of light are sharpened as the color's output is: else they do not add up.

        `_follow` makes the light of the same output, so that what lies in the workspace stays.
        """
        past, motion = self._plan.moved, self._prepared.motion
        if past is None or motion is None or not motion.any():
            return None
        return rep.Edges.of(past.output, self._kernels.spec.temporal.sharp_contrast, self._strips)

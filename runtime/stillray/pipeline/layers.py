"""Other layers of a frame, filtered exactly as its beauty was: their sums stay sums.

All that the pipeline does to color is linear once its weights are known: the divisor, what a sample
is worth, where the past is taken from, the kernels, the blends, the resolve. So a layer goes the
way of the beauty again with the beauty's weights, and with a past of its own. Where layers add up
to the beauty, what comes out adds up to the denoised beauty, to float rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np

from stillray.arrays.strips import Strips, interleave, planes_of
from stillray.arrays.workspace import Scratch
from stillray.errors import InputError
from stillray.families.registry import Family
from stillray.frame import Frame
from stillray.model_spec.loader import ModelSpec
from stillray.stages import accumulate as acc
from stillray.stages import previous_output as recall
from stillray.stages import reproject as rep
from stillray.stages.prepare import History, LayerPast, Prepared, rough_blocks
from stillray.stages.repair import fill, repair_radiance

_ROUNDING = 1e-5  # relative: what a factor may differ from 1 by rounding alone


def validated(layers: Mapping[str, np.ndarray], frame: Frame) -> dict[str, np.ndarray]:
    """Layers as float32.

    Raises
    ------
    InputError
        A layer has a wrong shape or type.
    """
    arrays = {}
    for name, layer in layers.items():
        array = np.asarray(layer)
        if array.shape != frame.color.shape:
            raise InputError(
                f"layer {name} must have shape {frame.color.shape} like color, got {array.shape}"
            )
        if array.dtype.kind != "f":
            raise InputError(f"layer {name} must be floating point, got {array.dtype}")
        arrays[name] = np.ascontiguousarray(array, np.float32)
    return arrays


def filter_layers(
    layers: Mapping[str, np.ndarray],
    frame: Frame,
    prepared: Prepared,
    history: History | None,
    outputs: Sequence[np.ndarray],
    spec: ModelSpec,
    family: Family,
    strips: Strips,
    *,
    irradiance: Collection[str] = (),
    temporal: bool,
) -> tuple[dict[str, np.ndarray], dict[str, LayerPast]]:
    """Filter layers of a frame that has just been denoised.

    Parameters
    ----------
    layers
        Name to ``(h, w, 3)`` float32 radiance, of any sign.
    frame, prepared
        The frame, and as it was prepared, with its ``sample``.
    history
        The past that it was prepared with; its ``layers`` are those of ``layers``.
    outputs
        Of the network, without their batch axis.
    spec, family
        Of the model.
    strips
        Where the work runs.
    irradiance
        Names of layers that are without the colour of surfaces: not divided by it.
    temporal
        Whether a next frame will want the layers' past.

    Returns
    -------
    images, pasts
        By name: ``(h, w, 3)`` float32 radiance, and what the next frame needs.
    """
    worth = planes_of(prepared.history.mean) if prepared.sample is None else prepared.sample
    weight = worth[3]
    factor = _factor(frame, prepared, worth)
    broken = ~np.isfinite(frame.color).all(axis=-1)
    accumulated = _accumulation(prepared, history, weight, spec, strips)
    if family.settle is not None:
        outputs = family.settle(prepared, outputs, spec, strips)
    follow: Callable[[np.ndarray], np.ndarray] | None = None
    if history is not None and history.output is not None and prepared.motion is not None:
        follow = recall.recall_of_layers(history.output, prepared.picture_positions, spec, strips)
    images, pasts = {}, {}
    for name, layer in layers.items():
        radiance = np.where(np.isfinite(layer), layer, np.float32(0))
        if broken.any():
            radiance[broken] = 0
            radiance = fill(radiance, ~broken)
        divisor, modulator = prepared.divisor, prepared.modulator
        if name in irradiance:
            divisor = modulator = None
        light = radiance * factor if divisor is None else radiance / divisor * factor
        new = planes_of(light)
        mean = cv2.merge([light, weight])
        previous: np.ndarray | None = None
        if accumulated is not None and history is not None and prepared.motion is not None:
            past = history.layers[name]
            mean = accumulated(past.mean, new)
            if past.output is not None and follow is not None:
                previous = follow(past.output)
                previous = recall.forget_uncovered(previous, past.output, prepared)
        own = replace(
            prepared,
            history=replace(prepared.history, mean=mean),
            sample=None if accumulated is None else np.concatenate([new, worth[3:]]),
            modulator=modulator,
        )
        images[name] = image = family.reconstruct(own, previous, outputs, spec, strips, {})
        if temporal:
            output = recall.remember(image, strips) if family.recalls else None
            pasts[name] = LayerPast(mean=mean, output=output)
    return images, pasts


def _factor(frame: Frame, prepared: Prepared, worth: np.ndarray) -> np.ndarray:
    """What each pixel of the beauty was darkened by as an outlier, ``(h, w, 1)``.

    See `stillray.stages.accumulate.bound`: all channels of a pixel alike, so their sums tell.
    """
    color, _ = repair_radiance(frame.color)
    irradiance = color if prepared.divisor is None else color / prepared.divisor
    total = np.ones((1, 3), np.float32)
    before, after = cv2.transform(irradiance, total), worth[:3].sum(axis=0)
    factor = np.ones_like(before)
    np.divide(after, before, out=factor, where=before > 0)
    factor[np.abs(factor - 1) < _ROUNDING] = 1
    return factor[..., None]


def _accumulation(
    prepared: Prepared,
    history: History | None,
    weight: np.ndarray,
    spec: ModelSpec,
    strips: Strips,
) -> Callable[[np.ndarray, np.ndarray], np.ndarray] | None:
    """From a layer's past ``(h, w, 4)`` and its light ``(3, h, w)`` to its mean as the past's.

    None without a past.
    """
    if history is None or prepared.motion is None:
        return None
    motion, before, now = prepared.motion, history.guides, prepared.history.guides
    rough: np.ndarray | None = None
    if before is not None and now is not None and motion.any():
        rough = rough_blocks(before, strips, Scratch())

    def accumulated(mean: np.ndarray, light: np.ndarray) -> np.ndarray:
        result = np.empty_like(mean)

        def work(rows: slice) -> None:
            scratch = strips.scratch
            positions = rep.positions_of(motion[rows], rows) if motion[rows].any() else None
            guides = None if now is None else planes_of(now[rows])
            past = rep.reproject(
                mean, before, rough, guides, positions, rows, spec.temporal, scratch
            )
            planes = planes_of(past, out=scratch.array("mean", (4, *past.shape[:2])))
            if prepared.worth is not None:
                planes[3] *= prepared.worth[rows]
            acc.accumulate(light[:, rows], weight[rows], planes, spec.temporal, scratch)
            interleave(planes, out=result[rows])

        strips.run(work, *mean.shape[:2])
        return result

    return accumulated

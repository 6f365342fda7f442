"""The planes that a network reads: the twin of `stillray.stages.features`."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from stillray.errors import InputError
from stillray.model_spec import ModelSpec
from stillray.model_spec.planes import PIXEL_FILTER
from stillray.pixel_filter import BOX_SPREAD, SOFT_SPREAD
from stillray.stages.features import FILTER_MIDDLE, FILTER_RANGE
from stillray_export.frame_graph.light import tone_map
from stillray_training.decoders.luminance import luminance


@dataclass(frozen=True, eq=False)
class Prepared:
    """What is known of a frame before the network: planes ``(1, c, h, w)`` and scalars.

    Attributes
    ----------
    irradiance, held
        Accumulated, and the samples that each pixel holds.
    light, radiance, local
        Luminance of this frame's irradiance, and of its radiance; of what is usual around a pixel,
        tone-mapped.
    albedo, normal, depth
        0 where not given.
    divisor, previous, valid
        What radiance is divided by; the last output and how much of it is valid.
    exposure, depth_unit, told
        Scalars: 1 / irradiance, of depth, samples a pixel.
    filter_spread
        Scalar: of the renderer's pixel filter, pixels, below 0 where not given; None where nobody
        asks.
    recalled : (1, 1, h, w) or None
        What the last output weighs in the resolve, as a share of what the network says; None: 1.
    """

    irradiance: Tensor
    held: Tensor
    light: Tensor
    radiance: Tensor
    local: Tensor
    albedo: Tensor
    normal: Tensor
    depth: Tensor
    divisor: Tensor
    previous: Tensor
    valid: Tensor
    exposure: Tensor
    depth_unit: Tensor
    told: Tensor
    filter_spread: Tensor | None = None
    recalled: Tensor | None = None


def feature_planes(frame: Prepared, spec: ModelSpec) -> Tensor:
    """The planes by the specification's names, ``(1, features, h, w)``.

    Raises
    ------
    InputError
        A frame graph has no such plane.
    """
    planes = {
        **_of_light(frame),
        **_named("albedo", "rgb", frame.albedo),
        **_named("normal", "xyz", frame.normal),
        "albedo.luminance": luminance(frame.albedo),
        "depth": frame.depth / (frame.depth + frame.depth_unit),
        "previous.valid": frame.valid,
        "samples": samples_plane(frame, spec),
        PIXEL_FILTER: _filter(frame),
    }
    for name in spec.network.features:
        if name not in planes:
            raise InputError(f"network.features of a frame graph must not be {name}")
    return torch.cat([planes[name] for name in spec.network.features], 1)


def _of_light(frame: Prepared) -> dict[str, Tensor]:
    def shown(light: Tensor) -> Tensor:
        return tone_map(light, frame.exposure).sqrt()

    past = shown(frame.previous / frame.divisor)
    whole = luminance(frame.previous) / luminance(frame.divisor)
    return {
        **_named("irradiance", "rgb", shown(frame.irradiance)),
        **_named("previous", "rgb", past),
        "irradiance.luminance": shown(luminance(frame.irradiance)),
        "previous.luminance": shown(whole),
        "sample.luminance": shown(frame.light),
        "local_luminance": frame.local.clamp(min=0).sqrt(),
    }


def samples_plane(frame: Prepared, spec: ModelSpec) -> Tensor:
    """What the network is told of samples, ``(1, 1, h, w)``."""
    # to a network that has seen one sample a pixel alone, more look like a long past
    held = frame.held
    if spec.knows_samples:
        held = held * torch.maximum(spec.told_samples.share * frame.told, frame.told.clamp(max=1))
    return (held / (held + spec.temporal.max_samples / 4)).sqrt()


def filter_sharpness(spread: Tensor | None) -> Tensor | float:
    """The twin of `stillray.pixel_filter.filter_sharpness`; below 0 nobody said."""
    if spread is None:
        return 1.0
    # what is below 0 lies on the box's side, as it should
    return ((SOFT_SPREAD - spread) / (SOFT_SPREAD - BOX_SPREAD)).clamp(0, 1)


def _filter(frame: Prepared) -> Tensor:
    unknown = torch.zeros_like(frame.depth)
    spread = frame.filter_spread
    if spread is None:
        return unknown
    told = ((spread - FILTER_MIDDLE) / FILTER_RANGE).clamp(-1, 1)
    return unknown + torch.where(spread < 0, 0.0, told)


def _named(name: str, channels: str, planes: Tensor) -> dict[str, Tensor]:
    return {f"{name}.{letter}": planes[:, i : i + 1] for i, letter in enumerate(channels)}

"""One step of the recurrence, differentiable: the twin of `stillray.families.feature_filters`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from stillray.families.feature_reconstruction import Rules
from stillray.families.target_planes import FARTHEST, MOST_LIGHT, MU, PERIODS
from stillray.stages.reproject import LEAST_BLUR
from stillray_training.decoders.feature_filters import Enlarged, Remembered, reconstruct
from stillray_training.decoders.luminance import luminance
from stillray_training.upscaling.agreement import recalling, reject_history


def step(
    network: nn.Module,
    frame: Mapping[str, Tensor],
    before: Remembered | None,
    names: Sequence[str],
    rules: Rules,
) -> tuple[Tensor, Remembered, Tensor | None]:
    """A frame's picture.

    Parameters
    ----------
    network
        Gives the planes of the reconstruction.
    frame
        Of `stillray_training.upscaling.clips.ClipSampler`.
    before
        What the last frame left.
    names
        Planes that the network reads.
    rules
        Of the specification.

    Returns
    -------
    image : (n, 3, h, w)
        Radiance.
    after
        For the next frame.
    recalled : (n, 3, h, w) or None
        The last picture at this frame's pixels, 0 where it was not in it.
    """
    size = frame["color"].shape
    past = Remembered(*(frame["color"].new_zeros(size[0], 4, *size[2:]) for _ in range(4)))
    if before is not None:
        images = (before.light, before.albedo, before.specular, before.output)
        moved = warped(torch.cat(images, 1), frame["positions"])
        factor, contrast = sharpness(before.output, frame["positions"])
        light, others, output, depth = moved.split([3, 9, 3, 1], 1)
        if rules.filters.sharp_recall:
            output = output * factor
        if rules.sharp_contrast:
            light = torch.where(contrast > rules.sharp_contrast, light * factor, light)
        moved = torch.cat([light, others, output, depth], 1)
        past = Remembered(*(moved * frame["inside"]).split(4, 1), noises=before.noises)
        if rules.most_blur:
            most = rules.most_blur / look_blur(frame["positions"])
            light, albedo, specular = (
                _at_most(image, most) for image in (past.light, past.albedo, past.specular)
            )
            past = replace(past, light=light, albedo=albedo, specular=specular)
        past = reject_history(past, frame, rules.filters.scale)
        if rules.filters.recall_noise:
            past = recalling(past, frame, rules.filters.recall_noise)
    planes = network_planes(frame, past, names)
    outputs = network(planes)
    given = Enlarged(frame["color"], frame["albedo"], frame["specular"], frame["exposure"])
    image, (light, albedo, specular) = reconstruct(given, past, outputs, rules)
    output = torch.cat([image, log_depth(frame["depth"])], 1)
    after = Remembered(light, albedo, specular, output, noises=past.noises)
    return image, after, None if before is None else past.output[:, :3]


def warped(images: Tensor, positions: Tensor, mode: str = "bilinear") -> Tensor:
    """Images at positions ``(n, h, w, 2)`` within them, pixels."""
    height, width = images.shape[2:]
    # numbers, not a tensor of them: a device would wait for it
    sides = zip(positions.unbind(-1), (width, height), strict=True)
    at = torch.stack([place * (2 / max(side - 1, 1)) for place, side in sides], -1) - 1
    return F.grid_sample(images, at, mode=mode, padding_mode="border", align_corners=True)


def sharpness(images: Tensor, positions: Tensor) -> tuple[Tensor, Tensor]:
    """What makes `warped` as sharp as limited cubic convolution, and the contrast that it is among.

    See `stillray.stages.sharpening`; cubic convolution has the factor of OpenCV and of torch.

    Parameters
    ----------
    images : (n, 3 or more, h, w)
        Radiance first.
    positions : (n, h, w, 2)
        Within them, pixels.

    Returns
    -------
    factor : (n, 1, h, w)
    contrast : (n, 1, h, w)
        The brightest of the four pixels around over the darkest.
    """
    light = luminance(images)
    around = F.pad(light, (0, 1, 0, 1), mode="replicate")
    most, least = F.max_pool2d(around, 2, 1), -F.max_pool2d(-around, 2, 1)
    # of one channel OpenCV's places are 1/32 pixel apart
    cubic = warped(light, (32 * positions).round() / 32, "bicubic")
    corner = positions.floor()
    least, most = (warped(limit, corner, "nearest") for limit in (least, most))
    factor = torch.clamp(cubic, least, most) / warped(light, positions).clamp(min=1e-30)
    return factor, most / least.clamp(min=1e-30)


def look_blur(positions: Tensor) -> Tensor:
    """Square pixels by which a look at positions ``(n, h, w, 2)`` blurs, ``(n, 1, h, w)``.

    See `stillray.stages.reproject.bound_blur`.
    """
    share = positions - positions.floor()
    return (share * (1 - share)).sum(-1).clamp(min=LEAST_BLUR)[:, None]


def _at_most(image: Tensor, most: Tensor) -> Tensor:
    """An image whose last channel, its samples, is bounded."""
    return torch.cat([image[:, :3], torch.minimum(image[:, 3:], most)], 1)


def log_depth(depth: Tensor) -> Tensor:
    """See `stillray.families.target_planes.log_depth`."""
    far = torch.full_like(depth, FARTHEST)
    safe = torch.where(depth > 0, depth, torch.ones_like(depth))
    return torch.where(depth > 0, safe.log(), far).clamp(-FARTHEST, FARTHEST)


def network_planes(frame: Mapping[str, Tensor], past: Remembered, names: Sequence[str]) -> Tensor:
    """The network's input, see `stillray.families.target_planes.fill_planes`."""
    found: dict[str, Tensor] = {}

    def add(name: str, parts: str, image: Tensor) -> None:
        channels = image.split(1, 1)
        found.update({f"{name}.{part}": c for part, c in zip(parts, channels, strict=False)})

    exposure = frame["exposure"]
    for name, image in (("color", frame["color"]), ("past", past.light), ("output", past.output)):
        add(name, "rgb", _tone_mapped(image[:, :3], exposure))
    for name, image in (
        ("albedo", frame["albedo"]),
        ("specular", frame["specular"]),
        ("past_albedo", past.albedo),
        ("past_specular", past.specular),
    ):
        add(name, "rgb", image)
    for name, image in (
        ("past", past.light), ("past_albedo", past.albedo), ("past_specular", past.specular)
    ):  # fmt: skip
        waves = []
        for period in PERIODS:
            waves += [(image[:, 3:] / period).sin(), (image[:, 3:] / period).cos()]
        add(f"{name}.count", "0123", torch.cat(waves, 1))
    add("normal", "xyz", frame["normal"])
    add("offset", "xy", frame["offset"])
    found["roughness"] = frame["roughness"]
    depth = frame["depth"]
    given = (depth.amax((1, 2, 3), keepdim=True) > 0).to(depth.dtype)  # else it was left out
    found["depth"] = depth / (depth + frame["depth_unit"])
    change = (past.output[:, 3:] - log_depth(depth)).clamp(-1, 1)
    found["depth.change"] = change * (past.light[:, 3:] > 0) * given
    return torch.cat([found[name] for name in names], 1)


def _tone_mapped(radiance: Tensor, exposure: Tensor) -> Tensor:
    exposed = (radiance * exposure).clamp(max=MOST_LIGHT)
    return (exposed * MU).log1p() / math.log1p(MU)

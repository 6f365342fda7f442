"""What a filter of Open Image Denoise does, done by a `Denoiser`: ranges, curves and guides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from stillray.arrays.encoding import Encoding
from stillray.errors import InputError
from stillray.frame import GUIDES, Frame
from stillray.models.registry import for_single_frames
from stillray.oidn.constants import OIDN_FILTER_TYPE_RT, OIDN_FILTER_TYPE_RT_LIGHTMAP
from stillray.pipeline.denoiser import Denoiser
from stillray.pipeline.tiles import MemoryUse

#: What filters an albedo that is given alone.
ALBEDO_MODEL = "kpyr-5s-albedo"
FILTER_TYPES = (OIDN_FILTER_TYPE_RT, OIDN_FILTER_TYPE_RT_LIGHTMAP)


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """Of a filter; those that change nothing here are not among them.

    Attributes
    ----------
    filter_type
        ``"RT"`` or ``"RTLightmap"``; color of the latter is HDR, or directional.
    hdr, srgb, directional
        What the color's values are; linear in [0, 1] where none is set.
    clean_aux
        Whether albedo has no noise, or was filtered before: it is not filtered again.
    max_memory_mb
        MiB that the network and the reconstruction may take beside the frame's buffers, which
        are done in tiles then; negative for no bound.
    """

    filter_type: str = OIDN_FILTER_TYPE_RT
    hdr: bool = False
    srgb: bool = False
    directional: bool = False
    clean_aux: bool = False
    max_memory_mb: int = -1

    @property
    def color_encoding(self) -> Encoding:
        """What the color's numbers are."""
        if self.filter_type == OIDN_FILTER_TYPE_RT_LIGHTMAP:
            return Encoding.SIGNED if self.directional else Encoding.HDR
        if self.hdr:
            return Encoding.HDR
        return Encoding.SRGB if self.srgb else Encoding.LDR


def model_for(images: Mapping[str, np.ndarray], quality: str) -> str:
    """The model, as `stillray.Denoiser` takes it, that filters images at a quality."""
    if set(images) == {"albedo"}:
        return ALBEDO_MODEL
    # normals that are filtered themselves guide nothing
    guided = "color" in images and not images.keys().isdisjoint(GUIDES)
    return for_single_frames(quality, guided=guided)


def filtered(
    images: Mapping[str, np.ndarray], parameters: Parameters, denoiser: Denoiser
) -> np.ndarray:
    """Filter color by itself and its guides; or, without color, albedo or normal alone.

    Parameters
    ----------
    images
        ``"color"``, ``"albedo"``, ``"normal"``: ``(h, w, 3)``, or of one channel, float16 or
        float32. Not changed.
    parameters
        What the values mean.
    denoiser
        With ``temporal=False``.

    Returns
    -------
    (h, w, channels) float32
        The picture, with as many channels and in the same curve and range as what was filtered.

    Raises
    ------
    InputError
        There is nothing to filter, sizes differ, or the memory does not suffice.
    """
    name, encoding = _subject(images, parameters)
    subject = images[name]
    for other, image in images.items():
        if image.shape[:2] != subject.shape[:2]:
            raise InputError(
                f"{other} must have {name}'s size {subject.shape[:2]}, got {image.shape[:2]}"
            )
    guides: dict[str, Any] = {}
    # coefficients of a direction are not divided by albedo, and a guide has no guide
    if name == "color" and encoding is not Encoding.SIGNED:
        guides = {n: _three(images[n]) for n in GUIDES if n in images}
    frame = Frame(color=_three(subject), clean_features=parameters.clean_aux, **guides)
    denoiser.max_memory = None
    if parameters.max_memory_mb >= 0:
        scratch = parameters.max_memory_mb << 20
        use = MemoryUse(channels=frame.channels, past=False)
        denoiser.max_memory = use.floor_bytes(frame.shape) + scratch
    result = denoiser.denoise(frame, encoding=encoding.value)
    return result if subject.shape[2] == 3 else result[..., :1]


def _subject(images: Mapping[str, np.ndarray], parameters: Parameters) -> tuple[str, Encoding]:
    if "color" in images:
        return "color", parameters.color_encoding
    if len(images) == 1 and parameters.filter_type == OIDN_FILTER_TYPE_RT:
        if "albedo" in images:
            return "albedo", Encoding.LDR
        if "normal" in images:
            return "normal", Encoding.SIGNED
    raise InputError(
        f"color must be given, or albedo or normal alone to an RT filter, got "
        f"{' and '.join(images) or 'no image'}"
    )


def _three(image: np.ndarray) -> np.ndarray:
    return image if image.shape[2] == 3 else np.repeat(image, 3, axis=2)

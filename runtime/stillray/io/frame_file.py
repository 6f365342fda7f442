"""A frame from its files, of whatever kind: EXR files, float maps, or some of both."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray.frame import Frame
from stillray.io.channels.motion_convention import MotionConvention
from stillray.io.channels.roles import find_layers
from stillray.io.exr.file import ExrFile
from stillray.io.exr.layers import check_layer
from stillray.io.exr.read import read_exr
from stillray.io.exr.views import VIEW
from stillray.io.image_file import check_suffix, is_float_map, read_image

_MOTION = 2  # channels; a float map has one more, of which nothing is known


def views_to_denoise(path: Path, layers: Mapping[str, str]) -> tuple[str, ...]:
    """Views of a file, all of which are denoised: two or more, or none where one was chosen.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    if is_float_map(path) or VIEW in layers:
        return ()
    views = ExrFile.open(path, headers_only=True).views
    return views if len(views) > 1 else ()


def check_buffer(path: Path, role: str, layers: Mapping[str, str] | None = None) -> None:
    """Raise `InputError` where a file is of no known kind, or lacks the buffer of that role.

    Of files with several views each is looked at, unless one was chosen. Pixels are not read.
    """
    if is_float_map(path):
        if not path.is_file():
            raise InputError(f"{path}: no such file")
        return
    for view in views_to_denoise(path, layers or {}) or (None,):
        check_layer(path, role, layers if view is None else {**(layers or {}), VIEW: view})


def roles_of(path: Path, layers: Mapping[str, str]) -> frozenset[str]:
    """Roles of the buffers that are taken from a file, or from the view of it that was chosen.

    Motion whose meaning has to be proven is not among them. Pixels are not read.

    Raises
    ------
    InputError
        The file cannot be read, or lacks a layer that was named.
    """
    if is_float_map(path):
        return frozenset({"color"})
    file = ExrFile.of_layers(path, layers, headers_only=True)
    return frozenset(match.role for match in find_layers(file.channels, layers) if match.used)


def read_frame(
    path: Path,
    companions: Mapping[str, str | os.PathLike[str]],
    *,
    layers: Mapping[str, str] | None = None,
    convention: MotionConvention | None = None,
    before: Path | None = None,
    samples: float | None = None,
) -> Frame:
    """Read one frame; as `read_exr` where all files are EXR.

    Parameters
    ----------
    path
        The file with the color.
    companions
        Files of other buffers by role. Motion in a float map is in its first two channels, in
        `Frame`'s own convention; depth in its first.
    layers, convention, before, samples
        As for `read_exr`; for EXR files alone, but samples.

    Raises
    ------
    InputError
        A file cannot be read, lacks its buffer, or differs in size.
    """
    given = {role: Path(name) for role, name in companions.items()}
    if is_float_map(path):
        frame = Frame(color=_of_channels(read_image(path, "color"), 3), samples=samples)
        maps = given
    else:
        maps = {role: name for role, name in given.items() if is_float_map(name)}
        frame = read_exr(
            path,
            companions={role: name for role, name in given.items() if role not in maps},
            layers=layers,
            convention=convention,
            before=before,
            samples=samples,
        )
    buffers: dict[str, Any] = {
        role: _companion(role, name, frame, path) for role, name in maps.items()
    }
    return replace(frame, **buffers)


def _companion(role: str, path: Path, frame: Frame, beside: Path) -> np.ndarray:
    image = read_image(check_suffix(path), role)
    if image.shape[:2] != frame.shape:
        raise InputError(
            f"{path}: {role} must have the size {frame.shape} of {beside}, got {image.shape[:2]}"
        )
    if role == "depth":
        return image[..., 0] if image.ndim == 3 else image
    return _of_channels(image, _MOTION if role == "motion" else 3)


def _of_channels(image: np.ndarray, count: int) -> np.ndarray:
    """The first channels, or one that stands for all."""
    return image[..., :count] if image.shape[2] >= count else np.repeat(image, count, axis=2)

"""Reading OpenEXR files: a frame's buffers, lights beside it, single channels."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray.frame import Frame, check_samples
from stillray.io.channels.motion_convention import MotionConvention
from stillray.io.channels.roles import gather
from stillray.io.exr.container import Window
from stillray.io.exr.file import Channels, ExrFile
from stillray.io.exr.jitter import find_jitter
from stillray.io.exr.layers import (
    color_and_more,
    companion_file,
    lights_by_whole_name,
    require_alone,
    with_colors,
)
from stillray.io.exr.openimageio import checked_container, opened
from stillray.io.exr.pixel_filter import find_filter
from stillray.io.exr.samples import find_samples
from stillray.io.exr.views import VIEW

#: Roles of buffers that a file of their own may hold.
COMPANIONS = ("albedo", "normal", "depth", "motion", "color_b")


def read_exr(
    path: str | os.PathLike[str],
    *,
    companions: Mapping[str, str | os.PathLike[str]] | None = None,
    layers: Mapping[str, str] | None = None,
    convention: MotionConvention | None = None,
    before: str | os.PathLike[str] | None = None,
    samples: float | None = None,
) -> Frame:
    """Read one frame, finding its buffers among the channels of any known renderer.

    Only the channels that are needed are decoded. The frame is the data window of the color,
    which may be larger or smaller than the display window; buffers in parts with another data
    window are brought to it, 0 where they have no pixels.

    Parameters
    ----------
    path
        An OpenEXR file with color and any of the other buffers.
    companions
        Files that hold a buffer instead, by role: albedo, normal, depth and motion under a known
        name, or as plain R, G, B or X, Y, Z; plain motion (X, Y or R, G) is in pixels, previous
        minus current position, y down; color_b as the color of another rendering of the same
        frame, with another seed.
    layers
        Role to the layer or channels to take for it, as
        `stillray.io.channels.roles.parse_overrides` gives; and, of a file with several views,
        ``"view"`` to the name of the one to take. ``"jitter"`` to ``"none"`` reads no jitter.
    convention
        What the file's motion means, where its layer alone does not tell: from
        `stillray.io.channels.motion_detection.detect_motion`.
    before
        The file of the previous frame; needed for motion that is stored there.
    samples
        Samples a pixel, whatever the file says of them; see
        `stillray.io.exr.samples.find_samples`.

    Returns
    -------
    Frame

    Raises
    ------
    InputError
        A file cannot be read completely, lacks its buffer, or differs in size; a channel of
        samples holds what no count can be, or an attribute what no jitter can.
    """
    file = ExrFile.of_layers(path, layers)
    given = {role: Path(companion) for role, companion in (companions or {}).items()}
    if unknown := sorted(set(given) - set(COMPANIONS)):
        raise InputError(f"companions must be of {', '.join(COMPANIONS)}, got {unknown[0]}")
    found = color_and_more(file, layers)
    matches = [
        match.proven(convention) if match.role == "motion" and convention else match
        for match in found
        if match.role not in given
    ]
    matches = [match for match in matches if match.used]
    source = find_samples(file, matches, layers)
    if samples is not None:
        matches = [match for match in matches if match.role != "samples"]
    late = [m for m in matches if m.convention is not None and m.convention.stored == "before"]
    names = dict.fromkeys(name for m in matches if m not in late for name in m.channels)
    first = next(m for m in matches if m.role == "color").channels[0]
    window = file.window(first)
    planes = file.read(names, window)
    buffers: dict[str, Any] = {m.role: gather(m, planes) for m in matches if m not in late}
    if late and before is not None:  # a first frame has no frame before, and needs no motion
        previous = ExrFile.of_layers(before, layers)
        _require_channels(previous, late[0].channels)
        buffers["motion"] = gather(late[0], previous.read(late[0].channels, window))
    for role, companion in given.items():
        buffers[role] = _read_alone(role, companion, file, window, layers)
    if "samples" in buffers:
        try:
            check_samples(buffers["samples"])
        except InputError as error:
            raise InputError(f"{file.path}: {error}; samples=none leaves the layer out") from None
    else:
        buffers["samples"] = source.number if samples is None else samples
    buffers["jitter"] = find_jitter(file, layers)
    buffers["filter_spread"] = find_filter(file, first).spread
    return Frame(**buffers)


def read_picture(
    path: str | os.PathLike[str], *, layers: Mapping[str, str] | None = None
) -> np.ndarray:
    """The color that a denoised picture is written into, ``(h, w, 3)`` float32.

    That is what `read_exr` takes for color, but in files that keep the noisy image beside it.

    Raises
    ------
    InputError
        The file cannot be read, or has no color.
    """
    file = ExrFile.open(path, view=(layers or {}).get(VIEW))
    color = color_and_more(file, layers)[0].writes
    planes = file.read(color, file.window(color[0]))
    return np.stack([planes[name] for name in color], axis=-1)


def read_lights(
    path: str | os.PathLike[str],
    names: Sequence[str] = (),
    *,
    layers: Mapping[str, str] | None = None,
) -> dict[str, np.ndarray]:
    """Layers of light beside the color, for `Denoiser.denoise_layers`.

    Parameters
    ----------
    path
        An OpenEXR file.
    names
        Which layers, as they are called in the file, with or without their view layer; all that
        are known to be light if empty.
    layers
        As for `read_exr`.

    Returns
    -------
    dict of str to (h, w, 3) float32
        By whole name, in the data window of the color. Beside lights without the colour of surfaces
        stand the layers of that colour, where the file has them.

    Raises
    ------
    InputError
        The file cannot be read, or has no such layer, or several without their view layers.
    """
    file = ExrFile.of_layers(path, layers)
    color = color_and_more(file, layers)[0]
    channels = with_colors(file, lights_by_whole_name(file, names, layers))
    wanted = dict.fromkeys(name for listed in channels.values() for name in listed)
    planes = file.read(wanted, file.window(color.channels[0]))
    return {
        name: np.stack([planes[channel] for channel in listed], axis=-1)
        for name, listed in channels.items()
    }


def read_channels(path: str | os.PathLike[str]) -> Channels:
    """Read every channel of every part of an EXR file.

    Parameters
    ----------
    path
        An OpenEXR file; names are as `ExrFile` has them.

    Returns
    -------
    dict of str to ndarray
        Channel name to a float32 ``(height, width)`` array, row 0 at the top.

    Raises
    ------
    InputError
        The file is missing, not readable, truncated, or its parts differ in size.
    """
    file = ExrFile.open(path)
    channels = {n: np.ascontiguousarray(p) for n, p in file.read(file.channels).items()}
    sizes = {plane.shape for plane in channels.values()}
    if len(sizes) != 1:
        raise InputError(f"{path}: all parts must have one size, got {sorted(sizes)}")
    return {name: channels[name] for name in file.channels}


def read_metadata(path: str | os.PathLike[str]) -> Any:
    """The OpenImageIO ``ImageSpec`` of the first part of a file: windows and attributes."""
    checked_container(Path(path))
    with opened(Path(path)) as source:
        return source.spec()


def _require_channels(file: ExrFile, names: Iterable[str]) -> None:
    missing = [name for name in names if name not in file.channels]
    if missing:
        raise InputError(f"{file.path}: must hold the motion channels {', '.join(missing)}")


def _read_alone(
    role: str,
    path: Path,
    beside: ExrFile,
    window: Window,
    layers: Mapping[str, str] | None,
) -> np.ndarray:
    """A buffer from a file of its own, in the data window of the color that it goes with."""
    file = companion_file(path, layers)
    match = require_alone(role, path, file.channels, layers)
    own = file.window(match.channels[0])
    same_picture = file.container.parts[0].display == beside.container.parts[0].display
    if not same_picture and (own.width, own.height) != (window.width, window.height):
        raise InputError(
            f"{path}: {role} must have the size {(window.height, window.width)} of {beside.path}, "
            f"got {(own.height, own.width)}"
        )
    return gather(match, file.read(match.channels, window if same_picture else None))

"""Writing a new OpenEXR file of one part, with what a source says of itself."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray.io.atomic import atomic_path
from stillray.io.exr.jitter import JITTER_ATTRIBUTE
from stillray.io.exr.openimageio import openimageio, reason
from stillray.io.exr.read import read_metadata

#: The attribute that names a file's views.
VIEWS = "multiView"
# Attributes that describe the stored pixels, not the picture: OpenImageIO sets them anew.
_STORAGE_PREFIXES = ("oiio:", "openexr:")
_STORAGE_NAMES = frozenset({"chunkCount", "name", "compression"})
_VIEW_NAMES = frozenset({"view", VIEWS})


def write_channels(
    path: str | os.PathLike[str],
    channels: Mapping[str, np.ndarray],
    *,
    formats: Mapping[str, str] | None = None,
    like: str | os.PathLike[str] | None = None,
    attributes: Mapping[str, Any] | None = None,
    compression: str = "zip",
) -> int:
    """Write one single-part EXR file, complete or not at all.

    Parameters
    ----------
    path
        Where to write. A temporary file beside it is filled and then moved into place.
    channels
        Channel name to ``(height, width)`` array, any floating dtype.
    formats
        Channel name to ``"half"`` or ``"float"``; ``"half"`` where not named. Values beyond
        the half range (65504) are clamped to it, never turned into infinities.
    like
        A source file whose metadata are kept, and its data window and display window: where the
        planes are some times its size, enlarged by that.
    attributes
        Further metadata: name to str, int, float or list of str; None leaves out what the source
        has.
    compression
        An OpenEXR compression name, ``"zip"`` (lossless) unless told otherwise.

    Returns
    -------
    int
        How many values were clamped to the half range.

    Raises
    ------
    InputError
        The folder does not exist or cannot be written.
    """
    oiio = openimageio()
    path = Path(path)
    height, width = next(iter(channels.values())).shape
    formats = formats or {}
    kinds = [formats.get(name, "half") for name in channels]
    # OpenImageIO ignores the formats of the channels where they are all the same
    whole = kinds[0] if len(set(kinds)) == 1 else "float"
    spec = oiio.ImageSpec(width, height, len(channels), whole)
    if like is not None:
        source = read_metadata(like)
        if times := times_of(source, height, width):
            spec.x, spec.y = times * source.x, times * source.y
            spec.full_x, spec.full_y = times * source.full_x, times * source.full_y
            spec.full_width = times * source.full_width
            spec.full_height = times * source.full_height
        for attribute in source.extra_attribs:
            stored = attribute.name in _STORAGE_NAMES
            # a source's views may have been parts, which say so otherwise
            stored = stored or (VIEWS in (attributes or {}) and attribute.name in _VIEW_NAMES)
            moved = attribute.name == JITTER_ATTRIBUTE and times != 1  # samples are elsewhere now
            if not stored and not moved and not attribute.name.startswith(_STORAGE_PREFIXES):
                spec.attribute(attribute.name, attribute.type, attribute.value)
    spec.channelnames = tuple(channels)
    spec.channelformats = tuple(oiio.TypeDesc(kind) for kind in kinds)
    spec.attribute("compression", compression)
    for name, value in (attributes or {}).items():
        if value is None:
            spec.erase_attribute(name)
        elif isinstance(value, list):
            spec.attribute(name, oiio.TypeDesc(f"string[{len(value)}]"), tuple(value))
        else:
            spec.attribute(name, value)
    half = np.finfo(np.float16)
    halves = [plane for plane, kind in zip(channels.values(), kinds, strict=True) if kind == "half"]
    clamped = sum(int(np.count_nonzero(np.abs(plane) > half.max)) for plane in halves)
    planes = [
        np.clip(plane, half.min, half.max) if kind == "half" else plane
        for plane, kind in zip(channels.values(), kinds, strict=True)
    ]
    pixels = np.stack([np.asarray(plane, np.float32) for plane in planes], axis=-1)
    with atomic_path(path) as temporary:
        sink = oiio.ImageOutput.create("exr")
        if not sink.open(str(temporary), spec):
            raise InputError(f"{path}: cannot be written: {reason(sink.geterror())}")
        written = sink.write_image(pixels)
        message = sink.geterror()
        if not sink.close() or not written:
            raise InputError(f"{path}: cannot be written: {reason(message)}")
    return clamped


def times_of(source: Any, height: int, width: int) -> int:
    """How many times a size is that of a window or a spec; 0 if no whole number."""
    times, rest = divmod(height, source.height)
    return times if rest == 0 and width == times * source.width else 0

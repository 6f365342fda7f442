"""Reading and writing OpenEXR files: named channels in, named channels out.

Only OpenImageIO touches EXR here: OpenCV's own reader is switched off in most builds.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray.frame import Frame
from stillray.layers import LayerMatch, find_alone, find_layers, gather

Channels = dict[str, np.ndarray]

# Attributes that describe the stored pixels, not the picture: OpenImageIO sets them anew.
_STORAGE_PREFIXES = ("oiio:", "openexr:")
_STORAGE_NAMES = frozenset({"chunkCount", "name", "compression"})


def read_exr(
    path: str | os.PathLike[str],
    *,
    albedo: str | os.PathLike[str] | None = None,
    normal: str | os.PathLike[str] | None = None,
    depth: str | os.PathLike[str] | None = None,
    motion: str | os.PathLike[str] | None = None,
) -> Frame:
    """Read one frame, finding its buffers among the channels of any known renderer.

    Parameters
    ----------
    path
        An OpenEXR file with color and any of the other buffers.
    albedo, normal, depth, motion
        Files that hold that buffer instead: under a known name, or as plain R, G, B or X, Y, Z.
        Plain motion (X, Y or R, G) is in pixels, previous minus current position, y down.

    Returns
    -------
    Frame

    Raises
    ------
    InputError
        A file cannot be read completely, lacks its buffer, or differs in size.
    """
    path = Path(path)
    channels = read_channels(path)
    matches = require_color(path, find_layers(channels))
    buffers = {match.role: gather(match, channels) for match in matches if match.used}
    companions = {"albedo": albedo, "normal": normal, "depth": depth, "motion": motion}
    for role, companion in companions.items():
        if companion is None:
            continue
        alone = read_channels(companion)
        buffers[role] = gather(_require_alone(role, Path(companion), alone), alone)
        size, expected = buffers[role].shape[:2], buffers["color"].shape[:2]
        if size != expected:
            raise InputError(
                f"{companion}: {role} must have the size {expected} of {path}, got {size}"
            )
    return Frame(**buffers)


def require_color(path: Path, matches: list[LayerMatch]) -> list[LayerMatch]:
    """The matches; `InputError` where none of them is color."""
    if not any(match.role == "color" for match in matches):
        raise InputError(
            f"{path}: must hold color channels, R, G, B or a known renderer's; none found"
        )
    return matches


def check_layer(path: str | os.PathLike[str], role: str) -> None:
    """Raise `InputError` where a file's header holds no buffer of that role; reads no pixels."""
    path = Path(path)
    with _opened(path) as source:
        names = [key for _, keys in _parts(path, source) for key in keys]
    if role == "color":
        require_color(path, find_layers(names))
    else:
        _require_alone(role, path, names)


def read_channels(path: str | os.PathLike[str]) -> Channels:
    """Read every channel of every part of an EXR file.

    Parameters
    ----------
    path
        An OpenEXR file. Where a part has a name and its channels carry no layer,
        ``part.channel`` is the key; in the first part only if that is a known layer.

    Returns
    -------
    dict of str to ndarray
        Channel name to a float32 ``(height, width)`` array, row 0 at the top.

    Raises
    ------
    InputError
        The file is missing, not readable, truncated, or its parts differ in size.
    """
    oiio = _openimageio()
    path = Path(path)
    channels: Channels = {}
    with _opened(path) as source:
        for part, keys in _parts(path, source):
            spec = source.spec()
            if spec.deep:
                raise InputError(f"{path}: must hold flat pixels, part {part} is deep")
            pixels = source.read_image(part, 0, 0, spec.nchannels, oiio.FLOAT)
            if pixels is None:
                raise InputError(f"{path}: cannot read the pixels: {_reason(source.geterror())}")
            pixels = np.asarray(pixels).reshape(spec.height, spec.width, spec.nchannels)
            for index, key in enumerate(keys):
                channels.setdefault(key, np.ascontiguousarray(pixels[..., index]))
    sizes = {plane.shape for plane in channels.values()}
    if len(sizes) != 1:
        raise InputError(f"{path}: all parts must have one size, got {sorted(sizes)}")
    return channels


def read_metadata(path: str | os.PathLike[str]) -> Any:
    """The OpenImageIO ``ImageSpec`` of the first part of a file: windows and attributes."""
    with _opened(Path(path)) as source:
        return source.spec()


def write_exr(
    path: str | os.PathLike[str],
    image: np.ndarray,
    *,
    like: str | os.PathLike[str] | None = None,
) -> None:
    """Write a picture as R, G, B in half precision, complete or not at all.

    Parameters
    ----------
    path
        Where to write; what is there already stays intact until the new file is complete.
    image : (h, w, 3) float
        Scene-linear radiance; beyond 65504 it is clamped to what half precision can hold.
    like
        A source file whose metadata are kept, and its data and display windows where the
        picture has its size.

    Raises
    ------
    InputError
        The picture has a wrong shape or type, or the file cannot be written.
    """
    image = np.asarray(image)
    if image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape:
        raise InputError(f"image must have shape (height, width, 3), got {image.shape}")
    if image.dtype.kind != "f":
        raise InputError(f"image must be floating point, got {image.dtype}")
    write_channels(path, {name: image[..., i] for i, name in enumerate("RGB")}, like=like)


def write_channels(
    path: str | os.PathLike[str],
    channels: Mapping[str, np.ndarray],
    *,
    formats: Mapping[str, str] | None = None,
    like: str | os.PathLike[str] | None = None,
    attributes: Mapping[str, Any] | None = None,
    compression: str = "zip",
) -> None:
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
        A source file whose data window, display window and metadata are kept.
    attributes
        Further metadata: name to str, int or float.
    compression
        An OpenEXR compression name, ``"zip"`` (lossless) unless told otherwise.

    Raises
    ------
    InputError
        The folder does not exist or cannot be written.
    """
    oiio = _openimageio()
    path = Path(path)
    height, width = next(iter(channels.values())).shape
    formats = formats or {}
    kinds = [formats.get(name, "half") for name in channels]
    # OpenImageIO ignores the formats of the channels where they are all the same
    whole = kinds[0] if len(set(kinds)) == 1 else "float"
    spec = oiio.ImageSpec(width, height, len(channels), whole)
    if like is not None:
        source = read_metadata(like)
        if (source.height, source.width) == (height, width):
            spec.x, spec.y = source.x, source.y
            spec.full_x, spec.full_y = source.full_x, source.full_y
            spec.full_width, spec.full_height = source.full_width, source.full_height
        for attribute in source.extra_attribs:
            stored = attribute.name in _STORAGE_NAMES
            if not stored and not attribute.name.startswith(_STORAGE_PREFIXES):
                spec.attribute(attribute.name, attribute.type, attribute.value)
    spec.channelnames = tuple(channels)
    spec.channelformats = tuple(oiio.TypeDesc(kind) for kind in kinds)
    spec.attribute("compression", compression)
    for name, value in (attributes or {}).items():
        spec.attribute(name, value)
    half = np.finfo(np.float16)
    planes = [
        np.clip(plane, half.min, half.max) if kind == "half" else plane
        for plane, kind in zip(channels.values(), kinds, strict=True)
    ]
    pixels = np.stack([np.asarray(plane, np.float32) for plane in planes], axis=-1)
    with atomic_path(path) as temporary:
        sink = oiio.ImageOutput.create("exr")
        if not sink.open(str(temporary), spec):
            raise InputError(f"{path}: cannot be written: {_reason(sink.geterror())}")
        written = sink.write_image(pixels)
        message = sink.geterror()
        if not sink.close() or not written:
            raise InputError(f"{path}: cannot be written: {_reason(message)}")


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A temporary name beside ``path``, moved into place when the block ends without error."""
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
        os.close(handle)
    except OSError as error:
        raise InputError(
            f"{path}: the folder must exist and be writable: {error.strerror}"
        ) from error
    temporary = Path(name)
    try:
        yield temporary
        # mkstemp makes files private; a result is as readable as any new file
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        temporary.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error
    finally:
        temporary.unlink(missing_ok=True)


def _require_alone(role: str, path: Path, names: Iterable[str]) -> LayerMatch:
    names = list(names)
    match = find_alone(role, names)
    if match is None:
        raise InputError(f"{path}: must hold {role} channels, got {', '.join(names)}")
    return match


def _parts(path: Path, source: Any) -> Iterator[tuple[int, list[str]]]:
    """Part number and channel keys of each part; the source stands at that part meanwhile."""
    part = 0
    while source.seek_subimage(part, 0):
        spec = source.spec()
        name = str(spec.getattribute("name") or "")
        keys = [f"{name}.{c}" if name and "." not in c else c for c in spec.channelnames]
        # the first part is often the beauty under a name of its own: then R, G, B say more
        yield part, keys if part or find_layers(keys) else list(spec.channelnames)
        part += 1
    if message := source.geterror():  # empty where the parts have simply come to their end
        raise InputError(f"{path}: cannot read part {part}: {_reason(message)}")


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """An open EXR file; what goes wrong with it inside the block becomes an `InputError`."""
    oiio = _openimageio()
    if path.is_dir():
        raise InputError(f"{path}: is a folder, not an EXR file")
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: not a readable EXR file: it is empty")
    source = None
    try:
        source = oiio.ImageInput.open(str(path))
        if source is None:
            raise InputError(f"{path}: not a readable EXR file: {_reason(oiio.geterror())}")
        if source.format_name() != "openexr":
            raise InputError(f"{path}: must be an EXR file, its content is {source.format_name()}")
        yield source
    except MemoryError:
        raise InputError(f"{path}: does not fit into memory") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a readable EXR file: its names are not UTF-8") from None
    finally:
        if source is not None:
            source.close()


def _reason(message: str) -> str:
    # one line, without the path that our own message begins with
    return re.sub(r"^EXR Error \(.*?\): ", "", " ".join(message.split())) or "unknown reason"


def _openimageio() -> Any:
    # Imported on use: `import stillray` stays quick for those who bring arrays.
    import OpenImageIO

    return OpenImageIO

"""Reading and writing OpenEXR files: buffers in, the same file with a clean picture out.

Alpha is never touched: colour is denoised as it is stored, which in EXR is premultiplied, so that
compositing the result over a background works as with the source.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray.frame import Frame, check_samples
from stillray.io.atomic import atomic_path
from stillray.io.channels.motion_convention import MotionConvention
from stillray.io.channels.roles import (
    LayerMatch,
    color_of_light,
    find_alone,
    find_layers,
    find_light,
    find_lights,
    gather,
)
from stillray.io.exr.container import Window
from stillray.io.exr.file import Channels, ExrFile
from stillray.io.exr.jitter import JITTER_ATTRIBUTE, find_jitter
from stillray.io.exr.openimageio import checked_container, opened, openimageio, reason
from stillray.io.exr.pixel_filter import find_filter
from stillray.io.exr.rewrite import rewrite, unkept
from stillray.io.exr.samples import find_samples
from stillray.io.exr.views import VIEW
from stillray.version import __version__

__all__ = [
    "CleanView",
    "ExrFile",
    "atomic_path",
    "check_layer",
    "colors_beside",
    "expected_changes",
    "read_channels",
    "read_exr",
    "read_lights",
    "read_metadata",
    "read_picture",
    "require_color",
    "write_channels",
    "write_color",
    "write_exr",
    "write_views",
]

#: Roles of buffers that a file of their own may hold.
COMPANIONS = ("albedo", "normal", "depth", "motion", "color_b")
_MOST_LISTED = 40  # channels in a message

# Attributes that describe the stored pixels, not the picture: OpenImageIO sets them anew.
_STORAGE_PREFIXES = ("oiio:", "openexr:")
_VERSION = {"stillray:version": __version__}
_STORAGE_NAMES = frozenset({"chunkCount", "name", "compression"})
_VIEWS = "multiView"
_VIEW_NAMES = frozenset({"view", _VIEWS})


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
    found = _color_and_more(file, layers)
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
    """The color that `write_exr` puts a denoised picture into, ``(h, w, 3)`` float32.

    That is what `read_exr` takes for color, but in files that keep the noisy image beside it.

    Raises
    ------
    InputError
        The file cannot be read, or has no color.
    """
    file = ExrFile.open(path, view=(layers or {}).get(VIEW))
    color = _color_and_more(file, layers)[0].writes
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
    color = _color_and_more(file, layers)[0]
    channels = _with_colors(file, _by_whole_name(_lights(file, names, layers)))
    wanted = dict.fromkeys(name for listed in channels.values() for name in listed)
    planes = file.read(wanted, file.window(color.channels[0]))
    return {
        name: np.stack([planes[channel] for channel in listed], axis=-1)
        for name, listed in channels.items()
    }


def colors_beside(
    path: str | os.PathLike[str],
    names: Sequence[str] = (),
    *,
    layers: Mapping[str, str] | None = None,
) -> list[str]:
    """Layers of the colour of surfaces that `read_lights` gives beside the lights of those names.

    So `write_exr` writes them anew where it is given what became of the lights. Reads headers only.

    Parameters
    ----------
    path, names, layers
        As for `read_lights`.

    Raises
    ------
    InputError
        As `read_lights`.
    """
    file = ExrFile.of_layers(path, layers, headers_only=True)
    lights = _by_whole_name(_lights(file, names, layers))
    return [name for name in _with_colors(file, lights) if name not in lights]


def require_color(path: Path, matches: list[LayerMatch], names: Iterable[str]) -> list[LayerMatch]:
    """The matches; `InputError`, which lists the file's channels, where none of them is color."""
    if not any(match.role == "color" for match in matches):
        raise InputError(f"{path}: must hold color channels, {_instead_of_color(list(names))}")
    return matches


def _instead_of_color(names: list[str]) -> str:
    """What a file without color holds, and what can be done about it."""
    parts = {name.rpartition(".")[2] for name in names}
    if {"Y", "RY", "BY"} <= parts:
        return "it holds luminance and chroma (Y, RY, BY), which must be converted to R, G, B"
    if set(names) <= {"Y", "A"}:
        return "it holds luminance (Y) alone; --layer color=Y,Y,Y takes it for grey"
    listed = ", ".join(names[:_MOST_LISTED])
    more = f" and {len(names) - _MOST_LISTED} more" if len(names) > _MOST_LISTED else ""
    return (
        f"R, G, B or a known renderer's, but holds {listed}{more}; --layer color=NAME takes a "
        "layer, or three channels with commas between"
    )


def _color_and_more(file: ExrFile, layers: Mapping[str, str] | None) -> list[LayerMatch]:
    return require_color(file.path, find_layers(file.channels, layers), file.channels)


def check_layer(
    path: str | os.PathLike[str], role: str, layers: Mapping[str, str] | None = None
) -> None:
    """Raise `InputError` where a file's header holds no buffer of that role; reads no pixels."""
    if role == "color":
        _color_and_more(ExrFile.of_layers(path, layers, headers_only=True), layers)
    else:
        file = _companion(Path(path), layers, headers_only=True)
        _require_alone(role, file.path, file.channels, layers)


def _companion(
    path: Path, layers: Mapping[str, str] | None, *, headers_only: bool = False
) -> ExrFile:
    """A file of one buffer: in the view that was chosen, if it has several."""
    file = ExrFile.open(path, headers_only=headers_only)
    return ExrFile.of_layers(path, layers, headers_only=headers_only) if file.views else file


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


def write_exr(
    path: str | os.PathLike[str],
    image: np.ndarray,
    *,
    like: str | os.PathLike[str] | None = None,
    layers: Mapping[str, str] | None = None,
    lights: Mapping[str, np.ndarray] | None = None,
    attributes: Mapping[str, str | None] | None = None,
) -> int:
    """Write a denoised picture, complete or not at all.

    With a source to be ``like``, the result has its structure: the same parts, channels, types,
    compression, tiles, windows and attributes, with the picture in place of the color. All other
    parts are copied byte by byte, and so are all attributes. Other channels of the color's own
    part keep their exact values, unless the part's compression is itself lossy (dwaa, dwab, b44,
    b44a and, for 32-bit floats, pxr24) and takes its loss once more.

    Parameters
    ----------
    path
        Where to write; what is there already stays intact until the new file is complete.
    image : (h, w, 3) float
        Scene-linear radiance, premultiplied if the source's color was.
    like
        The source file. Where the picture has not its size, only metadata are kept, but for the
        jitter, which is of other pixels; and the windows, enlarged, where it is a whole number of
        times as wide and high.
    layers
        As it was read with, see `read_exr`.
    lights
        Filtered layers by name, from `read_lights`, which replace those of the source.
    attributes
        Further attributes, such as where the picture comes from: ``{"stillray:model": "kpyr-5"}``;
        None leaves out the source's. ``stillray:version`` is always written.

    Returns
    -------
    int
        How many values were beyond what half precision holds (65504) and were clamped to it,
        where the source's color, or without a source the picture, is of half precision.

    Raises
    ------
    InputError
        The picture has a wrong shape or type, or the file cannot be read or written.
    """
    image = _checked(image)
    if like is not None:
        source = ExrFile.of_layers(like, layers)
        replaced = _replaced(source, CleanView(layers=layers, image=image, lights=lights or {}))
        if replaced:
            with atomic_path(Path(path)) as temporary:
                tags = {**_VERSION, **(attributes or {})}
                return rewrite(source.path, source.container, temporary, replaced, tags)
    return write_color(path, image, like=like, layers=layers, attributes=attributes)


def write_color(
    path: str | os.PathLike[str],
    image: np.ndarray,
    *,
    like: str | os.PathLike[str] | None = None,
    layers: Mapping[str, str] | None = None,
    attributes: Mapping[str, str | None] | None = None,
    kind: str | None = None,
) -> int:
    """Write R, G, B and nothing else, complete or not at all.

    Parameters
    ----------
    path, image, layers, attributes
        As for `write_exr`.
    like
        A file whose metadata, type of color and, where the picture has its size, windows are taken.
    kind
        ``"half"`` or ``"float"``, whatever the source's color is; without either, half.

    Returns
    -------
    int
        As `write_exr` does.

    Raises
    ------
    InputError
        As `write_exr`.
    """
    image = _checked(image)
    if kind is None:
        kind = "half" if like is None else _kind_of_color(like, layers)
    return write_channels(
        path,
        {name: image[..., i] for i, name in enumerate("RGB")},
        formats=dict.fromkeys("RGB", kind),
        like=like,
        attributes={**_VERSION, **(attributes or {})},
    )


def _kind_of_color(path: str | os.PathLike[str], layers: Mapping[str, str] | None) -> str:
    """The type that holds what a file's color holds: ``"half"`` or ``"float"``."""
    file = ExrFile.of_layers(path, layers, headers_only=True)
    wanted = [file.channels[name] for name in _color_and_more(file, layers)[0].writes]
    kinds = {
        channel.kind
        for number, name in wanted
        for channel in file.container.parts[number].channels
        if channel.name == name
    }
    return "half" if kinds == {"half"} else "float"


def _checked(image: np.ndarray) -> np.ndarray:
    image = np.asarray(image)
    if image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape:
        raise InputError(f"image must have shape (height, width, 3), got {image.shape}")
    if image.dtype.kind != "f":
        raise InputError(f"image must be floating point, got {image.dtype}")
    return image


@dataclass(frozen=True, kw_only=True, eq=False)
class CleanView:
    """The clean picture of one view of a file.

    Attributes
    ----------
    layers
        As the view was read with, see `read_exr`.
    image : (h, w, 3) float
        Scene-linear radiance, in the data window of the view's color.
    lights
        Filtered layers by name, from `read_lights`.
    """

    layers: Mapping[str, str] | None
    image: np.ndarray
    lights: Mapping[str, np.ndarray] = field(default_factory=dict)


def write_views(
    path: str | os.PathLike[str],
    views: Sequence[CleanView],
    *,
    like: str | os.PathLike[str],
    attributes: Mapping[str, str | None] | None = None,
) -> int:
    """Write the denoised pictures of several views into one file, complete or not at all.

    Parameters
    ----------
    path
        Where to write.
    views
        What replaces the color of each.
    like
        The source, whose structure is kept as by `write_exr`. Where the pictures are a whole number
        of times as wide and high, the file has one part with the R, G, B of all views alone.
    attributes
        As for `write_exr`.

    Returns
    -------
    int
        How many values were clamped to the half range.

    Raises
    ------
    InputError
        A picture has neither the size of its view nor a multiple of it, or a file cannot be read
        or written.
    """
    path = Path(path)
    tags = {"stillray:version": __version__, **(attributes or {})}
    replaced: dict[tuple[int, str], np.ndarray] = {}
    source = ExrFile.open(like)
    for view in views:
        source = ExrFile.of_layers(like, view.layers)
        planes = _replaced(source, view)
        if not planes and _are_enlarged(views, like):
            return _write_enlarged(path, views, like, tags)
        if not planes:
            raise InputError(
                f"{path}: each view's picture must have the size of its color in {like}, got "
                f"{view.image.shape[:2]}"
            )
        replaced |= planes
    with atomic_path(path) as temporary:
        return rewrite(source.path, source.container, temporary, replaced, tags)


def _are_enlarged(views: Sequence[CleanView], like: str | os.PathLike[str]) -> bool:
    """Whether every picture is the same number of times as wide and high as its color."""
    times = set()
    for view in views:
        source = ExrFile.of_layers(like, view.layers, headers_only=True)
        color = _color_and_more(source, view.layers)[0]
        times.add(_times(source.window(color.writes[0]), *view.image.shape[:2]))
    return len({view.image.shape for view in views}) == len(times) == 1 and 0 not in times


def _write_enlarged(
    path: Path,
    views: Sequence[CleanView],
    like: str | os.PathLike[str],
    tags: Mapping[str, str | None],
) -> int:
    """The colors of all views in one part; how many values were clamped."""
    names = [(view.layers or {})[VIEW] for view in views]
    channels: dict[str, np.ndarray] = {}
    formats: dict[str, str] = {}
    for name, view in zip(names, views, strict=True):
        prefix = "" if name == names[0] else f"{name}."  # the first view's carry none
        image, kind = _checked(view.image), _kind_of_color(like, view.layers)
        channels |= {f"{prefix}{c}": image[..., i] for i, c in enumerate("RGB")}
        formats |= {f"{prefix}{c}": kind for c in "RGB"}
    attributes = {**tags, _VIEWS: names}
    return write_channels(path, channels, formats=formats, like=like, attributes=attributes)


def _replaced(source: ExrFile, view: CleanView) -> dict[tuple[int, str], np.ndarray]:
    """Part and channel to plane; nothing where the picture has not the size of the color."""
    color = [m for m in find_layers(source.channels, view.layers) if m.role == "color"]
    if not color or not _same_size(source.window(color[0].writes[0]), view.image):
        return {}
    _require_window(source, "color", color[0].writes, source.window(color[0].writes[0]))
    planes = {source.channels[name]: view.image[..., i] for i, name in enumerate(color[0].writes)}
    if view.lights:
        planes |= _replaced_lights(source, color[0], view.lights, view.layers)
    return planes


def expected_changes(
    path: str | os.PathLike[str], layers: Mapping[str, str] | None = None
) -> list[str]:
    """What `write_exr` cannot keep of a source's structure, each in a line; reads headers only.

    Parameters
    ----------
    path
        The source.
    layers
        As for `write_exr`.
    """
    file = ExrFile.of_layers(path, layers, headers_only=True)
    color = [match for match in find_layers(file.channels, layers) if match.role == "color"]
    numbers = sorted({file.channels[name][0] for match in color for name in match.writes})
    return [line for number in numbers for line in unkept(file.container.parts[number])]


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
        if times := _times(source, height, width):
            spec.x, spec.y = times * source.x, times * source.y
            spec.full_x, spec.full_y = times * source.full_x, times * source.full_y
            spec.full_width = times * source.full_width
            spec.full_height = times * source.full_height
        for attribute in source.extra_attribs:
            stored = attribute.name in _STORAGE_NAMES
            # a source's views may have been parts, which say so otherwise
            stored = stored or (_VIEWS in (attributes or {}) and attribute.name in _VIEW_NAMES)
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


def _times(source: Any, height: int, width: int) -> int:
    """How many times a size is that of a window or a spec; 0 if no whole number."""
    times, rest = divmod(height, source.height)
    return times if rest == 0 and width == times * source.width else 0


def _require_alone(
    role: str, path: Path, names: Iterable[str], layers: Mapping[str, str] | None
) -> LayerMatch:
    names = list(names)
    match = find_alone(role, names, layers)
    if match is None:
        raise InputError(f"{path}: must hold {role} channels, got {', '.join(names)}")
    return match


def _lights(
    file: ExrFile, names: Sequence[str], layers: Mapping[str, str] | None
) -> dict[str, tuple[str, ...]]:
    """Channels of the layers of those names; of all layers of light if there are no names."""
    known = find_lights(file.channels, layers)
    if not names:
        return known
    found = {}
    for name in names:
        if name not in known:
            # named by a user, it need not be known to be light
            known[name] = find_light(name, file.channels)
        found[name] = known[name]
    return found


def _by_whole_name(lights: Mapping[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    """The same, since the colour of a light that is named without its view layer is of that too."""
    return {channels[0].rpartition(".")[0]: channels for channels in lights.values()}


def _with_colors(
    file: ExrFile, lights: Mapping[str, tuple[str, ...]]
) -> dict[str, tuple[str, ...]]:
    """Channels of layers of light, and of the colours of those that are without theirs."""
    found = dict(lights)
    for light in lights:
        color = color_of_light(light)
        channels = tuple(f"{color}.{c}" for c in "RGB")
        if color is not None and all(channel in file.channels for channel in channels):
            found.setdefault(color, channels)
    return found


def _replaced_lights(
    file: ExrFile,
    color: LayerMatch,
    lights: Mapping[str, np.ndarray],
    layers: Mapping[str, str] | None,
) -> dict[tuple[int, str], np.ndarray]:
    """Part and channel to plane, of filtered layers."""
    replaced = {}
    for name, channels in _lights(file, tuple(lights), layers).items():
        _require_window(file, name, channels, file.window(color.writes[0]))
        for i, channel in enumerate(channels):
            replaced[file.channels[channel]] = lights[name][..., i]
    return replaced


def _require_window(file: ExrFile, name: str, channels: Iterable[str], window: Window) -> None:
    """Raise `InputError` where channels lie in parts with another data window."""
    if any(file.window(channel) != window for channel in channels):
        raise InputError(f"{file.path}: {name} must have one data window, that of the color")


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
    file = _companion(path, layers)
    match = _require_alone(role, path, file.channels, layers)
    own = file.window(match.channels[0])
    same_picture = file.container.parts[0].display == beside.container.parts[0].display
    if not same_picture and (own.width, own.height) != (window.width, window.height):
        raise InputError(
            f"{path}: {role} must have the size {(window.height, window.width)} of {beside.path}, "
            f"got {(own.height, own.width)}"
        )
    return gather(match, file.read(match.channels, window if same_picture else None))


def _same_size(window: Window, image: np.ndarray) -> bool:
    return (window.height, window.width) == image.shape[:2]

"""Writing OpenEXR files: the same file with a clean picture in it.

Alpha is never touched: colour is denoised as it is stored, which in EXR is premultiplied, so that
compositing the result over a background works as with the source.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stillray.errors import InputError
from stillray.io.atomic import atomic_path
from stillray.io.channels.roles import LayerMatch, find_layers
from stillray.io.exr.container import Window
from stillray.io.exr.file import ExrFile
from stillray.io.exr.layers import color_and_more, lights_of, require_window
from stillray.io.exr.new_file import VIEWS, times_of, write_channels
from stillray.io.exr.rewrite import rewrite, unkept
from stillray.io.exr.views import VIEW
from stillray.version import __version__

_VERSION = {"stillray:version": __version__}


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
        As it was read with, see `stillray.io.exr.read.read_exr`.
    lights
        Filtered layers by name, from `stillray.io.exr.read.read_lights`, which replace those of
        the source.
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
    wanted = [file.channels[name] for name in color_and_more(file, layers)[0].writes]
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
        As the view was read with, see `stillray.io.exr.read.read_exr`.
    image : (h, w, 3) float
        Scene-linear radiance, in the data window of the view's color.
    lights
        Filtered layers by name, from `stillray.io.exr.read.read_lights`.
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
        color = color_and_more(source, view.layers)[0]
        times.add(times_of(source.window(color.writes[0]), *view.image.shape[:2]))
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
    attributes = {**tags, VIEWS: names}
    return write_channels(path, channels, formats=formats, like=like, attributes=attributes)


def _replaced(source: ExrFile, view: CleanView) -> dict[tuple[int, str], np.ndarray]:
    """Part and channel to plane; nothing where the picture has not the size of the color."""
    color = [m for m in find_layers(source.channels, view.layers) if m.role == "color"]
    if not color or not _same_size(source.window(color[0].writes[0]), view.image):
        return {}
    require_window(source, "color", color[0].writes, source.window(color[0].writes[0]))
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


def _replaced_lights(
    file: ExrFile,
    color: LayerMatch,
    lights: Mapping[str, np.ndarray],
    layers: Mapping[str, str] | None,
) -> dict[tuple[int, str], np.ndarray]:
    """Part and channel to plane, of filtered layers."""
    replaced = {}
    for name, channels in lights_of(file, tuple(lights), layers).items():
        require_window(file, name, channels, file.window(color.writes[0]))
        for i, channel in enumerate(channels):
            replaced[file.channels[channel]] = lights[name][..., i]
    return replaced


def _same_size(window: Window, image: np.ndarray) -> bool:
    return (window.height, window.width) == image.shape[:2]

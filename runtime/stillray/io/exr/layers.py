"""What a file holds of a picture's layers: its color, buffers and lights, or one clear error."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from stillray.errors import InputError
from stillray.io.channels.roles import (
    LayerMatch,
    color_of_light,
    find_alone,
    find_layers,
    find_light,
    find_lights,
)
from stillray.io.exr.container import Window
from stillray.io.exr.file import ExrFile

_MOST_LISTED = 40  # channels in a message


def colors_beside(
    path: str | os.PathLike[str],
    names: Sequence[str] = (),
    *,
    layers: Mapping[str, str] | None = None,
) -> list[str]:
    """Layers of the colour of surfaces that are read beside the lights of those names.

    So `stillray.io.exr.write.write_exr` writes them anew where it is given what became of the
    lights. Reads headers only.

    Parameters
    ----------
    path, names, layers
        As for `stillray.io.exr.read.read_lights`.

    Raises
    ------
    InputError
        As `stillray.io.exr.read.read_lights`.
    """
    file = ExrFile.of_layers(path, layers, headers_only=True)
    lights = lights_by_whole_name(file, names, layers)
    return [name for name in with_colors(file, lights) if name not in lights]


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


def color_and_more(file: ExrFile, layers: Mapping[str, str] | None) -> list[LayerMatch]:
    """The layers of a file that has a color; `InputError` where it has none."""
    return require_color(file.path, find_layers(file.channels, layers), file.channels)


def check_layer(
    path: str | os.PathLike[str], role: str, layers: Mapping[str, str] | None = None
) -> None:
    """Raise `InputError` where a file's header holds no buffer of that role; reads no pixels."""
    if role == "color":
        color_and_more(ExrFile.of_layers(path, layers, headers_only=True), layers)
    else:
        file = companion_file(Path(path), layers, headers_only=True)
        require_alone(role, file.path, file.channels, layers)


def companion_file(
    path: Path, layers: Mapping[str, str] | None, *, headers_only: bool = False
) -> ExrFile:
    """A file of one buffer: in the view that was chosen, if it has several."""
    file = ExrFile.open(path, headers_only=headers_only)
    return ExrFile.of_layers(path, layers, headers_only=headers_only) if file.views else file


def lights_of(
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


def lights_by_whole_name(
    file: ExrFile, names: Sequence[str], layers: Mapping[str, str] | None
) -> dict[str, tuple[str, ...]]:
    """The same, since the colour of a light that is named without its view layer is of that too."""
    found = lights_of(file, names, layers)
    return {channels[0].rpartition(".")[0]: channels for channels in found.values()}


def with_colors(file: ExrFile, lights: Mapping[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    """Channels of layers of light, and of the colours of those that are without theirs."""
    found = dict(lights)
    for light in lights:
        color = color_of_light(light)
        channels = tuple(f"{color}.{c}" for c in "RGB")
        if color is not None and all(channel in file.channels for channel in channels):
            found.setdefault(color, channels)
    return found


def require_alone(
    role: str, path: Path, names: Iterable[str], layers: Mapping[str, str] | None
) -> LayerMatch:
    """The buffer of a role in a file of its own; `InputError` where it holds none."""
    names = list(names)
    match = find_alone(role, names, layers)
    if match is None:
        raise InputError(f"{path}: must hold {role} channels, got {', '.join(names)}")
    return match


def require_window(file: ExrFile, name: str, channels: Iterable[str], window: Window) -> None:
    """Raise `InputError` where channels lie in parts with another data window."""
    if any(file.window(channel) != window for channel in channels):
        raise InputError(f"{file.path}: {name} must have one data window, that of the color")

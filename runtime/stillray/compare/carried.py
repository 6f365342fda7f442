"""What a page carries of an image: its color, alpha, and the layers that were asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stillray.errors import InputError
from stillray.io.channels.roles import find_layers
from stillray.io.exr.file import ExrFile
from stillray.io.exr.layers import require_color
from stillray.io.exr.views import VIEW
from stillray.io.frame_file import read_frame
from stillray.io.image_file import is_float_map

_COMPONENTS = ("RGB", "XYZ", "UVA", "rgb", "xyz")


@dataclass(frozen=True, kw_only=True)
class Region:
    """What a page carries of an image.

    Attributes
    ----------
    crop
        x, y, width and height in pixels, the first pixel is (0, 0); None for the whole image.
    downscale
        Cells of so many pixels squared become their mean, after everything is measured.
    view
        Of files that hold several views: the one to show.
    layers
        Names of layers to show beside the color, as the files have them.
    """

    crop: tuple[int, int, int, int] | None = None
    downscale: int = 1
    view: str | None = None
    layers: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Carried:
    """An image's pixels.

    Attributes
    ----------
    color : (h, w, 3) float32
    alpha : (h, w) float32 or None
        Where there is one beside the color.
    layers
        By name, ``(h, w, 3)`` float32: one channel stands for all three, a third that is missing
        is 0. Without those that the file has not.
    """

    color: np.ndarray
    alpha: np.ndarray | None = None
    layers: Mapping[str, np.ndarray] = field(default_factory=dict)

    def map(self, change: Callable[[np.ndarray], np.ndarray]) -> Carried:
        """The same of every picture changed."""
        return Carried(
            color=change(self.color),
            alpha=None if self.alpha is None else change(self.alpha),
            layers={name: change(layer) for name, layer in self.layers.items()},
        )


def read_carried(path: Path, region: Region) -> Carried:
    """Read the whole of what is carried of a file, uncut.

    Raises
    ------
    InputError
        The file cannot be read, holds no color, or several views of which none was chosen.
    """
    if is_float_map(path):
        return Carried(color=read_frame(path, {}).color)
    file, channels = _color_of(path, region)
    window = file.window(channels[0])
    prefix = channels[0].rpartition(".")[0]
    alpha = f"{prefix}.A" if prefix else "A"
    found = {name: _channels_of(file, name) for name in region.layers}
    wanted = dict.fromkeys([*channels, *(n for names in found.values() for n in names)])
    if alpha in file.channels:
        wanted[alpha] = None
    planes = file.read(wanted, window)
    layers = {}
    for name, names in found.items():
        given = [planes[channel] for channel in names]
        if given:
            given += [given[0]] * 2 if len(given) == 1 else [0 * given[0]] * (3 - len(given))
            layers[name] = np.stack(given, -1)
    color = np.stack([planes[name] for name in channels], -1)
    return Carried(color=color, alpha=planes.get(alpha), layers=layers)


def size_of(path: Path, region: Region) -> tuple[int, int]:
    """Height and width of a file's color; of an EXR file by its header.

    Raises
    ------
    InputError
        As `read_carried`.
    """
    if is_float_map(path):
        return read_frame(path, {}).shape
    file, channels = _color_of(path, region)
    window = file.window(channels[0])
    return window.height, window.width


def layers_in(path: Path, region: Region) -> frozenset[str]:
    """Which of the region's layers a file has."""
    if is_float_map(path):
        return frozenset()
    file, _ = _color_of(path, region)
    return frozenset(name for name in region.layers if _channels_of(file, name))


def _color_of(path: Path, region: Region) -> tuple[ExrFile, tuple[str, ...]]:
    file = ExrFile.open(path)
    if len(file.views) > 1:
        layers = {} if region.view is None else {VIEW: region.view}
        file = ExrFile.of_layers(path, layers)
    elif region.view is not None and file.views and region.view not in file.views:
        raise InputError(f"{path}: must have the view {region.view}, it has {file.views[0]}")
    matches = require_color(path, find_layers(file.channels), file.channels)
    (color,) = (match for match in matches if match.role == "color")
    # where a file keeps the noisy image beside the picture, a clean one is in the picture
    clean = any(part.text("stillray:version") for part in file.container.parts)
    return file, color.writes if clean else color.channels


def _channels_of(file: ExrFile, name: str) -> tuple[str, ...]:
    """The one to three channels that show a layer; none where the file has it not."""
    if name in file.channels:
        return (name,)
    for components in _COMPONENTS:
        listed = tuple(f"{name}.{c}" for c in components)
        if all(channel in file.channels for channel in listed):
            return listed
    return tuple(channel for channel in file.channels if channel.startswith(f"{name}."))[:3]

"""An EXR file whose container has been checked: the names of its channels, and their pixels."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np

from stillray.errors import InputError
from stillray.io.channels.roles import find_layers
from stillray.io.exr.container import Container, Part, Window
from stillray.io.exr.deflate import is_plain, read_planes
from stillray.io.exr.openimageio import checked_container, opened, openimageio, reason
from stillray.io.exr.views import VIEW, channels_of_view, require_view, views_of

Channels = dict[str, np.ndarray]

# Channels between two wanted ones that are rather read than the part decoded twice.
_WORTH_SKIPPING = 4
_MOST_LISTED = 8  # channels in a message


@dataclass(frozen=True)
class ExrFile:
    """An EXR file whose container has been checked, and what its channels are called.

    Attributes
    ----------
    path
        The file.
    container
        Its headers and chunks.
    channels
        Name of each channel to the number of its part and its name there. Where a part has a
        name and its channels carry no layer, ``part.channel`` is the name; in the first part
        only if that is a known layer. Of one view alone, if one was asked for, and without its
        name.
    views
        Names of all views that the file holds, see `stillray.io.exr.views`; empty for one picture.
    """

    path: Path
    container: Container
    channels: Mapping[str, tuple[int, str]]
    views: tuple[str, ...] = ()

    @classmethod
    def open(
        cls, path: str | os.PathLike[str], *, headers_only: bool = False, view: str | None = None
    ) -> ExrFile:
        """Read headers and, unless told otherwise, the table of chunks; no pixels.

        Parameters
        ----------
        path
            The file.
        headers_only
            Leave the table of chunks alone.
        view
            Name of the view to take of a file that holds several; None for all channels, without
            the view's name where there is one alone.

        Raises
        ------
        InputError
            The file is missing, not EXR, truncated, its claims cannot be true, or it has no such
            view.
        """
        path = Path(path)
        container = checked_container(path, headers_only=headers_only)
        views = views_of(container)
        if view is None and len(views) == 1:
            (view,) = views
        if view is None:
            listed = [
                (number, part.name, channel.name, channel.name)
                for number, part in enumerate(container.parts)
                for channel in part.channels
            ]
        else:
            require_view(views, view, path)
            listed = list(channels_of_view(container, view))
        channels: dict[str, tuple[int, str]] = {}
        for number, group in groupby(listed, key=lambda entry: entry[0]):
            entries = list(group)
            plain = [channel for _, _, channel, _ in entries]
            keys = [f"{part}.{c}" if part and "." not in c else c for _, part, c, _ in entries]
            # the first part is often the beauty under a name of its own: then R, G, B say more
            keys = keys if number != listed[0][0] or find_layers(keys) else plain
            for key, (_, _, _, name) in zip(keys, entries, strict=True):
                channels.setdefault(key, (number, name))
        return cls(path, container, channels, views)

    @classmethod
    def of_layers(
        cls,
        path: str | os.PathLike[str],
        layers: Mapping[str, str] | None,
        *,
        headers_only: bool = False,
    ) -> ExrFile:
        """As `open`, in the view that ``layers`` name under `stillray.io.exr.views.VIEW`.

        Raises
        ------
        InputError
            The file holds several views and none is named: one of them in silence would leave an
            eye noisy.
        """
        file = cls.open(path, headers_only=headers_only, view=(layers or {}).get(VIEW))
        if len(file.views) > 1 and VIEW not in (layers or {}):
            raise InputError(
                f"{path}: holds the views {', '.join(file.views)}, of which one must be chosen, as "
                f"view={file.views[0]} among the layers or --view {file.views[0]}"
            )
        return file

    def window(self, channel: str) -> Window:
        """The data window of the part that holds a channel."""
        return self.container.parts[self.channels[channel][0]].data

    def read(self, names: Iterable[str], window: Window | None = None) -> Channels:
        """Read some channels, and decode no part that holds none of them.

        Parameters
        ----------
        names
            As ``channels`` has them.
        window
            The pixels wanted, 0 where a part has none; each part's own data window if None.

        Returns
        -------
        dict of str to (height, width) float32

        Raises
        ------
        InputError
            The pixels cannot be decoded, or are deep.
        """
        wanted: dict[int, dict[str, str]] = {}
        for name in names:
            number, channel = self.channels[name]
            wanted.setdefault(number, {})[channel] = name
        planes: Channels = {}
        for number, channels in wanted.items():
            part = self.container.parts[number]
            _require_readable(self.path, number, part)
            if is_plain(part, channels):
                chunks = [chunk for chunk in self.container.chunks if chunk.part == number]
                found = read_planes(self.path, part, chunks, channels)
            else:
                found = _read_part(self.path, number, set(channels))
            for channel, plane in found.items():
                if window is not None and window != part.data:
                    plane = _placed(plane, part.data, window)
                planes[channels[channel]] = plane
        return planes


def _require_readable(path: Path, number: int, part: Part) -> None:
    """Raise `InputError` where a part's pixels are of a kind that nobody decodes here."""
    if part.deep:
        raise InputError(f"{path}: must hold flat pixels, part {number} is deep")
    coarse = [channel.name for channel in part.channels if channel.sampling != (1, 1)]
    if coarse:
        raise InputError(
            f"{path}: must hold channels of full resolution, part {number} has subsampled ones, as "
            f"luminance-chroma files have: {', '.join(coarse[:_MOST_LISTED])}"
        )


def _read_part(path: Path, number: int, wanted: set[str]) -> Channels:
    oiio = openimageio()
    planes: Channels = {}
    with opened(path) as source:
        if not source.seek_subimage(number, 0):
            message = reason(source.geterror())
            raise InputError(f"{path}: cannot read part {number}: {message}")
        spec = source.spec()
        order = list(spec.channelnames)
        for first, last in _runs([i for i, name in enumerate(order) if name in wanted]):
            pixels = source.read_image(number, 0, first, last, oiio.FLOAT)
            if pixels is None:
                raise InputError(f"{path}: cannot read the pixels: {reason(source.geterror())}")
            pixels = np.asarray(pixels).reshape(spec.height, spec.width, last - first)
            planes |= {n: pixels[..., i] for i, n in enumerate(order[first:last]) if n in wanted}
    return planes


def _runs(places: list[int]) -> list[tuple[int, int]]:
    """Ranges of channels to read at once; each range costs the decoding of the whole part."""
    runs: list[tuple[int, int]] = []
    for place in places:
        if runs and place - runs[-1][1] <= _WORTH_SKIPPING:
            runs[-1] = (runs[-1][0], place + 1)
        else:
            runs.append((place, place + 1))
    return runs


def _placed(plane: np.ndarray, own: Window, wanted: Window) -> np.ndarray:
    placed = np.zeros((wanted.height, wanted.width), np.float32)
    left, top = max(own.x, wanted.x), max(own.y, wanted.y)
    right = min(own.x + own.width, wanted.x + wanted.width)
    bottom = min(own.y + own.height, wanted.y + wanted.height)
    if left < right and top < bottom:
        placed[top - wanted.y : bottom - wanted.y, left - wanted.x : right - wanted.x] = plane[
            top - own.y : bottom - own.y, left - own.x : right - own.x
        ]
    return placed

"""Views of a file: the left and the right eye of a stereo picture, or several cameras.

A file says so in one of three ways: parts carry the attribute ``view``; the first part's attribute
``multiView`` lists views, which stand in channels' names before the last component, but for the
first one, whose channels may carry none; or all parts are named by eyes, as ``rgba_left`` and
``rgba_right``: a light called ``key_left`` beside a beauty makes no view.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator

from stillray.errors import InputError
from stillray.io.exr.container import Container, Part

#: Key under which the view stands among the layers that a user names.
VIEW = "view"
_EYES = ("left", "right")
_MOST_VIEWS = 64


def views_of(container: Container) -> tuple[str, ...]:
    """Names of a file's views, the default one first; empty where none are named."""
    return _of_parts(container) or _of_channels(container)


def channels_of_view(container: Container, view: str) -> Iterator[tuple[int, str, str, str]]:
    """The channels of one view, and those that belong to none.

    Yields
    ------
    number, part, channel, name
        Number of the part; the part's name and the channel's without the view; its name there.
    """
    by_part, by_channel = _of_parts(container), _of_channels(container)
    of_parts = _views_of_parts(container)
    for number, part in enumerate(container.parts):
        if by_part and of_parts[number] not in ("", view):
            continue
        name = _without(part.name, view) if by_part else part.name
        for channel in part.channels:
            own, plain = _split(channel.name, by_part or by_channel)
            # a channel without layers is of the default view; one of a layer alone, of every view
            shared = by_part or view == by_channel[0] or "." in channel.name
            if own == view or (own == "" and shared):
                yield number, name, plain, channel.name


def require_view(views: tuple[str, ...], view: str, path: object) -> None:
    """Raise `InputError` where a file has no such view."""
    if view not in views:
        has = f"it has {', '.join(views)}" if views else "it has one picture alone"
        raise InputError(f"{path}: must have the view {view}, but {has}")


def _of_parts(container: Container) -> tuple[str, ...]:
    found = dict.fromkeys(_views_of_parts(container))
    found.pop("", None)
    return tuple(found)


def _of_channels(container: Container) -> tuple[str, ...]:
    found = _listed(container.parts[0])
    others = found[1:]
    named = any(_split(c.name, others)[0] for part in container.parts for c in part.channels)
    return found if named else ()


def _views_of_parts(container: Container) -> list[str]:
    """The view of each part, or "" where it is of none."""
    stated = [part.text("view") for part in container.parts]
    if any(stated):
        return stated
    named = [_eye_of(part.name) for part in container.parts]
    return named if all(named) else [""] * len(named)


def _eye_of(name: str) -> str:
    words = re.split(r"[._ -]", name)
    return next((word for word in (words[-1], words[0]) if word.lower() in _EYES), "")


def _without(name: str, view: str) -> str:
    """A part's name without the view's at its end or beginning."""
    pattern = rf"[._ -]?{re.escape(view)}$|^{re.escape(view)}[._ -]?"
    return re.sub(pattern, "", name, count=1)


def _listed(part: Part) -> tuple[str, ...]:
    """What ``multiView`` lists; nothing where its value makes no sense."""
    values = [a.value for a in part.attributes if (a.name, a.kind) == ("multiView", "stringvector")]
    data = values[0] if values else b""
    names: list[str] = []
    while len(data) >= 4 and len(names) < _MOST_VIEWS:
        (length,) = struct.unpack("<i", data[:4])
        if not 0 < length <= len(data) - 4:
            return ()
        names.append(data[4 : 4 + length].decode("utf-8", "replace"))
        data = data[4 + length :]
    return tuple(dict.fromkeys(names))


def _split(channel: str, views: tuple[str, ...]) -> tuple[str, str]:
    """A channel's view, or "", and its name without that."""
    *layers, component = channel.split(".")
    if layers and layers[-1] in views:
        return layers[-1], ".".join([*layers[:-1], component])
    return "", channel

# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes of a render in memory as the buffers of a frame, and the picture back."""

import numpy as np


def frame_of(layer, size: tuple[int, int], view: str, *, job, motion: bool):
    """The buffers of one view of a rendered view layer.

    Passes are named as Blender names the channels of an EXR file, and taken by the same table.

    Parameters
    ----------
    layer : bpy.types.RenderLayer
    size
        Width and height of the render, pixels.
    view
        Name of the eye; empty where there is but one.
    job
        Its ``samples`` a pixel and ``filter_spread``, see `stillray.Frame`.
    motion
        Whether the Vector pass can be used.

    Returns
    -------
    stillray.Frame
    """
    from stillray import Frame
    from stillray.io.channels.roles import find_layers, gather

    held = {}
    for item in _passes_of(layer, view):
        for place, part in enumerate(item.channel_id):
            held[f"{layer.name}.{item.name}.{part}"] = item, place
    buffers = {}
    for match in find_layers(held):
        if not match.used or (match.role == "motion" and not motion):
            continue
        planes = _Planes(held, size)
        buffers[match.role] = gather(match, {name: planes[name] for name in match.channels})
    return Frame(**{"samples": job.samples, **buffers}, filter_spread=job.filter_spread)


def put_picture(layer, size: tuple[int, int], view: str, picture: np.ndarray) -> None:
    """Replace the color of the Combined pass; alpha stays.

    Parameters
    ----------
    layer, size, view
        As for `frame_of`.
    picture : (height, width, 3) float32
        Row 0 at the top.
    """
    combined = next(item for item in _passes_of(layer, view) if item.name == "Combined")
    pixels = _pixels(combined, size)
    pixels[..., :3] = picture[::-1]
    combined.rect.foreach_set(pixels.reshape(-1))


class _Planes:
    """Channels by name, row 0 at the top; each pass is read once."""

    def __init__(self, held: dict, size: tuple[int, int]) -> None:
        self._held, self._size = held, size
        self._read: dict[str, np.ndarray] = {}

    def __getitem__(self, name: str) -> np.ndarray:
        item, place = self._held[name]
        if item.fullname not in self._read:
            self._read[item.fullname] = _pixels(item, self._size)
        return self._read[item.fullname][::-1, :, place]


def _passes_of(layer, view: str) -> list:
    return [item for item in layer.passes if item.fullname == f"{item.name}.{view}".rstrip(".")]


def _pixels(item, size: tuple[int, int]) -> np.ndarray:
    """``(height, width, channels)`` float32 of a pass, row 0 at the bottom as Blender has it."""
    width, height = size
    pixels = np.empty((height, width, item.channels), np.float32)
    item.rect.foreach_get(pixels.reshape(-1))
    return pixels

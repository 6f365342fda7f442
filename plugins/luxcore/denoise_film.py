"""Render a LuxCore scene and denoise its film in the same process, without files between.

python plugins/luxcore/denoise_film.py SCENE.cfg clean.exr

Needs ``pip install pyluxcore`` beside stillray.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

# pyluxcore replaces the memory allocator of the process: libraries that are loaded after it crash,
# those that are there before do not. So stillray's come first, a session of ONNX Runtime too.
import cv2  # noqa: F401
import numpy as np
import onnxruntime  # noqa: F401

import stillray
from stillray.pixel_filter import filter_spread

#: The film's outputs by the names of a frame's buffers, and their channels.
OUTPUTS = {
    "color": ("RGB", 3),
    "albedo": ("ALBEDO", 3),
    "normal": ("AVG_SHADING_NORMAL", 3),
    "depth": ("DEPTH", 1),
}


def wanted(folder: Path) -> str:
    """Properties that make a film keep what is denoised; LuxCore wants a file's name for each."""
    return "".join(
        f"film.outputs.{index}.type = {name}\nfilm.outputs.{index}.filename = {folder}/{name}.exr\n"
        for index, (name, _) in enumerate(OUTPUTS.values())
    )


def spread_of(properties: Any) -> float | None:
    """Standard deviation of the film's pixel filter, in pixels; None of one that is not known.

    Parameters
    ----------
    properties
        Of the configuration. LuxCore's widths reach so far to each side; what it takes where
        nobody says was measured at an edge (2.11.2): Blackman-Harris, 2 pixels.
    """

    def told(name: str, usual: Any) -> Any:
        name = f"film.filter.{name}"
        return (
            type(usual)(properties.Get(name).GetString()) if properties.IsDefined(name) else usual
        )

    kind = told("type", "BLACKMANHARRIS")
    width = told("xwidth", told("width", 2.0))
    if kind == "NONE":
        return filter_spread("box")
    if kind == "BOX":
        return filter_spread("box", 2 * width)
    if kind == "BLACKMANHARRIS":
        return filter_spread("blackman-harris", width)
    if kind != "GAUSSIAN":
        return None
    x, alpha = np.linspace(0, width, 1000), told("gaussian.alpha", 2.0)
    weights = np.exp(-alpha * x**2) - np.exp(-alpha * width**2)  # it ends at its width
    return float(np.sqrt(np.average(x**2, weights=weights)))


def samples_of(session: Any) -> float:
    """Samples a pixel that a session has rendered, of the camera's."""
    count = session.GetStats().Get("stats.renderengine.total.samplecount").GetFloat()
    film = session.GetFilm()
    return max(count / (film.GetWidth() * film.GetHeight()), 1.0)


def frame_of(
    film: Any, samples: float | None = None, filter_spread: float | None = None
) -> stillray.Frame:
    """The film as a frame.

    Parameters
    ----------
    film
        Of a session that was configured with `wanted`.
    samples
        Samples a pixel that were rendered, if they are known.
    filter_spread
        Standard deviation of the film's pixel filter, in pixels, if it is known.
    """
    import pyluxcore

    buffers = {}
    for buffer, (name, channels) in OUTPUTS.items():
        values = np.empty((film.GetHeight(), film.GetWidth(), channels), np.float32)
        film.GetOutputFloat(getattr(pyluxcore.FilmOutputType, name), values, 0)
        buffers[buffer] = values[::-1]  # a film's rows go from the bottom to the top
    depth = buffers.pop("depth")[..., 0]
    return stillray.Frame(**buffers, depth=depth, samples=samples, filter_spread=filter_spread)


def render(properties: Any, scene: Any = None) -> Any:
    """Run a session to its end, as ``batch.haltspp`` or the like says; the session."""
    import pyluxcore

    config = pyluxcore.RenderConfig(properties, *([] if scene is None else [scene]))
    session = pyluxcore.RenderSession(config)
    session.Start()
    while not session.HasDone():
        time.sleep(0.05)
        session.UpdateStats()
    session.Stop()
    return session


def main(config: str, target: str) -> None:
    """Render what a configuration file describes, and write the denoised picture."""
    with stillray.Denoiser(temporal=False) as denoiser:
        import pyluxcore

        pyluxcore.Init()
        properties = pyluxcore.Properties(config)
        more = pyluxcore.Properties()
        more.SetFromString(wanted(Path(target).parent))
        properties.Set(more)
        session = render(properties)
        frame = frame_of(session.GetFilm(), samples_of(session), spread_of(properties))
        stillray.write_exr(target, denoiser.denoise(frame))


if __name__ == "__main__":
    main(*sys.argv[1:3])
    sys.stdout.flush()
    os._exit(0)  # pyluxcore may crash when Python ends

"""``python render.py CHECKOUT CONFIG OUT PROPERTIES``: what LuxCore writes of a scene.

CONFIG is a file within CHECKOUT, PROPERTIES are JSON: names and values that take the place of what
it says. A process of its own, since pyluxcore replaces the memory allocator and crashes at its end.
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path

import pyluxcore

OUTPUTS = ("RGB", "ALBEDO", "AVG_SHADING_NORMAL", "DEPTH")
#: What a configuration says of how it is rendered and shown, which is said anew.
_OURS = (
    "film.outputs",
    "film.imagepipeline",
    "film.imagepipelines",
    "film.filter",
    "batch",
    "tile",
)


def scene_of(file: str) -> pyluxcore.Scene:
    """A scene without the objects whose meshes a copy lacks; which, is printed."""
    told = pyluxcore.Properties(file)
    for name in list(told.GetAllNames("scene.objects")) + list(told.GetAllNames("scene.shapes")):
        if name.endswith(".ply") and not Path(told.Get(name).GetString()).is_file():
            print(f"{told.Get(name).GetString()} is missing: left out")
            told.DeleteAll(told.GetAllNames(name.removesuffix("ply")))
    scene = pyluxcore.Scene()
    scene.Parse(told)
    return scene


def render(config: Path, out: Path, told: dict[str, str]) -> None:
    """Write ``RGB.exr`` and features of a configuration, with `told` in place of what it says."""
    properties = pyluxcore.Properties(str(config))
    for start in _OURS:
        properties.DeleteAll(properties.GetAllNames(start))
    scene = scene_of(properties.Get("scene.file").GetString())
    for index, name in enumerate(OUTPUTS):
        told[f"film.outputs.{index}.type"] = name
        told[f"film.outputs.{index}.filename"] = str(out / f"{name}.exr")
    more = pyluxcore.Properties()
    more.SetFromString("".join(f"{name} = {value}\n" for name, value in told.items()))
    properties.Set(more)
    session = pyluxcore.RenderSession(pyluxcore.RenderConfig(properties, scene))
    session.Start()
    while not session.HasDone():
        time.sleep(0.05)
        session.UpdateStats()
    session.Stop()
    count = session.GetStats().Get("stats.renderengine.total.samplecount").GetFloat()
    film = session.GetFilm()
    print(f"{count / (film.GetWidth() * film.GetHeight()):.1f} samples a pixel")
    film.SaveOutputs()


if __name__ == "__main__":
    checkout, config, out, told = sys.argv[1:]
    target = Path(out).resolve()
    os.chdir(checkout)  # which scenes name their files from
    pyluxcore.Init(lambda _: None)
    render(Path(config), target, json.loads(told))
    sys.stdout.flush()
    os._exit(0)  # it crashes when Python ends

"""Render the small LuxCore files of ``tests/data/luxcore``: ``python make_luxcore.py FOLDER``.

Needs ``pyluxcore`` 2.11 from PyPI, in an environment of its own: it brings an allocator that
crashes beside other libraries. The tests read the committed files. A red square over a floor.
"""

from __future__ import annotations

import os
import sys
import time

import pyluxcore

OUTPUTS = ("RGB", "ALBEDO", "AVG_SHADING_NORMAL", "DEPTH")
SCENE = """
scene.camera.type = "perspective"
scene.camera.lookat.orig = 3 -6 3
scene.camera.lookat.target = 0 0 0.6
scene.camera.fieldofview = 40
scene.materials.floor.type = "matte"
scene.materials.floor.kd = 0.7 0.6 0.5
scene.materials.box.type = "matte"
scene.materials.box.kd = 0.8 0.2 0.1
scene.materials.lamp.type = "matte"
scene.materials.lamp.emission = 20 19 17
"""
FILM = """
renderengine.type = PATHCPU
sampler.type = SOBOL
film.width = 48
film.height = 37
batch.haltspp = 4
"""


def square(name: str, half: float, height: float, *, down: bool = False) -> str:
    """A level square around the origin."""
    corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
    numbers = " ".join(f"{x} {y} {height}" for x, y in (corners[::-1] if down else corners))
    start = f"scene.objects.{name}"
    return f"{start}.material = {name}\n{start}.vertices = {numbers}\n{start}.faces = 0 1 2 0 2 3\n"


def properties(text: str) -> pyluxcore.Properties:
    found = pyluxcore.Properties()
    found.SetFromString(text)
    return found


if __name__ == "__main__":
    os.chdir(sys.argv[1])
    pyluxcore.Init()
    scene = pyluxcore.Scene()
    things = square("floor", 9, 0) + square("box", 1, 1.2) + square("lamp", 1, 4, down=True)
    scene.Parse(properties(SCENE + things))
    outputs = "".join(
        f"film.outputs.{i}.type = {name}\nfilm.outputs.{i}.filename = {name}.exr\n"
        for i, name in enumerate(OUTPUTS)
    )
    session = pyluxcore.RenderSession(pyluxcore.RenderConfig(properties(FILM + outputs), scene))
    session.Start()
    while not session.HasDone():
        time.sleep(0.05)
        session.UpdateStats()
    session.Stop()
    session.GetFilm().SaveOutputs()
    os._exit(0)  # it crashes when Python ends

"""LuxCore's film, denoised in the process that rendered it."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import stillray

ROOT = Path(__file__).parents[2]
PROGRAM = """
import os, sys
from pathlib import Path
sys.path[:0] = [{example!r}, {data!r}]
import denoise_film as example
with example.stillray.Denoiser("fast", threads=1) as denoiser:
    import make_luxcore as small, pyluxcore
    pyluxcore.Init()
    scene = pyluxcore.Scene()
    square = small.square
    things = square("floor", 9, 0) + square("box", 1, 1.2) + square("lamp", 1, 4, down=True)
    scene.Parse(small.properties(small.SCENE + things))
    more = "film.outputs.9.type = SAMPLECOUNT\\nfilm.outputs.9.filename = count.exr\\n"
    film = small.properties(small.FILM + more + example.wanted(Path({out!r})))
    session = example.render(film, scene)
    frame = example.frame_of(session.GetFilm(), samples=4)
    counted = example.samples_of(session)
    counts = example.np.zeros(48 * 37, example.np.uint32)
    session.GetFilm().GetOutputUInt(pyluxcore.FilmOutputType.SAMPLECOUNT, counts, 0)
    filters = ["", "NONE", "BOX", "GAUSSIAN", "BLACKMANHARRIS\\nfilm.filter.width = 1.5", "SINC"]
    spreads = [
        example.spread_of(small.properties(each and "film.filter.type = " + each + "\\n"))
        for each in filters
    ]
    buffers = {{name: getattr(frame, name) for name in ("color", "albedo", "normal", "depth")}}
    example.np.savez({out!r} + "/film.npz", clean=denoiser.denoise(frame), counted=counted,
        counts=counts, spreads=example.np.array(spreads, float), **buffers)
sys.stdout.flush()
os._exit(0)
"""


@pytest.mark.skipif(importlib.util.find_spec("pyluxcore") is None, reason="no pyluxcore here")
def test_a_films_arrays_are_a_frame_and_are_denoised(tmp_path):
    given = {"example": ROOT / "plugins/luxcore", "data": ROOT / "tests/data", "out": tmp_path}
    program = PROGRAM.format(**{name: str(path) for name, path in given.items()})
    # a process of its own: the allocator of pyluxcore would stay in this one
    command = [sys.executable, "-c", program]
    paths = os.pathsep.join([str(ROOT / "runtime"), os.environ.get("PYTHONPATH", "")])
    run = subprocess.run(
        command, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": paths}
    )
    assert run.returncode == 0, run.stderr
    film = np.load(tmp_path / "film.npz")
    # the red square hovers above the middle, the floor fills the lowest rows
    # within it: pixels of its edge hold a sample or two of the floor, not the same every time
    np.testing.assert_allclose(film["albedo"][14, 25], [0.8, 0.2, 0.1], rtol=1e-3)
    np.testing.assert_allclose(film["normal"][-1, 0], [0, 0, 1], atol=1e-3)
    assert film["depth"][-1, 24] < film["depth"][18, 24] < film["depth"][0, 24] == np.inf
    # more than were asked for: it looks now and then whether there are enough
    assert 4 <= film["counted"] == pytest.approx(film["counts"].mean(), rel=0.01)
    # measured at a slanted edge: 0.55, 0.29, 1.16, 0.50, 0.42 pixels; of a sinc nothing is known
    np.testing.assert_allclose(
        film["spreads"], [0.56, 0.289, 1.155, 0.49, 0.42, np.nan], atol=0.012
    )
    frame = stillray.Frame(
        samples=4, **{name: film[name] for name in ("color", "albedo", "normal", "depth")}
    )
    with stillray.Denoiser("fast", threads=1) as denoiser:
        np.testing.assert_allclose(film["clean"], denoiser.denoise(frame), rtol=1e-5, atol=1e-6)
    floor = np.s_[-6:, :]
    rough = [np.abs(np.diff(film[name][floor], axis=1)).mean() for name in ("clean", "color")]
    assert rough[0] < 0.5 * rough[1]

"""LuxCore's scenes as stills to test on: what it writes of a configuration is read as a frame."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from stillray.errors import InputError
from stillray_training.luxcore import __main__ as luxcore

CONFIG = """
scene.file = scenes/tiny/tiny.scn
sampler.type = METROPOLIS
film.width = 9
batch.halttime = 3
film.outputs.1.type = RGB_IMAGEPIPELINE
film.outputs.1.filename = theirs.png
film.imagepipelines.0.0.type = TONEMAP_LINEAR
film.imagepipelines.0.0.scale = 7
"""
SCENE = """
scene.camera.lookat.orig = 0 0 5
scene.camera.lookat.target = 0 0 0
scene.camera.up = 0 1 0
scene.materials.wall.type = matte
scene.materials.wall.kd = 0.8 0.4 0.2
scene.lights.sky.type = constantinfinite
scene.lights.sky.color = 2 2 2
scene.objects.wall.material = wall
scene.objects.wall.vertices = -9 -9 0 9 -9 0 9 9 0 -9 9 0
scene.objects.wall.faces = 0 1 2 0 2 3
scene.objects.lost.material = wall
scene.objects.lost.ply = scenes/tiny/lost.ply
"""
TOLD = {"film.width": "16", "film.height": "12", "batch.haltspp": "8", "renderengine.seed": "3"}


@pytest.fixture
def checkout(tmp_path):
    folder = tmp_path / "scenes" / "tiny"
    folder.mkdir(parents=True)
    (folder / "tiny.cfg").write_text(CONFIG)
    (folder / "tiny.scn").write_text(SCENE)
    return tmp_path


@pytest.mark.skipif(importlib.util.find_spec("pyluxcore") is None, reason="no pyluxcore here")
def test_a_film_is_a_frame_and_lost_meshes_are_said(checkout, capsys):
    frame = luxcore.rendered(checkout, "scenes/tiny/tiny.cfg", TOLD)
    missing, count = capsys.readouterr().out.splitlines()
    assert missing == "scenes/tiny/lost.ply is missing: left out"
    assert count.endswith(" samples a pixel")
    assert float(count.split()[0]) >= 8  # a picture so small has more before it is looked at
    assert frame.color.shape == (12, 16, 3)
    # a wall below an even sky sends back what it does not swallow: no camera, no tone map between
    np.testing.assert_allclose(frame.color.mean(axis=(0, 1)), [1.6, 0.8, 0.4], rtol=0.01)
    assert np.abs(frame.color[..., 0] - 1.6).max() < 0.3  # 8 samples of which each sees the sky
    np.testing.assert_allclose(frame.albedo[6, 8], [0.8, 0.4, 0.2], rtol=1e-3)
    np.testing.assert_allclose(frame.normal[6, 8], [0, 0, 1], atol=1e-3)
    np.testing.assert_allclose(frame.depth[6, 8], 5, rtol=0.01)
    assert not list(checkout.glob("*.png"))


@pytest.mark.skipif(importlib.util.find_spec("pyluxcore") is None, reason="no pyluxcore here")
def test_what_luxcore_says_of_a_broken_scene_is_told(checkout):
    (checkout / "scenes/tiny/tiny.scn").write_text("scene.camera.type = fisheye\n")
    with pytest.raises(
        InputError, match=r"LuxCore must render scenes/tiny/tiny.cfg, got .*fisheye"
    ):
        luxcore.rendered(checkout, "scenes/tiny/tiny.cfg", TOLD)


def test_a_folder_that_is_no_checkout_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"checkout must have scenes/classroom/classroom\.cfg"):
        luxcore.main(tmp_path, tmp_path / "out")
    assert not (tmp_path / "out").exists()

"""The Blender extension, built, installed and used in Blender.

Needs a Python that has ``bpy`` (``make programs``, Python 3.11, 300 MB): this one, or that which
STILLRAY_BLENDER_PYTHON names, as ``make test`` sets it. Fetches the wheels of the extension.
"""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PYTHON = os.environ.get("STILLRAY_BLENDER_PYTHON") or (
    sys.executable if importlib.util.find_spec("bpy") else ""
)
HALF = 2**-11  # the largest relative error of rounding to half precision

if not PYTHON:
    pytest.skip(
        "no Python with bpy here (make programs), and STILLRAY_BLENDER_PYTHON names none",
        allow_module_level=True,
    )


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict:
    """What happened in Blender."""
    folder = tmp_path_factory.mktemp("blender")
    build = [sys.executable, str(ROOT / "plugins" / "blender" / "build.py"), str(folder)]
    subprocess.run(build, check=True)
    # Blender finds nothing of this project but what the extension brings
    own = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    package = next(folder.glob("*.zip"))
    command = [PYTHON, str(HERE / "in_blender.py"), str(package), str(folder)]
    subprocess.run(command, check=True, env=own)
    return json.loads((folder / "found.json").read_text())


def test_blender_takes_the_package(found):
    assert found["blender validates"]
    assert found["enabled"]
    assert found["wrapped"] == ["bl_ext.user_default.stillray.hook"] * 2


def test_the_button_turns_passes_on(found):
    assert found["passes"] == [True, True]


def test_rendered_frames_are_what_the_api_makes_of_noisy_ones(found):
    assert found["hook changed"] > 0.5
    assert found["hook, float"] < 1e-6
    assert found["hook, half"] < HALF


@pytest.mark.parametrize("how", ["alone", "ensemble", "box filter", "data kept", "tiled", "bare"])
def test_also_in_other_renders(found, how):
    assert found[how] < 1e-6


def test_the_scene_s_pixel_filter_is_told(found):
    assert found["box taken for Blender's usual filter"] > 1e-3


def test_other_passes_stay(found):
    assert found["hook, other passes"] == []
    assert found["operator, other passes"] == []


def test_rendered_files_come_out_the_same(found):
    assert found["operator ended"] == ["FINISHED"]
    assert found["operator"] < 1e-6
    assert found["names"] == ["out_01.exr", "out_02.exr", "out_03.exr"]


def test_a_sequence_can_be_stopped(found):
    assert found["stopped"] == [True, "", True]


def test_eyes_layers_and_borders(found):
    assert found["size"] == [33, 49, 3]
    assert len(found["eyes and layers"]) == 8
    assert max(found["eyes and layers"].values()) < 1e-6


def test_what_is_missing_is_told(found):
    words = {how: " ".join(said) for how, (_, said) in found["words"].items()}
    assert "no Denoising Data passes" in words["bare"]
    assert "no Vector pass" in words["bare"]
    assert "motion blur empties the Vector pass" in words["blurred"]
    assert "no rendered frame at" in found["no file"]


def test_a_failure_leaves_the_render_as_it_was(found):
    assert "not denoised" in " ".join(found["words"]["broken"][1])
    assert found["broken"] == 0


def test_memory_stays_flat_over_two_hundred_frames(found):
    assert max(found["memory"]) - found["memory"][0] < 8  # MiB


def test_nothing_is_left(found):
    assert found["after"] == found["before"]
    assert found["files left"] == []

"""The package for browsers, in Node and in Chromium, beside the same graph in Python.

Needs the packages that ``make programs`` has npm install, and for the page Chromium and playwright,
as the comparison page's tests do.
"""

from __future__ import annotations

import importlib.util
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from stillray_export.frame_graph.moving import sequence  # noqa: E402
from tests.export.frame_graph.test_frame_graph import Graph, decibels  # noqa: E402

WEB = Path(__file__).parents[2] / "plugins/web"
PACKAGES = WEB / "node_modules"
#: dB: the same operators in other libraries, rounding apart
PARITY = 100
FRAMES = sequence(3, 37, 50)


def needs(package: str) -> pytest.MarkDecorator:
    there = (PACKAGES / package).is_dir() and shutil.which("node") is not None
    return pytest.mark.skipif(not there, reason=f"npm has not installed {package}: make programs")


def module_of(name):
    """A module of the demo, which is no package."""
    found = importlib.util.spec_from_file_location(f"demo_{name}", WEB / f"demo/{name}.py")
    module = importlib.util.module_from_spec(found)
    sys.modules[found.name] = module  # dataclasses look for it there
    found.loader.exec_module(module)
    return module


MEASURE = module_of("measure")


@pytest.fixture(scope="module")
def graph(frame_graph):
    """The smaller of the kernel pyramids."""
    return Graph(frame_graph("kpyr-5s"))


@pytest.fixture(scope="module")
def wanted(graph):
    return [graph(frame) for frame in FRAMES]


@pytest.fixture
def folder(graph, tmp_path):
    """A folder of the demo."""
    out = tmp_path / "demo"
    module_of("build").build(graph.path, FRAMES, PACKAGES / "onnxruntime-web/dist", out)
    return out


def same(played, wanted):
    assert len(played.pictures) == len(played.milliseconds) == len(wanted)
    assert played.processor > 0
    return all(
        decibels(got, picture) > PARITY
        for got, picture in zip(played.pictures, wanted, strict=True)
    )


def test_what_a_demo_folder_holds_is_what_was_put_in(folder, wanted):
    for got, frame in zip(MEASURE.read_frames(folder / "frames"), FRAMES, strict=True):
        for name in ("color", "albedo", "normal", "depth", "motion"):
            np.testing.assert_array_equal(getattr(got, name), getattr(frame, name))
    assert same(MEASURE.in_python(folder), wanted)


@needs("onnxruntime-node")
def test_node_gives_pythons_pictures(folder, wanted):
    assert same(MEASURE.in_node(folder), wanted)


@needs("onnxruntime-node")
def test_node_refuses_buffers_of_another_size_in_one_line(graph, tmp_path):
    script = f"""
        import {{ createRequire }} from 'node:module';
        import {{ Denoiser }} from '{WEB}/stillray.js';
        const ort = createRequire('{WEB}/package.json')('onnxruntime-node');
        const denoiser = await Denoiser.load(ort, '{graph.path}', ['cpu']);
        const frame = {{ width: 4, height: 2, color: new Float32Array(24) }};
        await denoiser.denoise({{ ...frame, depth: new Float32Array(7) }})
            .catch((error) => console.log(error.message));
        console.log((await denoiser.denoise(frame)).length);
    """
    (tmp_path / "wrong.mjs").write_text(script)
    run = subprocess.run(["node", tmp_path / "wrong.mjs"], capture_output=True, text=True)
    assert run.stdout.splitlines() == ["depth must be a Float32Array of 8 values, got 7", "24"]


@needs("onnxruntime-web")
@pytest.mark.skipif(MEASURE.CHROMIUM is None, reason="no Chromium is installed")
def test_the_page_plays_pythons_pictures_in_chromium(folder, wanted):
    pytest.importorskip("playwright.sync_api")
    played = MEASURE.in_chromium(folder)
    assert same(played, wanted)
    assert "wasm" in MEASURE.row(played, played)


@pytest.mark.skipif(shutil.which("npm") is None, reason="no npm is installed")
def test_the_package_takes_its_weights_along_and_is_not_made_without(tmp_path):
    package = tmp_path / "node_modules/stillray-web"
    package.mkdir(parents=True)
    for name in ("package.json", "stillray.js", "prepack.mjs", "README.md"):
        shutil.copyfile(WEB / name, package / name)
    pack = ["npm", "pack", "--dry-run", "--json", "--offline"]
    run = subprocess.run(pack, cwd=package, capture_output=True, text=True)
    assert run.returncode != 0
    assert "models/ must hold a frame graph" in run.stderr
    (package / "models").mkdir()
    (package / "models/kpyr-5s.frame.onnx").write_bytes(b"weights")
    run = subprocess.run(pack, cwd=package, capture_output=True, text=True)
    (packed,) = json.loads(run.stdout[run.stdout.index("[") :])
    files = {file["path"] for file in packed["files"]}
    assert {"stillray.js", "models/kpyr-5s.frame.onnx"} <= files
    (tmp_path / "user.mjs").write_text(
        "console.log(import.meta.resolve('stillray-web/models/kpyr-5s.frame.onnx'));"
        "console.log(typeof (await import('stillray-web')).Denoiser.load);"
    )
    run = subprocess.run(["node", tmp_path / "user.mjs"], capture_output=True, text=True)
    place, kind = run.stdout.split()
    assert Path(place.removeprefix("file://")).read_bytes() == b"weights"
    assert kind == "function"

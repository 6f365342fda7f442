"""The package for browsers, in Node and in Chromium, beside the same graph in Python.

Needs the packages of ``npm install --ignore-scripts --prefix plugins/web``, and for the page
Chromium and playwright, as the comparison page's tests do.
"""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from stillray.models.registry import find_model  # noqa: E402
from stillray_export.frame_graph.export import write  # noqa: E402
from stillray_export.frame_graph.moving import sequence  # noqa: E402
from tests.export.frame_graph.test_frame_graph import Graph, decibels  # noqa: E402

WEB = Path(__file__).parents[2] / "plugins/web"
PACKAGES = WEB / "node_modules"
CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
#: dB: the same operators in other libraries, rounding apart
PARITY = 100
FRAMES = sequence(3, 37, 50)


def needs(package: str) -> pytest.MarkDecorator:
    there = (PACKAGES / package).is_dir() and shutil.which("node") is not None
    return pytest.mark.skipif(not there, reason=f"npm has not installed {package}")


@pytest.fixture(scope="module")
def build():
    found = importlib.util.spec_from_file_location("demo_build", WEB / "demo/build.py")
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def graph(tmp_path_factory):
    """The smaller of the kernel pyramids."""
    return Graph(write(find_model("kpyr-5s"), tmp_path_factory.mktemp("graph")))


@pytest.fixture(scope="module")
def wanted(graph):
    return [graph(frame) for frame in FRAMES]


@needs("onnxruntime-node")
def test_node_gives_pythons_pictures(graph, wanted, build, tmp_path):
    build.write_frames(FRAMES, tmp_path / "frames")
    command = ["node", "test/sequence.mjs", graph.path, tmp_path / "frames", tmp_path]
    run = subprocess.run(command, cwd=WEB, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    for index, picture in enumerate(wanted):
        got = np.fromfile(tmp_path / f"{index}.f32", "<f4").reshape(picture.shape)
        assert decibels(got, picture) > PARITY


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


class Quiet(SimpleHTTPRequestHandler):
    extensions_map = SimpleHTTPRequestHandler.extensions_map | {".mjs": "text/javascript"}

    def log_message(self, *_):
        pass


@pytest.fixture
def served(tmp_path):
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(tmp_path)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/"
    server.shutdown()


@needs("onnxruntime-web")
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
def test_the_page_plays_pythons_pictures_in_chromium(graph, wanted, build, served, tmp_path):
    playwright = pytest.importorskip("playwright.sync_api")
    build.build(graph.path, FRAMES, PACKAGES / "onnxruntime-web/dist", tmp_path)
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM)
        page = browser.new_page()
        page.goto(served)
        page.wait_for_function("window.played || window.failed", timeout=240_000)
        assert page.evaluate("window.failed") is None
        assert "Frame 3 of 3" in page.inner_text("#status")
        for index, picture in enumerate(wanted):
            values = page.evaluate(f"Array.from(window.played.pictures[{index}])")
            got = np.array(values, np.float32).reshape(picture.shape)
            assert decibels(got, picture) > PARITY
        browser.close()

"""The example in C++: compiled, run, and its pictures beside those of the same graph in Python.

Needs a compiler, and ``ONNXRUNTIME`` in the environment: a folder with ONNX Runtime's ``include``,
and perhaps ``lib``.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import onnxruntime
import pytest

torch = pytest.importorskip("torch")

from stillray import read_exr  # noqa: E402
from tests.export.frame_graph.test_frame_graph import Graph  # noqa: E402

ROOT = Path(__file__).parents[2]
CPP = ROOT / "plugins/cpp"
COMPILER = next(filter(None, map(shutil.which, ("g++", "clang++"))), None)
HOME = os.environ.get("ONNXRUNTIME")
HEADERS = Path(HOME or ".") / "include"
FRAMES = 4

pytestmark = pytest.mark.skipif(
    COMPILER is None or HOME is None or not (HEADERS / "onnxruntime_cxx_api.h").is_file(),
    reason="no C++ compiler, or ONNXRUNTIME names no folder with ONNX Runtime's include",
)


def library():
    """ONNX Runtime's shared library: beside the headers, or Python's own."""
    folders = (Path(HOME) / "lib", Path(onnxruntime.__file__).parent / "capi")
    found = [path for folder in folders for path in sorted(folder.glob("libonnxruntime.so*"))]
    if not found:
        pytest.skip("no libonnxruntime.so")
    return found[0]


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    made, shared = tmp_path_factory.mktemp("cpp") / "denoise_sequence", library()
    # by the name that programs look for, which is not in Python's package
    (made.parent / "libonnxruntime.so.1").symlink_to(shared)
    source = str(CPP / "denoise_sequence.cpp")
    flags = ["-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror", "-isystem", str(HEADERS)]
    command = [COMPILER, *flags, source, str(shared), f"-Wl,-rpath,{made.parent}", "-o", made]
    run = subprocess.run(command, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return made


def test_pictures_of_a_sequence_are_pythons(program, frame_graph, tmp_path):
    graph = Graph(frame_graph("kpyr-5s"))
    paths = sorted((ROOT / "tests/data/room").glob("frame_*.exr"))[:FRAMES]
    frames = [read_exr(path) for path in paths]
    sizes = dumper().dump(frames, tmp_path / "frames")
    out = tmp_path / "clean"
    out.mkdir()
    command = [program, graph.path, tmp_path / "frames", *sizes, out]
    run = subprocess.run([str(word) for word in command], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    for index, frame in enumerate(frames):
        got = np.fromfile(out / f"{index}.f32", "<f4").reshape(frame.color.shape)
        np.testing.assert_allclose(got, graph(frame), rtol=1e-5, atol=1e-5)


def dumper():
    found = importlib.util.spec_from_file_location("dump_frames", CPP / "dump.py")
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


def test_what_is_wrong_is_one_line(program, tmp_path):
    (tmp_path / "0.f32").write_bytes(bytes(64))
    model = str(tmp_path / "none.onnx")
    run = subprocess.run(
        [program, model, tmp_path, "8", "8", "1", tmp_path], capture_output=True, text=True
    )
    assert run.returncode == 1
    assert run.stderr.startswith("error: ")
    assert run.stderr.count("\n") == 1

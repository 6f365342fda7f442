from __future__ import annotations

import json
import subprocess
import sys

import pytest

from stillray.cli import main
from stillray.profiling import install


def test_an_installation_that_works_has_no_problem(capsys):
    assert main(["doctor", "-m", "fast", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    text = "\n".join(finding["text"] for finding in found)
    for words in (
        "stillray ",
        "Python ",
        "cv2: ",
        "onnxruntime: ",
        "threads: ",
        "denoises a frame",
    ):
        assert words in text
    assert {finding["kind"] for finding in found} <= {"ok", "note"}


def test_a_library_that_is_there_twice_is_a_problem_with_its_cure(tmp_path):
    # what pip leaves of a second OpenCV: its record, and files that overwrote each other
    record = tmp_path / "opencv_python-4.9.0.dist-info"
    record.mkdir()
    (record / "METADATA").write_text("Metadata-Version: 2.1\nName: opencv-python\nVersion: 4.9.0\n")
    (record / "RECORD").write_text("cv2/__init__.py,,\n")
    program = (
        f"import sys; sys.path.append({str(tmp_path)!r})\n"
        "from stillray.cli import main\n"
        "sys.exit(main(['doctor', '-m', 'fast']))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 1
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("problem")]
    assert "cv2 comes from 2 packages" in line
    assert "opencv-python 4.9.0" in line
    assert "pip uninstall opencv-" in line
    assert line.endswith("pip install opencv-contrib-python-headless")


def test_a_library_that_cannot_be_loaded_is_a_problem(monkeypatch):
    def fail(name):
        raise ImportError("libGL.so.1: cannot open\nshared object file")

    monkeypatch.setattr(install, "import_module", fail)
    (found,) = install.look_at_module("cv2", "opencv-contrib-python-headless", {})
    assert found.kind == "problem"
    assert "libGL.so.1: cannot open shared object file" in found.text
    assert found.text.endswith("pip install --force-reinstall opencv-contrib-python-headless")


def test_a_model_that_is_none_is_a_problem(capsys):
    assert main(["doctor", "-m", "none.onnx"]) == 1
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("problem none.onnx cannot be used")


@pytest.mark.parametrize(
    ("files", "quota"),
    [
        ({"cpu.max": "150000 100000\n"}, 1.5),
        ({"cpu.max": "max 100000\n"}, None),
        ({"cpu/cpu.cfs_quota_us": "400000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 4.0),
        ({"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, None),
        ({"cpu.max": "what"}, None),
        ({}, None),
    ],
)
def test_a_containers_time_is_read(tmp_path, files, quota):
    (tmp_path / "cpu").mkdir()
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    assert install.cpu_quota(tmp_path) == quota


def test_more_threads_than_time_is_noted():
    assert install.look_at_threads(8, 1.5).kind == "note"
    assert "threads=1 " in install.look_at_threads(8, 1.5).text
    assert install.look_at_threads(2, 4.0).kind == "ok"


def test_opencv_that_rounds_places_is_noted(monkeypatch):
    import cv2

    assert install.look_at_remap().kind == ("ok" if int(cv2.__version__[0]) >= 5 else "note")
    exact = cv2.remap

    def rounded(image, x, y, how):
        return exact(image, (x * 32).round() / 32, y, how)

    monkeypatch.setattr(cv2, "remap", rounded)
    assert "1/32" in install.look_at_remap().text

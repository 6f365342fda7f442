from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="models are bent with the onnx package of the extra train")

import onnxruntime

import stillray
from stillray.cli import main
from tests.model_spec.bent_models import KINDS, MODELS, in_spec, whole

ROOT = Path(__file__).parents[2]
FUZZ_SEED = 1
# STILLRAY_FUZZ=10000 for the long run
FUZZ_COUNT = int(os.environ.get("STILLRAY_FUZZ", "200"))


@pytest.fixture
def path(tmp_path):
    return tmp_path / "bent.onnx"


@pytest.fixture
def no_session(monkeypatch):
    def refuse(*arguments, **options):
        raise AssertionError("a session was made of a model that must be refused")

    monkeypatch.setattr(onnxruntime, "InferenceSession", refuse)


@pytest.mark.parametrize("kind", KINDS)
def test_a_bent_model_is_refused_before_a_session_is_made(kind, path, no_session):
    bend, rule = KINDS[kind]
    model = whole()
    bend(model)
    path.write_bytes(model.SerializeToString())
    with pytest.raises(stillray.InputError) as refused:
        stillray.Denoiser(path)
    assert rule in str(refused.value)
    assert str(refused.value).startswith(str(path))


def test_metadata_that_are_not_text_are_refused(path, no_session):
    path.write_bytes(whole().SerializeToString().replace(b'"summary"', b'"\xff\xfemmary"'))
    with pytest.raises(stillray.InputError, match="metadata's value is not UTF-8"):
        stillray.Denoiser(path)


def test_a_graph_that_stands_twice_is_refused(path, no_session):
    # protobuf merges the two; a reader that looks at one would check half of what is run
    one = whole().SerializeToString()
    path.write_bytes(one + one)
    with pytest.raises(stillray.InputError, match="holds ir_version twice"):
        stillray.Denoiser(path)


def test_a_file_without_end_is_not_read_to_its_end(path, no_session):
    with path.open("wb") as file:
        file.truncate(8 * 2**30)  # takes no space
    with pytest.raises(stillray.InputError, match="has more than 104857600 bytes"):
        stillray.Denoiser(path)


def test_a_file_of_countless_small_fields_is_given_up(path, no_session):
    path.write_bytes(b"\x42\x00" * 10**6)
    with pytest.raises(stillray.InputError, match="holds more than 200000 values"):
        stillray.Denoiser(path)


def test_every_cut_of_a_model_is_refused_in_a_line(path, no_session):
    data = whole("nbg-2x1").SerializeToString()
    for size in np.linspace(0, len(data) - 1, 60).astype(int):
        path.write_bytes(data[:size])
        with pytest.raises(stillray.InputError) as refused:
            stillray.Denoiser(path)
        assert "\n" not in str(refused.value)


def test_the_command_line_shows_no_control_characters_of_a_model(path, capsys):
    model = whole()
    in_spec("model\x1b[31m", value=1)(model)
    path.write_bytes(model.SerializeToString())
    assert main(["info", str(ROOT / "tests/data/room/frame_0001.exr"), "-m", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "\x1b" not in error
    assert r"model\x1b[31m" in error


def test_a_network_that_fails_as_it_runs_is_one_line(monkeypatch):
    class Failing:
        def __init__(self, *arguments, **options):
            pass

        def get_providers(self):
            return ["CPUExecutionProvider"]

        def get_outputs(self):
            return []

        def run(self, *arguments):
            raise RuntimeError("no memory\nat all")

    monkeypatch.setattr(onnxruntime, "InferenceSession", Failing)
    with (
        stillray.Denoiser("fast") as denoiser,
        pytest.raises(
            stillray.InputError, match=r"kpyr-5s(\.int8)?\.onnx: cannot be run: no memory$"
        ),
    ):
        denoiser.denoise(stillray.Frame(color=np.ones((8, 8, 3), np.float32)))


def test_a_graph_for_other_engines_says_where_the_model_is():
    with pytest.raises(stillray.InputError, match=r"the model is kpyr-5s\.onnx$"):
        stillray.Denoiser(MODELS / "kpyr-5s.whole.onnx")


def test_models_bent_at_random_never_crash(tmp_path):
    done = subprocess.run(
        [
            sys.executable, "-m", "tests.model_spec.bent_models", str(FUZZ_SEED), str(FUZZ_COUNT),
            str(tmp_path),
        ],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": "runtime:training:export", "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    lines = done.stdout.splitlines()
    assert done.returncode == 0, f"case {lines[-1:]} of seed {FUZZ_SEED}: {done.stderr[-2000:]}"
    ran = int(lines[-1].split()[0])
    # some faults do no harm; most must be found
    assert 0 < ran < FUZZ_COUNT / 2, lines[-1]

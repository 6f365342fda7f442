"""In what numbers a network computes: chosen by what there is, and the picture stays the same."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import stillray
from stillray.compare.display import display_exposure, tone_map
from stillray.errors import InputError
from stillray.frame import Frame
from stillray.io.exr.read import read_exr
from stillray.models import precision
from stillray.models.registry import find_model, list_models
from stillray.models.session import read_checked

ROOM = Path(__file__).parents[1] / "data" / "room"
WITH_INTEGERS = [
    "kpyr-5", "kpyr-5s", "kpyr-5-still", "kpyr-5s-still", "kpyr-5-color", "kpyr-5s-color",
    "munet-x1", "munet-x2",
]  # fmt: skip


@pytest.mark.parametrize("model", WITH_INTEGERS)
def test_a_network_of_integers_takes_and_gives_what_that_of_floats_does(model):
    path = find_model(model).path
    _, floats = read_checked(path)
    for file in (precision.int8_path(path), precision.pairs_path(path)):
        if not file.is_file():
            continue
        _, integers = read_checked(file)
        assert integers.features == floats.features
        sizes = [
            [(planes.count, planes.reduction) for planes in found.outputs]
            for found in (integers, floats)
        ]
        assert sizes[0] == sizes[1]
        if model.startswith("kpyr"):
            assert all(planes.steps is not None for planes in integers.outputs)
    assert precision.int8_path(path).stat().st_size < 0.4 * path.stat().st_size


@pytest.mark.parametrize("model", WITH_INTEGERS)
def test_the_picture_is_the_same_to_the_eye(model):
    frames = [read_exr(path) for path in sorted(ROOM.glob("frame_*.exr"))[:4]]
    pictures = {}
    for numbers in ("float32", "int8"):
        with stillray.Denoiser(model, precision=numbers) as denoiser:
            assert denoiser.precision == numbers
            pictures[numbers] = [denoiser.denoise(frame) for frame in frames][-1]
    exposure = display_exposure(pictures["float32"])
    error = tone_map(pictures["int8"], exposure) - tone_map(pictures["float32"], exposure)
    assert 0 < np.square(error).mean() < 10**-4.2  # 42 dB, where a denoised frame has 30
    assert abs(error.mean()) < 1e-3


def test_integers_are_chosen_where_a_processor_multiplies_them(monkeypatch):
    path = find_model("high").path
    integers = precision.int8_path(path)
    for multiplies, expected in ((True, integers), (False, path)):
        monkeypatch.setattr(precision, "multiplies_int8", lambda found=multiplies: found)
        assert precision.chosen(path, "auto", None) == expected
        assert precision.chosen(path, "auto", ("CPUExecutionProvider",)) == expected
        assert precision.chosen(path, "auto", ("CUDAExecutionProvider",)) == path
        assert precision.chosen(path, "float32", None) == path
        assert precision.chosen(path, "int8", None) == integers


def test_pairs_of_pixels_run_where_they_are_quicker_and_of_the_same_file(monkeypatch, tmp_path):
    for name in ("kpyr-5", "kpyr-5s"):
        path = find_model(name).path
        for file in (path, precision.int8_path(path), precision.pairs_path(path)):
            if file.is_file():
                shutil.copy(file, tmp_path)
    integers, pairs = (
        precision.int8_path(path := tmp_path / "kpyr-5.onnx"),
        precision.pairs_path(path),
    )
    for quicker, expected in ((True, pairs), (False, integers)):
        monkeypatch.setattr(precision, "pairs_are_quicker", lambda found=quicker: found)
        assert precision.chosen(path, "int8", None) == integers
        assert precision.quickest(integers) == expected
        assert precision.quickest(path) == path
    monkeypatch.setattr(precision, "pairs_are_quicker", lambda: True)
    small = precision.int8_path(tmp_path / "kpyr-5s.onnx")
    assert precision.quickest(small) == small  # it has none
    integers.write_bytes(integers.read_bytes() + b"\x32\x01x")  # another doc string
    assert precision.quickest(integers) == integers


def test_pairs_of_pixels_give_the_same_picture(monkeypatch):
    frames = [read_exr(path) for path in sorted(ROOM.glob("frame_*.exr"))[:2]]
    pictures = []
    for quicker in (False, True):
        monkeypatch.setattr(precision, "pairs_are_quicker", lambda found=quicker: found)
        with stillray.Denoiser("kpyr-5", precision="int8") as denoiser:
            pictures.append([denoiser.denoise(frame) for frame in frames][-1])
    np.testing.assert_array_equal(*pictures)


def test_a_model_without_integers_runs_in_floats_unless_they_are_asked_for():
    path = find_model("wskp-3s").path
    assert precision.chosen(path, "auto", None) == path
    with pytest.raises(InputError, match=r"float32 of wskp-3s, which has no wskp-3s\.int8\.onnx"):
        stillray.Denoiser("wskp-3s", precision="int8")


def test_a_precision_that_is_none_is_refused():
    with pytest.raises(InputError, match="must be one of auto, float32, int8, got half"):
        stillray.Denoiser("kpyr-5", precision="half")


def test_integers_of_another_file_are_refused(tmp_path):
    model = find_model("kpyr-5").path
    shutil.copy(find_model("kpyr-5s").path, tmp_path / "mine.onnx")
    shutil.copy(precision.int8_path(model), tmp_path / "mine.int8.onnx")
    with pytest.raises(InputError, match=r"mine\.int8\.onnx: must be made of the file mine\.onnx"):
        stillray.Denoiser(tmp_path / "mine.onnx", precision="int8")
    shutil.copy(model, tmp_path / "mine.onnx")
    with stillray.Denoiser(tmp_path / "mine.onnx", precision="int8", threads=1) as denoiser:
        clean = denoiser.denoise(Frame(color=np.full((9, 14, 3), 0.5)))
    np.testing.assert_allclose(clean, 0.5, rtol=1e-4)


def test_a_network_of_integers_is_no_model():
    path = precision.int8_path(find_model("kpyr-5").path)
    with pytest.raises(InputError, match=r"is the network of kpyr-5\.onnx in integers"):
        find_model(path)
    assert all(".int8" not in model.name for model in list_models())

"""The second half of a frame's samples: a layer of the same file, or another rendering."""

import numpy as np
import pytest

from stillray.cli import main
from stillray.errors import InputError
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.read import read_exr
from tests.conftest import make_frame


def layers(image, prefix=""):
    return {f"{prefix}{name}": image[..., i] for i, name in enumerate("RGB")}


@pytest.fixture
def halves():
    return [make_frame(8, 10, seed=seed).color for seed in (1, 2)]


def test_a_layer_of_the_same_file(tmp_path, halves):
    write_channels(tmp_path / "a.exr", layers(halves[0]) | layers(halves[1], "color_b."))
    frame = read_exr(tmp_path / "a.exr")
    np.testing.assert_allclose(frame.color, halves[0], rtol=1e-3)
    np.testing.assert_allclose(frame.color_b, halves[1], rtol=1e-3)


@pytest.mark.parametrize("prefix", ["", "ViewLayer.Combined.", "color_b."])
def test_another_rendering_gives_its_color(tmp_path, halves, prefix):
    write_channels(tmp_path / "a.exr", layers(halves[0]))
    write_channels(tmp_path / "b.exr", layers(halves[1], prefix))
    frame = read_exr(tmp_path / "a.exr", companions={"color_b": tmp_path / "b.exr"})
    np.testing.assert_allclose(frame.color, halves[0], rtol=1e-3)
    np.testing.assert_allclose(frame.color_b, halves[1], rtol=1e-3)


def test_a_layer_that_is_named(tmp_path, halves):
    write_channels(tmp_path / "a.exr", layers(halves[0]) | layers(halves[1], "seed2."))
    frame = read_exr(tmp_path / "a.exr", layers={"color_b": "seed2"})
    np.testing.assert_allclose(frame.color_b, halves[1], rtol=1e-3)


def test_another_rendering_of_another_size_is_refused(tmp_path, halves):
    write_channels(tmp_path / "a.exr", layers(halves[0]))
    write_channels(tmp_path / "b.exr", layers(halves[1][:4]))
    with pytest.raises(InputError, match=r"b\.exr"):
        read_exr(tmp_path / "a.exr", companions={"color_b": tmp_path / "b.exr"})


def test_the_command_takes_files_of_the_second_half(tmp_path, halves, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, half in zip("ab", halves, strict=True):
        write_channels(tmp_path / f"{name}.0001.exr", layers(half))
    arguments = ["denoise", "a.####.exr", "--color-b", "b.####.exr", "-o", "c.####.exr"]
    assert main([*arguments, "-m", "fast", "--quiet"]) == 0
    assert (tmp_path / "c.0001.exr").is_file()
    assert main([*arguments[:2], "--color-b", "none.####.exr", *arguments[4:]]) != 0

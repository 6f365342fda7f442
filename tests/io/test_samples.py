"""What files say of their samples a pixel reaches the frame, and nothing is guessed."""

import json
from pathlib import Path

import numpy as np
import pytest

from stillray.batch.file_layout import Layout, Told
from stillray.cli import main
from stillray.errors import InputError
from stillray.io.channels.roles import find_layers, parse_overrides
from stillray.io.exr.file import ExrFile
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.read import read_exr, read_metadata, read_picture
from stillray.io.exr.samples import find_samples
from stillray.io.exr.write import write_exr

BLENDER = Path(__file__).parents[1] / "data/blender/frame_0001.exr"
HEIGHT, WIDTH = 12, 17


def write(path, *names, attributes=None, **counts):
    """A file of noise; counts by channel are written as they are."""
    rng = np.random.default_rng(5)
    channels = {name: rng.random((HEIGHT, WIDTH), np.float32) for name in names or "RGB"}
    channels |= {name: np.broadcast_to(value, (HEIGHT, WIDTH)) for name, value in counts.items()}
    write_channels(path, channels, attributes=attributes, formats=dict.fromkeys(counts, "float"))
    return path


def source_of(path, chosen=None):
    file = ExrFile.open(path)
    return find_samples(file, find_layers(file.channels, chosen), chosen)


def view_layer(name):
    return [f"{name}.Combined.{part}" for part in "RGB"]


def test_blender_tells_its_samples_and_that_they_are_a_maximum(capsys):
    assert read_exr(BLENDER).samples == 4
    assert main(["info", str(BLENDER), "-m", "fast"]) == 0
    line = next(x for x in capsys.readouterr().out.splitlines() if x.startswith("samples: "))
    assert line.startswith("samples: 4 a pixel, from cycles.ViewLayer.samples (")
    assert "adaptive sampling" in line


def test_a_clean_file_in_the_structure_of_blender_s_still_says_it(tmp_path):
    write_exr(tmp_path / "c.exr", read_picture(BLENDER), like=BLENDER)
    assert read_exr(tmp_path / "c.exr").samples == 4


@pytest.mark.parametrize(("layer", "samples"), [("View", 16), ("View.001", 128)])
def test_blender_s_samples_are_those_of_the_color_s_view_layer(tmp_path, layer, samples):
    said = {"cycles.View.samples": "16", "cycles.View.001.samples": "128"}
    path = write(tmp_path / "f.exr", *view_layer(layer), attributes=said)
    assert read_exr(path).samples == samples
    assert source_of(path).name == f"cycles.{layer}.samples"


def test_a_composite_has_the_samples_of_all_view_layers_or_none(tmp_path):
    same = {"cycles.Back.samples": "8", "cycles.Front.samples": "8"}
    assert read_exr(write(tmp_path / "same.exr", attributes=same)).samples == 8
    differ = same | {"cycles.Front.samples": "32"}
    path = write(tmp_path / "differ.exr", attributes=differ)
    assert read_exr(path).samples is None
    assert "differ" in source_of(path).note


@pytest.mark.parametrize("name", ["sampleCount", "samples", "samples.Y"])
def test_a_channel_of_samples_is_a_map(tmp_path, name):
    counts = np.arange(HEIGHT * WIDTH, dtype=np.float32).reshape(HEIGHT, WIDTH)
    path = write(tmp_path / "f.exr", *"RGB", attributes={"stillray:samples": 5}, **{name: counts})
    np.testing.assert_array_equal(read_exr(path).samples, counts)


def test_info_shows_the_spread_of_a_map(tmp_path, capsys):
    counts = np.float32([4] * 12 + [16] * 5)
    path = write(tmp_path / "f.exr", *"RGB", sampleCount=counts)
    assert main(["info", str(path), "-m", "fast"]) == 0
    words = "samples: 4 to 16 a pixel, 7.529 in the mean, from sampleCount"
    assert words in capsys.readouterr().out
    assert main(["info", str(path), "-m", "fast", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["samples"]["least"], facts["samples"]["most"]) == (4, 16)
    assert facts["samples"]["from"] == "sampleCount"


@pytest.mark.parametrize("value", ["24", 24, 24.0])
def test_any_program_can_tell_by_an_attribute(tmp_path, value):
    said = {"stillray:samples": value, "cycles.View.samples": "7"}
    assert read_exr(write(tmp_path / "f.exr", attributes=said)).samples == 24


@pytest.mark.parametrize("value", ["many", "0", "-4", "nan", "inf"])
def test_an_attribute_that_is_no_count_is_reported_and_not_used(tmp_path, value, capsys):
    path = write(tmp_path / "f.exr", attributes={"cycles.View.samples": value})
    assert read_exr(path).samples is None
    assert main(["info", str(path), "-m", "fast"]) == 0
    out = capsys.readouterr().out
    assert f"samples: not known (cycles.View.samples must be a number above 0, got {value})" in out


def test_a_channel_that_is_no_count_is_an_error_that_says_how_to_leave_it_out(tmp_path):
    path = write(tmp_path / "f.exr", *"RGB", samples=-1)
    words = r"f\.exr: samples must be 0 to 1e\+09 .* got -1 at row 0, column 0; samples=none"
    with pytest.raises(InputError, match=words):
        read_exr(path)
    assert read_exr(path, layers={"samples": "none"}).samples is None
    assert read_exr(path, samples=3).samples == 3


def test_a_user_names_the_channel_or_leaves_all_of_it_out(tmp_path):
    path = write(tmp_path / "f.exr", *"RGB", "spp", attributes={"stillray:samples": 5})
    chosen = read_exr(path, layers=parse_overrides(["samples=spp"])).samples
    assert chosen.shape == (HEIGHT, WIDTH)
    assert read_exr(path, layers=parse_overrides(["samples=none"])).samples is None


def test_a_number_of_a_user_goes_before_what_the_file_says(tmp_path):
    assert read_exr(BLENDER, samples=256).samples == 256
    (view,) = Layout(told=Told(samples=256)).read(BLENDER, {}, None)
    assert view.frame.samples == 256
    output = tmp_path / "c.exr"
    assert main(["denoise", str(BLENDER), "-o", str(output), "-m", "fast", "--samples", "256"]) == 0
    options = json.loads(read_metadata(output).getattribute("stillray:options"))
    assert options["samples"] == 256


def test_a_number_that_is_no_count_is_one_line(tmp_path, capsys):
    assert main(["denoise", str(BLENDER), "-o", str(tmp_path / "c.exr"), "--samples", "0"]) == 2
    assert "samples must be a number above 0" in capsys.readouterr().err
    assert not (tmp_path / "c.exr").exists()


def test_resume_denoises_again_with_another_number(tmp_path, capsys):
    command = ["denoise", str(BLENDER), "-o", str(tmp_path / "c.exr"), "-m", "fast", "--resume"]
    assert main([*command, "--samples", "4"]) == 0
    assert main([*command, "--samples", "4"]) == 0
    assert "nothing to do" in capsys.readouterr().out
    assert main([*command, "--samples", "16"]) == 0
    assert "nothing to do" not in capsys.readouterr().out

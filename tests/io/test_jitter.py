"""Where samples lie in their pixels comes with the file."""

import json
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest

import stillray
from stillray.cli import main
from stillray.errors import InputError
from stillray.io.channels.roles import parse_overrides
from stillray.io.exr.jitter import JITTER_ATTRIBUTE, jitter_text
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.read import read_exr, read_metadata
from stillray.io.exr.write import write_exr
from tests.conftest import make_frame

MANUAL = Path(__file__).parents[2] / "docs" / "command-line.md"


def write(path, text):
    planes = {name: np.ones((3, 4), np.float32) for name in "RGB"}
    write_channels(path, planes, attributes=None if text is None else {JITTER_ATTRIBUTE: text})
    return path


def write_frame(path, text):
    """A file with the buffers that models which enlarge need."""
    frame = make_frame(16, 12)
    planes = {name: frame.color[..., i] for i, name in enumerate("RGB")}
    planes |= {f"motion.{name}": frame.motion[..., i] for i, name in enumerate("XY")}
    planes["depth.Z"] = frame.depth
    write_channels(path, planes, attributes={JITTER_ATTRIBUTE: text})


def test_what_is_written_is_read(tmp_path):
    path = write(tmp_path / "a.exr", jitter_text(np.array([-0.25, 1 / 3])))
    np.testing.assert_allclose(read_exr(path).jitter, [-0.25, 1 / 3], rtol=1e-6)
    assert read_exr(write(tmp_path / "b.exr", None)).jitter is None


def test_what_the_manual_writes_is_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "shot.0001.exr", None)
    section = MANUAL.read_text(encoding="utf-8").split("## Where samples lie in their pixels")[1]
    exec(section.split("```python")[1].split("```")[0], {})
    np.testing.assert_array_equal(read_exr("jittered.0001.exr").jitter, [-0.25, 0.125])


def test_a_vector_is_taken_and_its_range_is_looked_at_before_the_frame(tmp_path):
    two = oiio.TypeDesc(oiio.FLOAT, oiio.VEC2, oiio.VECTOR)
    for name, value in (("a.exr", (-0.25, 0.125)), ("b.exr", (-0.25, 1.5))):
        picture = oiio.ImageBuf(str(write(tmp_path / "plain.exr", None)))
        picture.specmod().attribute(JITTER_ATTRIBUTE, two, value)
        assert picture.write(str(tmp_path / name))
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr").jitter, [-0.25, 0.125])
    with pytest.raises(InputError, match=r"b\.exr: .* from -1 to 1, got '-0.25 1.5'"):
        read_exr(tmp_path / "b.exr")


@pytest.mark.parametrize("text", [" ", "0.1", "a b", "0 0 0", "0 1.5", "nan 0", "1e300 0"])
def test_what_is_no_jitter_is_refused(tmp_path, text):
    path = write(tmp_path / "a.exr", text)
    words = rf"a\.exr: {JITTER_ATTRIBUTE} must be two numbers from -1 to 1, got"
    with pytest.raises(InputError, match=words):
        read_exr(path)
    assert read_exr(path, layers={"jitter": "none"}).jitter is None


def test_jitter_is_no_layer(tmp_path):
    assert parse_overrides(["jitter=none"]) == {"jitter": "none"}
    with pytest.raises(InputError, match="layer jitter must be none"):
        parse_overrides(["jitter=motion"])


def test_only_models_that_look_at_jitter_mind_what_is_none(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_frame("bad.exr", "left")
    assert main(["denoise", "bad.exr", "-o", "fast.exr", "-m", "fast", "--quiet"]) == 0
    assert read_metadata("fast.exr").getattribute(JITTER_ATTRIBUTE) == "left"  # as it was
    doubling = ["denoise", "bad.exr", "-o", "x2.exr", "-m", "munet-x2", "--quiet"]
    assert main(doubling) == 2
    assert f"bad.exr: {JITTER_ATTRIBUTE} must be two numbers" in capsys.readouterr().err
    assert main([*doubling, "--layer", "jitter=none"]) == 0


def test_pictures_keep_the_jitter_unless_their_model_looks_at_it(tmp_path):
    write_frame(tmp_path / "a.exr", "0.25 -0.25")
    source, target = str(tmp_path / "a.exr"), tmp_path / "clean.exr"
    for only_color in (False, True):
        options = stillray.ShotOptions(only_color=only_color)
        stillray.denoise_shot(source, target, model="kpyr-5s", options=options)
        np.testing.assert_array_equal(read_exr(target).jitter, [0.25, -0.25])
        for model in ("munet-x1", "munet-x2"):
            stillray.denoise_shot(source, target, model=model, options=options)
            assert read_metadata(target).getattribute("stillray:model") == model
            assert read_metadata(target).getattribute(JITTER_ATTRIBUTE) is None


def test_an_enlarged_picture_has_not_the_jitter_of_its_source(tmp_path):
    source = write(tmp_path / "a.exr", "0.25 -0.25")
    write_exr(tmp_path / "b.exr", np.ones((6, 8, 3), np.float32), like=source)
    assert read_exr(tmp_path / "b.exr").jitter is None


def test_info_shows_the_jitter_and_whether_the_model_looks_at_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_frame("a.exr", "0.25 -0.125")
    write_frame("bad.exr", "left")

    def shown(name, model):
        assert main(["info", name, "-m", model, "--json"]) == 0
        return json.loads(capsys.readouterr().out)["jitter"]

    assert shown("a.exr", "munet-x2") == {"x": 0.25, "y": -0.125, "note": "", "told": True}
    assert not shown("a.exr", "kpyr-5s")["told"]
    assert shown("bad.exr", "kpyr-5s")["x"] is None
    assert "must be two numbers" in shown("bad.exr", "kpyr-5s")["note"]
    assert main(["info", "bad.exr", "-m", "munet-x2"]) == 2
    capsys.readouterr()
    assert main(["info", "a.exr", "-m", "munet-x2"]) == 0
    assert "jitter: samples lie (0.25, -0.125) pixels from" in capsys.readouterr().out

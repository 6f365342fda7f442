"""PFM files go through `stillray denoise` and `stillray info` as EXR files do."""

from __future__ import annotations

import json

import numpy as np
import pytest

import stillray
from stillray.cli import main
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.read import read_exr
from stillray.io.pfm import read_pfm, write_pfm
from tests.conftest import make_frame

FAST = ("-m", "kpyr-5s", "--threads", "1", "--quiet")


@pytest.fixture
def frame(tmp_path, monkeypatch):
    """A frame whose buffers are files in the current folder."""
    monkeypatch.chdir(tmp_path)
    frame = make_frame(33, 42, shift=1.0)
    write_pfm("color.pfm", frame.color)
    write_pfm("albedo.pfm", frame.albedo)
    write_pfm("normal.pfm", frame.normal)
    write_pfm("depth.pfm", frame.depth[..., None])
    write_pfm("motion.pfm", np.dstack([frame.motion, np.zeros((33, 42))]))
    return frame


def denoised(*frames):
    with stillray.Denoiser("kpyr-5s", threads=1) as denoiser:
        return [denoiser.denoise(frame) for frame in frames][-1]


def test_float_maps_are_denoised_with_all_their_buffers(frame):
    features = [f"--{role}={role}.pfm" for role in ("albedo", "normal", "depth", "motion")]
    assert main(["denoise", "color.pfm", *features, "-o", "clean.pfm", *FAST]) == 0
    np.testing.assert_array_equal(read_pfm("clean.pfm"), denoised(frame))


def test_a_sequence_of_float_maps_has_a_history_where_motion_is_given(frame):
    frames = [make_frame(33, 42, number) for number in (1, 2, 3)]
    for number, each in enumerate(frames):
        write_pfm(f"c.{number}.pfm", each.color)
        write_pfm(f"m.{number}.pfm", np.dstack([each.motion, each.motion[..., 0]]))
        write_pfm(f"a.{number}.pfm", each.albedo)
    command = ["denoise", "c.#.pfm", "--albedo", "a.#.pfm", "--motion", "m.#.pfm"]
    assert main([*command, "-o", "clean/", *FAST]) == 0
    alike = [
        stillray.Frame(color=f.color, albedo=f.albedo, motion=f.motion) for f in frames
    ]  # fmt: skip
    np.testing.assert_array_equal(read_pfm("clean/c.2.pfm"), denoised(*alike))


def test_float_maps_and_exr_files_go_together(frame):
    planes = {name: frame.color[..., i] for i, name in enumerate("RGB")}
    write_channels("color.exr", planes, formats=dict.fromkeys("RGB", "float"))
    bare = stillray.Frame(color=frame.color, albedo=frame.albedo)
    assert main(["denoise", "color.exr", "--albedo", "albedo.pfm", "-o", "a.pfm", *FAST]) == 0
    np.testing.assert_array_equal(read_pfm("a.pfm"), denoised(bare))
    assert main(["denoise", "color.pfm", "--albedo", "albedo.pfm", "-o", "b.exr", *FAST]) == 0
    np.testing.assert_array_equal(read_exr("b.exr").color, denoised(bare))


def test_grey_is_denoised_as_color(frame):
    write_pfm("grey.pfm", frame.color[..., :1])
    assert main(["denoise", "grey.pfm", "-o", "g.pfm", *FAST]) == 0
    clean = read_pfm("g.pfm")
    np.testing.assert_array_equal(
        clean, denoised(stillray.Frame(color=np.repeat(frame.color[..., :1], 3, 2)))
    )


def test_info_tells_of_a_float_map(frame, capsys):
    assert main(["info", "color.pfm", "-m", "fast", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["width"], facts["height"], facts["channels"]) == (42, 33, ["R", "G", "B"])
    assert main(["info", "depth.pfm", "-m", "fast"]) == 0
    assert "color  Y         float map" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["none.pfm", "-o", "c.pfm"], "none.pfm: no such file"),
        (["color.pfm", "--depth", "small.pfm", "-o", "c.pfm"], "depth must have the size (33, 42)"),
        (["color.pfm", "-o", "c.pfm", "--resume"], "resume must have .exr outputs"),
        (["color.pfm", "-o", "color.pfm"], "output must not overwrite an input"),
        (["color.pfm", "-o", "c.png"], "output must be a .pfm, .phm, .exr file"),
        (["torn.pfm", "-o", "c.exr"], "torn.pfm: 42 x 33 pixels must take 16632 bytes"),
    ],
)
def test_what_cannot_be_done_is_one_line(frame, tmp_path, capsys, arguments, message):
    write_pfm("small.pfm", frame.depth[:9, :9, None])
    (tmp_path / "torn.pfm").write_bytes((tmp_path / "color.pfm").read_bytes()[:-100])
    assert main(["denoise", *arguments, *FAST]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not list(tmp_path.glob("c.*"))

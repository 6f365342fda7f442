"""A shot from Python is the shot of the command line."""

from __future__ import annotations

import json

import numpy as np
import pytest

import stillray
from stillray.cli import main
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.read import read_exr
from tests.conftest import make_frame

FRAMES = 6
FAST = stillray.ShotOptions(threads=1)


@pytest.fixture
def shot(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for number in range(1, FRAMES + 1):
        frame = make_frame(24, 33, number, shift=1.0)
        write(tmp_path / f"shot.{number:02d}.exr", frame)
    return tmp_path


def write(path, frame, *, albedo=True, motion=True):
    channels = {name: frame.color[..., i] for i, name in enumerate("RGB")}
    if albedo:
        channels |= {f"albedo.{name}": frame.albedo[..., i] for i, name in enumerate("RGB")}
    if motion:
        channels |= {"motion.X": frame.motion[..., 0], "motion.Y": frame.motion[..., 1]}
    write_channels(path, channels)


def pictures(pattern):
    return [read_exr(pattern.format(number)).color for number in range(1, FRAMES + 1)]


def test_python_writes_what_the_command_line_writes(shot):
    told = []
    result = stillray.denoise_shot(
        "shot.##.exr", "a.##.exr", model="fast", options=FAST, progress=told.append
    )
    assert main(["denoise", "shot.##.exr", "-o", "b.##.exr", "-m", "fast", "--threads", "1"]) == 0
    np.testing.assert_array_equal(pictures("a.{:02d}.exr"), pictures("b.{:02d}.exr"))
    assert [done.step.job.number for done in told] == list(range(1, FRAMES + 1))
    assert result.frames == tuple(told)
    assert (result.model, result.already, result.cancelled) == ("kpyr-5s", 0, False)


def test_a_cancelled_run_ends_soon_and_is_resumed(shot):
    told = []
    options = stillray.ShotOptions(threads=1, resume=True)
    result = stillray.denoise_shot(
        "shot.##.exr", "c.##.exr", model="fast", options=options,
        progress=told.append, cancel=lambda: len(told) > 0,
    )  # fmt: skip
    assert result.cancelled
    # what was read ahead or waits to be written when the first was done
    assert 1 <= len(result.frames) < FRAMES
    again = stillray.denoise_shot("shot.##.exr", "c.##.exr", model="fast", options=options)
    assert again.already == len(result.frames)
    assert not again.cancelled
    assert (
        stillray.denoise_shot("shot.##.exr", "c.##.exr", model="fast", options=options).frames == ()
    )


def test_a_run_cancelled_at_once_opens_no_model_and_writes_nothing(shot):
    result = stillray.denoise_shot("shot.##.exr", "d.##.exr", model="fast", cancel=lambda: True)
    assert result.cancelled
    assert result.frames == ()
    assert not list(shot.glob("d.*"))


def test_the_default_model_is_one_and_the_same(shot):
    result = stillray.denoise_shot("shot.##.exr", "e.##.exr")
    assert result.model == stillray.Denoiser().model.name == "kpyr-5"
    assert main(["info", "shot.01.exr", "--json"]) == 0


def test_one_file_alone_is_denoised_as_one_image_is(shot):
    frame = read_exr(shot / "shot.01.exr")
    image = stillray.denoise(frame.color, frame.albedo)
    given = {"alone": {}, "one of many": {"frames": "1"}, "each alone": {"temporal": False}}
    for how, options in given.items():
        source = "shot.01.exr" if how == "alone" else "shot.##.exr"
        output = "f.exr" if how == "alone" else "f.##.exr"
        ran = stillray.denoise_shot(source, output, options=stillray.ShotOptions(**options))
        assert ran.model == "kpyr-5-still"
        found = read_exr(shot / output.replace("##", "01")).color
        np.testing.assert_allclose(found, image, rtol=1e-3)  # half floats
    # with frames before it, it has a past
    options = stillray.ShotOptions(frames="2", warm_up=1)
    assert stillray.denoise_shot("shot.##.exr", "g.##.exr", options=options).model == "kpyr-5"


def without(shot, *layers):
    """The shot's files once more, without some of their layers: as bare.01.exr and on."""
    for number in range(1, FRAMES + 1):
        frame = read_exr(shot / f"shot.{number:02d}.exr")
        write(shot / f"bare.{number:02d}.exr", frame, **dict.fromkeys(layers, False))


@pytest.mark.parametrize(
    ("layers", "model"),
    [
        (("motion",), "kpyr-5-still"),
        (("motion", "albedo"), "kpyr-5-color"),
        (("albedo",), "kpyr-5"),
    ],
)
def test_frames_without_motion_are_stills_whatever_else_they_lack(shot, layers, model, capsys):
    without(shot, *layers)
    ran = stillray.denoise_shot("bare.##.exr", "k.##.exr", options=FAST)
    assert ran.model == model
    for number in range(1, FRAMES + 1):
        frame = read_exr(shot / f"bare.{number:02d}.exr")
        image = stillray.denoise(frame.color, frame.albedo)
        if model != "kpyr-5":
            found = read_exr(shot / f"k.{number:02d}.exr").color
            np.testing.assert_allclose(found, image, rtol=1e-3)  # half floats
    # as info says beforehand
    capsys.readouterr()
    assert main(["info", "bare.##.exr", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["model"] == model


def test_an_albedo_of_its_own_file_is_a_guide(shot):
    without(shot, "motion", "albedo")
    options = stillray.ShotOptions(threads=1, companions={"albedo": "shot.##.exr"})
    assert stillray.denoise_shot("bare.##.exr", "l.##.exr", options=options).model == "kpyr-5-still"
    left_out = stillray.ShotOptions(threads=1, layers={"albedo": "none", "motion": "none"})
    ran = stillray.denoise_shot("shot.##.exr", "m.##.exr", options=left_out)
    assert ran.model == "kpyr-5-color"


def test_a_still_that_is_changed_makes_none_beside_it_anew(shot):
    without(shot, "motion")
    options = stillray.ShotOptions(threads=1, resume=True)
    stillray.denoise_shot("bare.##.exr", "n.##.exr", options=options)
    write(shot / "bare.02.exr", make_frame(24, 33, 99), motion=False)
    again = stillray.denoise_shot("bare.##.exr", "n.##.exr", options=options)
    assert [done.step.job.number for done in again.frames if done.step.writes] == [2]


def test_files_and_models_may_be_named_by_paths(shot):
    model, files = stillray.list_models()[0].path, sorted(shot.glob("shot.*.exr"))
    for sources in (files[0], shot / "shot.##.exr", files):
        count = 1 if sources is files[0] else FRAMES
        output = shot / ("h.exr" if count == 1 else "h.##.exr")
        result = stillray.denoise_shot(sources, output, model=model, options=FAST)
        assert len(result.frames) == count
    texts = [str(path) for path in files]
    stillray.denoise_shot(texts, "i.##.exr", model=str(model), options=FAST)
    np.testing.assert_array_equal(pictures("h.{:02d}.exr"), pictures("i.{:02d}.exr"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"workers": 0}, "workers must be 1 or more, got 0"),
        ({"workers": 2, "scheduler": "tcp://a:1"}, "workers must not be given with a scheduler"),
        ({"chunk": 3}, "chunk must be given with --scheduler or --workers, got 3 alone"),
    ],
)
def test_options_that_contradict_each_other_are_refused(options, message):
    with pytest.raises(stillray.InputError, match=message):
        stillray.ShotOptions(**options)


def test_options_must_be_options(tmp_path):
    words = r"options must be a stillray\.ShotOptions, got \{'samples': 1"
    with pytest.raises(stillray.InputError, match=words):
        stillray.denoise_shot("a.exr", str(tmp_path / "b.exr"), options={"samples": 1})

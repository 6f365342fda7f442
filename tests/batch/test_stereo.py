"""Both eyes of a stereo sequence in one run: as two runs of one eye each, bit by bit."""

from __future__ import annotations

import dataclasses

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest

import stillray
from stillray.cli import main
from stillray.errors import InputError
from stillray.io.exr.read import read_exr, read_picture
from stillray.io.exr.write import CleanView, write_views
from tests.conftest import make_frame

HEIGHT, WIDTH, FRAMES = 33, 42, 4
EYES = ("left", "right")
FAST = ("-m", "fast", "--threads", "1", "--quiet")


def planes_of(frame):
    planes = {name: frame.color[..., i] for i, name in enumerate("RGB")}
    planes |= {f"albedo.{name}": frame.albedo[..., i] for i, name in enumerate("RGB")}
    planes |= {f"normal.{name}": frame.normal[..., i] for i, name in enumerate("XYZ")}
    planes |= {"motion.X": frame.motion[..., 0], "motion.Y": frame.motion[..., 1]}
    return planes


def write_eyes(path, frames, *, attribute=False):
    """A part an eye, as `rgba_left`; or the eye in an attribute of its part."""
    specs = []
    for eye, frame in frames.items():
        planes = planes_of(frame)
        spec = oiio.ImageSpec(WIDTH, HEIGHT, len(planes), "float")
        spec.channelnames = tuple(planes)
        spec.attribute("name", f"rgba_{eye}")
        if attribute:
            spec.attribute("view", eye)
        specs.append((spec, np.stack(list(planes.values()), -1).astype(np.float32)))
    sink = oiio.ImageOutput.create("exr")
    assert sink.open(str(path), [spec for spec, _ in specs])
    for number, (spec, pixels) in enumerate(specs):
        if number:
            assert sink.open(str(path), spec, "AppendSubimage")
        assert sink.write_image(pixels)
    assert sink.close()


@pytest.fixture(scope="module")
def frames():
    """The eyes see the box at other places, in other light, and under other noise."""
    shots = {}
    for number in range(1, FRAMES + 1):
        left, right = (make_frame(HEIGHT, WIDTH, 10 * number + e, shift=2.0 * e) for e in (0, 1))
        shots[number] = {"left": left, "right": dataclasses.replace(right, color=3 * right.color)}
    return shots


@pytest.fixture
def stereo(tmp_path, monkeypatch, frames):
    monkeypatch.chdir(tmp_path)
    for number, eyes in frames.items():
        write_eyes(tmp_path / f"s.{number}.exr", eyes)
    return tmp_path


def eye(name, number, view):
    return read_picture(name.format(number), layers={"view": view})


def test_each_eye_has_its_own_history(stereo, frames):
    assert main(["denoise", "s.#.exr", "-o", "both.#.exr", *FAST]) == 0
    for view in EYES:
        with stillray.Denoiser("fast", threads=1) as denoiser:
            for number in frames:
                alone = denoiser.denoise(read_exr(f"s.{number}.exr", layers={"view": view}))
                np.testing.assert_array_equal(eye("both.{}.exr", number, view), alone)


def test_all_else_of_both_eyes_stays(stereo, frames):
    assert main(["denoise", "s.#.exr", "-o", "both.#.exr", *FAST]) == 0
    for view in EYES:
        clean = read_exr("both.4.exr", layers={"view": view})
        np.testing.assert_array_equal(clean.albedo, frames[4][view].albedo)


def test_a_chosen_eye_is_the_only_one_to_change(stereo, frames):
    assert main(["denoise", "s.#.exr", "-o", "left.#.exr", "--view", "left", *FAST]) == 0
    np.testing.assert_array_equal(eye("left.{}.exr", 4, "right"), frames[4]["right"].color)
    assert main(["denoise", "s.#.exr", "-o", "both.#.exr", *FAST]) == 0
    np.testing.assert_array_equal(eye("left.{}.exr", 4, "left"), eye("both.{}.exr", 4, "left"))


@pytest.mark.parametrize("attribute", [False, True])
def test_both_eyes_are_enlarged(stereo, frames, attribute, capsys):
    for number in (1, 2):
        write_eyes(stereo / f"t.{number}.exr", frames[number], attribute=attribute)
    command = ["denoise", "t.#.exr", "-o", "both.#.exr", "-m", "munet-x2", "--threads", "1"]
    assert main([*command, "--quiet"]) == 0
    for view in EYES:
        with stillray.Denoiser("munet-x2", threads=1) as denoiser:
            for number in (1, 2):
                alone = denoiser.denoise(read_exr(f"t.{number}.exr", layers={"view": view}))
                assert alone.shape == (2 * HEIGHT, 2 * WIDTH, 3)
                found = eye("both.{}.exr", number, view)
                np.testing.assert_array_equal(found, alone)  # in floats, as the source is
    assert main([*command, "--resume"]) == 0
    assert "2 frames done already" in capsys.readouterr().out
    for wide in (WIDTH, 2 * WIDTH + 1):  # of another size than the other eye's, or no multiple
        views = [
            CleanView(layers={"view": view}, image=np.ones((2 * HEIGHT, columns, 3)))
            for view, columns in zip(EYES, (2 * WIDTH, wide), strict=True)
        ]
        with pytest.raises(InputError, match="must have the size of its color"):
            write_views("other.exr", views, like="t.1.exr")


def test_both_eyes_are_resumed(stereo, capsys):
    command = ["denoise", "s.#.exr", "-o", "both.#.exr", "-m", "fast", "--resume"]
    assert main([*command, "--frames", "1-2"]) == 0
    capsys.readouterr()
    assert main(command) == 0
    assert capsys.readouterr().out.splitlines()[-1].endswith("2 done already")
    # a frame of which one eye is another picture is not done
    clean = read_exr("both.3.exr", layers={"view": "left"}).color
    stillray.write_exr("bent.exr", clean + 1, like="both.3.exr", layers={"view": "left"})
    (stereo / "bent.exr").replace(stereo / "both.3.exr")
    assert main(command) == 0
    assert capsys.readouterr().out.splitlines()[-1].endswith("3 done already")


def test_what_holds_one_picture_needs_a_view(stereo, capsys):
    assert main(["denoise", "s.#.exr", "-o", "c.#.pfm", *FAST]) == 2
    assert "--view must choose one" in capsys.readouterr().err
    with pytest.raises(InputError, match="only-color must be given with --view"):
        stillray.denoise_shot(
            "s.#.exr", "c.#.exr", options=stillray.ShotOptions(only_color=True)
        )  # fmt: skip
    assert main(["denoise", "s.#.exr", "-o", "c.#.pfm", "--view", "left", *FAST]) == 0
    assert sorted(path.name for path in stereo.glob("c.*")) == [f"c.{i}.pfm" for i in range(1, 5)]


def test_a_frame_without_an_eye_ends_the_run_in_a_line(stereo, frames):
    write_eyes(stereo / "s.3.exr", {"left": frames[3]["left"]})
    with pytest.raises(InputError, match=r"s\.3\.exr: must have the view right, but"):
        stillray.denoise_shot("s.#.exr", "both.#.exr", model="fast")
    assert {path.name for path in stereo.glob("both.*")} <= {"both.1.exr", "both.2.exr"}

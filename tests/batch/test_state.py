"""What a model has learned goes from run to run in a file."""

import numpy as np
import pytest

from stillray.cli import main
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.read import read_picture
from tests.conftest import make_frame


@pytest.fixture
def shot(tmp_path, monkeypatch):
    """Four frames of two halves, in the current folder."""
    monkeypatch.chdir(tmp_path)
    for number in range(1, 5):
        channels = {}
        for prefix, seed in (("", number), ("color_b.", number + 50)):
            image = make_frame(16, 12, seed).color
            channels |= {f"{prefix}{name}": image[..., i] for i, name in enumerate("RGB")}
        write_channels(tmp_path / f"shot.{number}.exr", channels)
    return tmp_path


def run(*options, output="clean.#.exr"):
    return main(["denoise", "shot.#.exr", "-o", output, "-m", "online", "--quiet", *options])


def test_a_second_run_goes_on_with_what_the_first_has_learned(shot):
    assert run("--frames", "1-2", "--state", "past.npz") == 0
    assert np.load("past.npz")["steps"].tolist() == [2, 2]
    assert run("--frames", "3-4", "--state", "past.npz") == 0
    assert np.load("past.npz")["steps"].tolist() == [4, 4]
    assert run("--frames", "3-4", output="other.#.exr") == 0
    taught, untaught = (read_picture(f"{name}.4.exr") for name in ("clean", "other"))
    assert np.abs(taught - untaught).max() > 0


def test_a_state_of_another_model_is_refused_in_a_line(shot, capsys):
    assert run("--frames", "1", "--state", "past.npz") == 0
    kept = (shot / "past.npz").read_bytes()
    assert run("-m", "online-warm", "--frames", "2", "--state", "past.npz") == 2
    assert "state must be one of online-warm, got one of online" in capsys.readouterr().err
    assert not (shot / "clean.2.exr").exists()
    assert (shot / "past.npz").read_bytes() == kept


def test_a_killed_run_that_is_resumed_gives_the_same_pictures(shot):
    assert run() == 0
    whole = read_picture("clean.4.exr")
    (shot / "clean.4.exr").unlink()
    assert run("--resume") == 0
    np.testing.assert_array_equal(read_picture("clean.4.exr"), whole)


@pytest.mark.parametrize(
    "options",
    [("--resume",), ("--workers", "2"), ("-m", "fast"), ("--state", "nowhere/past.npz")],
    ids=["resume", "workers", "model", "folder"],
)
def test_a_state_that_cannot_be_kept_is_refused_before_anything_runs(shot, capsys, options):
    assert run("--state", "past.npz", *options) != 0
    assert "must" in capsys.readouterr().err
    assert not list(shot.glob("clean*"))

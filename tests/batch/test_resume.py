"""Runs that were cut short, in parts, or whose inputs changed: the same shot in the end."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import onnx
import pytest

from stillray.cli import main
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.read import read_exr
from stillray.models.precision import int8_path
from stillray.models.registry import find_model
from tests.conftest import make_frame

HEIGHT, WIDTH, FRAMES = 49, 66, 10
COMMAND = ("denoise", "shot.##.exr", "-o", "clean.##.exr", "-m", "fast")
# "balanced" also remembers its own last output
RECALLING = (*COMMAND[:-1], "balanced")
#: Runs that are killed: 50 with STILLRAY_KILLS=50, a few otherwise.
KILLS = int(os.environ.get("STILLRAY_KILLS", "3"))


def write_frame(path, number, *, seed=None):
    frame = make_frame(HEIGHT, WIDTH, seed=number if seed is None else seed, shift=0.3)
    channels = {name: frame.color[..., i] for i, name in enumerate("RGB")}
    channels |= {f"albedo.{name}": frame.albedo[..., i] for i, name in enumerate("RGB")}
    channels |= {f"normal.{name}": frame.normal[..., i] for i, name in enumerate("XYZ")}
    channels |= {f"motion.{name}": frame.motion[..., i] for i, name in enumerate("XY")}
    write_channels(path, channels | {"depth.Z": frame.depth})


@pytest.fixture
def shot(tmp_path, monkeypatch):
    """A sequence without gaps, in the current folder."""
    monkeypatch.chdir(tmp_path)
    for number in range(1, FRAMES + 1):
        write_frame(tmp_path / f"shot.{number:02d}.exr", number)
    return tmp_path


def run(capsys, *arguments):
    """The events of a run that must end well."""
    capsys.readouterr()
    assert main([*arguments, "--json"]) == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def written(events):
    return [event["number"] for event in events if event["event"] == "frame" and event["output"]]


def pictures(folder):
    return {path.name: read_exr(path).color for path in sorted(folder.glob("clean.*.exr"))}


def assert_same(found, expected, *, within=0.0):
    assert found.keys() == expected.keys()
    for name, picture in expected.items():
        np.testing.assert_allclose(found[name], picture, rtol=0, atol=within, err_msg=name)


def test_finished_frames_are_kept_whatever_their_times_say(shot, capsys):
    run(capsys, *COMMAND)
    for path in shot.glob("shot.*.exr"):  # copied anew, or from a clock that goes wrong
        os.utime(path)
    before = {path: path.stat().st_mtime_ns for path in shot.glob("clean.*")}
    (summary,) = run(capsys, *COMMAND, "--resume")
    assert summary["frames_done_already"] == FRAMES
    assert {path: path.stat().st_mtime_ns for path in shot.glob("clean.*")} == before


def test_changed_input_renders_all_frames_that_remember_it(shot, capsys):
    run(capsys, *COMMAND)
    stamp = (shot / "shot.04.exr").stat()
    write_frame(shot / "shot.04.exr", 4, seed=99)
    os.utime(shot / "shot.04.exr", ns=(stamp.st_atime_ns, stamp.st_mtime_ns))  # no help there
    assert written(run(capsys, *COMMAND, "--resume", "--warm-up", "32")) == list(range(4, 11))
    resumed = pictures(shot)
    run(capsys, *COMMAND)
    assert_same(resumed, pictures(shot))


def test_changed_input_matters_no_longer_than_history_is_said_to_last(shot, capsys):
    run(capsys, *COMMAND, "--warm-up", "2")
    write_frame(shot / "shot.04.exr", 4, seed=99)
    assert written(run(capsys, *COMMAND, "--resume", "--warm-up", "2")) == [4, 5, 6]


@pytest.mark.parametrize("change", [("--no-cuts",), ("--no-temporal",), ("-m", "wskp-3s")])
def test_changed_option_renders_all_anew(shot, capsys, change):
    run(capsys, *COMMAND)
    assert len(written(run(capsys, *COMMAND, *change, "--resume"))) == FRAMES


def test_a_shot_is_of_one_precision(shot, capsys):
    command = (*COMMAND[:-1], "high")
    assert len(written(run(capsys, *command, "--precision", "int8"))) == FRAMES
    assert written(run(capsys, *command, "--precision", "int8", "--resume")) == []
    assert len(written(run(capsys, *command, "--precision", "float32", "--resume"))) == FRAMES


def test_a_network_quantised_anew_renders_all_anew(shot, capsys):
    path = find_model("high").path
    for file in (path, int8_path(path)):
        shutil.copy(file, shot)
    command = (*COMMAND[:-1], path.name, "--precision", "int8")
    run(capsys, *command)
    assert written(run(capsys, *command, "--resume")) == []
    network = int8_path(shot / path.name)
    model = onnx.load(network)
    model.doc_string = "made again"
    onnx.save(model, network)
    assert len(written(run(capsys, *command, "--resume"))) == FRAMES


def test_options_that_change_no_pixel_render_nothing(shot, capsys):
    run(capsys, *COMMAND)
    assert (
        written(run(capsys, *COMMAND, "--threads", "2", "--on-missing", "skip", "--resume")) == []
    )


def test_foreign_and_broken_outputs_are_replaced(shot, capsys):
    run(capsys, *COMMAND)
    whole = pictures(shot)
    shutil.copy(shot / "shot.02.exr", shot / "clean.02.exr")
    shutil.copy(shot / "clean.07.exr", shot / "clean.06.exr")
    (shot / "clean.09.exr").write_bytes((shot / "clean.09.exr").read_bytes()[:-40])
    (shot / "clean.10.exr").write_bytes(b"")
    assert written(run(capsys, *COMMAND, "--resume")) == [2, 6, 9, 10]
    assert_same(pictures(shot), whole)


@pytest.mark.parametrize("command", [COMMAND, RECALLING])
def test_shot_in_parts_with_warm_up_is_near_the_whole(shot, capsys, command):
    run(capsys, *command)
    whole = pictures(shot)
    for path in shot.glob("clean.*"):
        path.unlink()
    events = run(capsys, *command, "--frames", "1-5")
    events = run(capsys, *command, "--frames", "6-10", "--warm-up", "5")
    assert written(events) == [6, 7, 8, 9, 10]
    assert [e["number"] for e in events if e.get("output", "") is None] == [1, 2, 3, 4, 5]
    # a warm-up that reaches back to the first frame is the whole run
    assert_same(pictures(shot), whole)
    run(capsys, *command, "--frames", "6-10")
    cold = pictures(shot)
    run(capsys, *command, "--frames", "6-10", "--warm-up", "3")
    warm = pictures(shot)

    def apart(some):
        return np.abs(some["clean.06.exr"] - whole["clean.06.exr"]).mean()

    assert 0 < apart(warm) < 0.7 * apart(cold)


def test_parts_know_each_others_frames_where_their_memory_is_the_same(shot, capsys):
    run(capsys, *COMMAND, "--frames", "1-5", "--warm-up", "3")
    run(capsys, *COMMAND, "--frames", "6-10", "--warm-up", "3")
    assert written(run(capsys, *COMMAND, "--warm-up", "3", "--resume")) == []


def test_cut_is_reported_and_resumed_alike(shot, capsys):
    rng = np.random.default_rng(0)
    for number in range(6, FRAMES + 1):  # another set, with dark and bright at other places
        frame = make_frame(HEIGHT * 3, WIDTH * 3, seed=number)
        color, depth = frame.color, np.full(frame.shape, 40.0)
        color[:, : WIDTH * 2] *= rng.choice([0.01, 20], (HEIGHT * 3, 1, 1)).repeat(1, axis=1)
        channels = {name: color[..., i] for i, name in enumerate("RGB")}
        zero = np.zeros(frame.shape, np.float32)
        write_channels(
            shot / f"shot.{number:02d}.exr",
            channels | {"depth.Z": depth, "motion.X": zero, "motion.Y": zero},
        )
    for number in range(1, 6):
        frame = make_frame(HEIGHT * 3, WIDTH * 3, seed=number)
        channels = {name: frame.color[..., i] for i, name in enumerate("RGB")}
        zero = np.zeros(frame.shape, np.float32)
        write_channels(
            shot / f"shot.{number:02d}.exr",
            channels | {"depth.Z": frame.depth, "motion.X": zero, "motion.Y": zero},
        )
    events = run(capsys, *COMMAND)
    assert events[-1]["cuts"] == [6]
    assert "surface of before" in events[5]["cut"]
    whole = pictures(shot)
    (shot / "clean.08.exr").unlink()
    assert run(capsys, *COMMAND, "--resume")[-1]["cuts"] == [6]
    assert_same(pictures(shot), whole)
    # a shot that begins there has the same pictures
    run(capsys, *COMMAND, "--frames", "6-10")
    assert_same(pictures(shot), whole)
    assert run(capsys, *COMMAND, "--no-cuts")[-1]["cuts"] == []
    assert not np.array_equal(pictures(shot)["clean.06.exr"], whole["clean.06.exr"])


def test_killed_runs_resume_to_the_same_shot_and_leave_nothing(shot, capsys):
    run(capsys, *RECALLING)
    whole = pictures(shot)
    for path in shot.glob("clean.*"):
        path.unlink()
    program = [sys.executable, "-m", "stillray", *RECALLING, "--resume", "--quiet"]
    start = time.perf_counter()
    subprocess.run(program, check=True)
    typical = time.perf_counter() - start
    dice = random.Random(5)
    for _ in range(KILLS):
        for path in shot.glob("clean.*"):
            if dice.random() < 0.7:
                path.unlink()
        process = subprocess.Popen(program)
        time.sleep(dice.uniform(0.2, 1.1) * typical)
        process.send_signal(signal.SIGKILL)
        process.wait()
        for path in shot.glob("clean.*.exr"):  # whole, or not there
            np.testing.assert_array_equal(read_exr(path).color, whole[path.name])
    # what was cut short at the wrong moment, and a file that only looks alike
    (shot / ".clean.04.exr.abc12_x.part").touch()
    (shot / ".unclean.04.exr.abc12_x.part").touch()
    run(capsys, *RECALLING, "--resume")
    assert_same(pictures(shot), whole)
    (shot / ".unclean.04.exr.abc12_x.part").unlink()
    names = {path.name for path in shot.iterdir()}
    assert names == {f"{kind}.{n:02d}.exr" for kind in ("shot", "clean") for n in range(1, 11)}


def test_interrupt_is_quiet_keeps_what_is_done_and_exits_with_1(shot):
    program = [sys.executable, "-u", "-m", "stillray", *COMMAND]
    process = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    told = [process.stdout.readline() for _ in range(2)]
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=300)
    told += out.splitlines()
    if process.returncode == 0:
        pytest.skip("it was faster than the signal")
    assert (process.returncode, err) == (1, "error: interrupted\n")
    said = {line.split(" -> ")[1].split()[0] for line in told if " -> " in line}
    # the last may be written and not told of
    assert said <= {path.name for path in shot.glob("clean.*")}
    assert all(picture.shape == (HEIGHT, WIDTH, 3) for picture in pictures(shot).values())
    assert [path.name for path in shot.iterdir() if path.name.startswith(".")] == []


def test_two_writers_of_the_same_frames_lose_nothing(shot, capsys):
    command = [sys.executable, "-m", "stillray", *COMMAND, "--threads", "1", "--quiet"]
    writers = [
        subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(2)
    ]  # fmt: skip
    for writer in writers:
        _, complaint = writer.communicate(timeout=300)
        # one may find that the other took its unfinished file for a leftover: a line, no more
        assert writer.returncode == 0 or complaint.count("\n") == 1
    # whatever is there is whole, and is finished
    there = sorted(path.name for path in shot.glob("clean.*"))
    found = pictures(shot)
    (*_, summary) = run(capsys, *COMMAND, "--threads", "1", "--resume")
    assert summary["frames_done_already"] == len(there)
    again = pictures(shot)
    assert len(again) == FRAMES
    assert_same({name: again[name] for name in found}, found)
    assert not list(shot.glob(".*.part"))

"""The options of ``stillray denoise``: what is said, what is accepted, and faults of the disk."""

import json
import os
import re
import resource
import subprocess
import sys

import numpy as np
import pytest

from stillray.cli import main
from stillray.cli.oidn_flags import spell_out
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.read import read_exr

HEIGHT, WIDTH = 33, 18
FAST = ("-m", "fast")


def write_frame(path, seed, *, names=("R", "G", "B", "albedo.R", "albedo.G", "albedo.B")):
    rng = np.random.default_rng(seed)
    channels = {name: rng.random((HEIGHT, WIDTH), np.float32) for name in names}
    if names == ("R", "G", "B"):
        write_channels(path, channels)
        return
    zero = np.zeros((HEIGHT, WIDTH), np.float32)
    write_channels(path, channels | {"motion.X": zero, "motion.Y": zero})


@pytest.fixture
def shot(tmp_path, monkeypatch):
    """A sequence of three frames, in the current folder."""
    monkeypatch.chdir(tmp_path)
    for number in (1, 2, 3):
        write_frame(tmp_path / f"shot.{number}.exr", number)
    return tmp_path


def outputs(folder):
    return sorted(path.name for path in folder.glob("clean*"))


def test_folder_as_output_takes_the_inputs_names(shot):
    (shot / "out").mkdir()
    assert main(["denoise", "shot.*.exr", "-o", "out", *FAST]) == 0
    assert sorted(path.name for path in (shot / "out").iterdir()) == [
        "shot.1.exr", "shot.2.exr", "shot.3.exr",
    ]  # fmt: skip
    assert main(["denoise", "shot.1.exr", "-o", "out/", *FAST]) == 0


def test_names_that_the_shell_has_expanded_are_one_sequence(shot, capsys):
    files = ["shot.3.exr", "shot.1.exr", "shot.2.exr"]
    assert main(["denoise", *files, "-o", "clean.#.exr", *FAST]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()[:3]] == sorted(files)


def test_json_is_a_line_a_frame_and_a_summary(shot, capsys):
    command = ["denoise", "shot.#.exr", "-o", "clean.#.exr", "--frames", "2-3", *FAST]
    assert main([*command, "--warm-up", "1", "--json"]) == 0
    *events, summary = map(json.loads, capsys.readouterr().out.splitlines())
    assert [(e["event"], e["number"], e["output"]) for e in events] == [
        ("frame", 1, None), ("frame", 2, "clean.2.exr"), ("frame", 3, "clean.3.exr"),
    ]  # fmt: skip
    assert [e["starts_anew"] for e in events] == [True, False, False]
    assert all(e["denoise_ms"] > 0 and e["read_ms"] > 0 for e in events)
    assert summary["event"] == "summary"
    assert (summary["frames_written"], summary["frames_warm_up"], summary["cuts"]) == (2, 1, [])
    assert summary["seconds"] > 0


def test_frames_that_hold_no_numbers_are_told_of(shot, capsys):
    rng = np.random.default_rng(0)
    for number, lost in ((4, 0), (5, 9), (6, HEIGHT * WIDTH)):
        planes = rng.random((3, HEIGHT * WIDTH), np.float32)
        planes[1, :lost] = np.nan
        planes[2, : lost // 2] = np.inf  # of the same pixels
        shaped = planes.reshape(3, HEIGHT, WIDTH)
        write_channels(shot / f"lost.{number}.exr", dict(zip("RGB", shaped, strict=True)))
    command = ["denoise", "lost.#.exr", "-o", "clean.#.exr", *FAST]
    assert main(command) == 0
    whole, some, none = capsys.readouterr().out.splitlines()[:3]
    assert "finite" not in whole
    assert some.endswith("1.52 % of pixels are no finite numbers, filled from those around")
    assert "no pixel's color is a finite number: the picture is black" in none
    assert not read_exr(shot / "clean.6.exr").color.any()
    assert main([*command, "--json"]) == 0
    *events, _ = map(json.loads, capsys.readouterr().out.splitlines())
    assert [round(e["broken"] * HEIGHT * WIDTH) for e in events] == [0, 9, HEIGHT * WIDTH]


@pytest.mark.parametrize("flag", ["--quiet", "-q"])
def test_quiet_says_nothing(shot, capsys, flag):
    assert main(["denoise", flag, "shot.#.exr", "-o", "clean.#.exr", *FAST]) == 0
    assert capsys.readouterr() == ("", "")
    assert len(outputs(shot)) == 3


def test_verbose_tells_all_times(shot, capsys):
    assert main(["denoise", "-v", "shot.#.exr", "-o", "clean.#.exr", *FAST]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all("read " in line and "write " in line for line in lines[:3])
    assert "in the denoiser" in lines[-1]


def test_dry_run_says_frames_layers_and_stages_and_writes_nothing(shot, capsys):
    before = sorted(shot.iterdir())
    command = ["denoise", "shot.#.exr", "-o", "clean.#.exr", "--frames", "2-3", *FAST]
    assert main([*command, "--warm-up", "1", "--dry-run", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert [(f["number"], f["action"], f["output"]) for f in facts["frames"]] == [
        (1, "warm-up, not written, history starts anew", None),
        (2, "denoise", "clean.2.exr"),
        (3, "denoise", "clean.3.exr"),
    ]
    assert facts["layers"]["albedo"]["channels"] == ["albedo.R", "albedo.G", "albedo.B"]
    first, following = (
        {stage["name"]: stage for stage in facts[which]}
        for which in ("stages_first", "stages_following")
    )
    assert not first["reproject"]["runs"]
    assert following["reproject"]["runs"]
    assert all(stage["reason"] for stage in first.values())
    assert main([*command, "--dry-run"]) == 0
    text = capsys.readouterr().out
    assert "albedo.R, albedo.G, albedo.B of shot.2.exr" in text
    assert "2 frames would be written" in text
    assert sorted(shot.iterdir()) == before


def test_dry_run_of_a_finished_shot_says_so(shot, capsys):
    command = ["denoise", "shot.#.exr", "-o", "clean.#.exr", *FAST]
    assert main([*command, "-q"]) == main([*command, "--resume", "--dry-run"]) == 0
    text = capsys.readouterr().out
    assert text.count("done already") == 3
    assert "0 frames would be written" in text


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["-m", "online"], "online needs the buffer color_b"),
        (["-m", "online-warm"], "online-warm needs the buffer color_b"),
        (
            ["-m", "online-warm", "--color-b", "shot.#.exr"],
            "color-b must be the frame rendered with another seed, got itself",
        ),
        ([*FAST, "--max-memory", "20M"], "max-memory must be "),
        (["-m", "munet-x2", "--max-memory", "4G"], "max-memory must not be given with munet-x2"),
        ([*FAST, "--provider", "NoneExecutionProvider"], "providers must be among"),
        ([*FAST, "--threads", "0"], "threads must be an integer, 1 or more, got 0"),
        ([*FAST, "--workers", "2", "--chunk", "0"], "chunk must be 1 frame or more, got 0"),
    ],
)
def test_a_dry_run_refuses_what_the_run_refuses(shot, capsys, options, why):
    command = ["denoise", "shot.#.exr", "-o", "clean.#.exr", *options]
    assert main([*command, "--dry-run"]) == 2
    said = capsys.readouterr().err
    assert why in said
    assert main(command) == 2
    assert capsys.readouterr().err == said
    assert outputs(shot) == []


def test_a_dry_run_counts_the_layers_and_looks_at_them_as_the_run_does(shot, capsys):
    light = [f"diffuse.{c}" for c in "RGB"]
    write_frame(shot / "lit.exr", 4, names=("R", "G", "B", "albedo.R", *light))
    command = ["denoise", "lit.exr", "-o", "clean.exr", *FAST, "--dry-run", "--json"]
    for options, runs in (((), False), (("--aovs", "all"), True)):
        assert main([*command, *options]) == 0
        stages = {s["name"]: s for s in json.loads(capsys.readouterr().out)["stages_first"]}
        assert stages["layers"]["runs"] == runs
    # in so little memory that there are tiles, no layers can be filtered
    large = dict.fromkeys([*"RGB", *light], np.ones((400, 600), np.float32))
    write_channels(shot / "large.exr", large)
    command = ["denoise", "large.exr", "-o", "clean.exr", "-m", "wskp-3s", "--max-memory"]
    assert main([*command, "20M"]) == 2
    least = re.search(r"must be (\d+)M or more", capsys.readouterr().err)[1]
    command.append(f"{int(least) + 50}M")
    assert main([*command, "--dry-run"]) == 0
    capsys.readouterr()
    for end in (["--dry-run"], []):
        assert main([*command, "--aovs", "all", *end]) == 2
        assert "where other layers are filtered too" in capsys.readouterr().err


def test_a_dry_run_of_one_file_looks_forward_to_no_next_frame(shot, capsys):
    assert main(["denoise", "shot.1.exr", "-o", "clean.exr", "--dry-run", "--json"]) == 0
    dry = json.loads(capsys.readouterr().out)
    assert main(["info", "shot.1.exr", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (dry["model"], dry["stages_first"]) == (told["model"], told["stages"])
    assert not {s["name"]: s for s in told["stages"]}["keep_output"]["runs"]


@pytest.mark.parametrize("dash", ["-", "--"])
def test_flags_of_oidn_denoise_mean_the_same(shot, dash):
    write_frame(shot / "color.exr", 9, names=("R", "G", "B"))
    write_frame(shot / "a.exr", 7, names=("R", "G", "B"))
    write_frame(shot / "n.exr", 8, names=("R", "G", "B"))
    familiar = [
        f"{dash}hdr", "color.exr", f"{dash}alb", "a.exr", f"{dash}nrm", "n.exr", "-q", "f",
    ]  # fmt: skip
    plain = ["color.exr", "--albedo", "a.exr", "--normal", "n.exr", "--model", "fast"]
    assert main(["denoise", *familiar, "-o", "clean1.exr"]) == 0
    assert main(["denoise", *plain, "-o", "clean2.exr"]) == 0
    one, other = read_exr("clean1.exr").color, read_exr("clean2.exr").color
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("given", "spelled"),
    [
        ("denoise -q high a.exr", "denoise --model high a.exr"),
        ("denoise -q h -q a.exr", "denoise --model high --quiet a.exr"),
        ("denoise a.exr -q", "denoise a.exr --quiet"),
        ("denoise -q -o b.exr a.exr", "denoise --quiet -o b.exr a.exr"),
        ("denoise -- -q fast", "denoise -- -q fast"),
        ("info -q fast", "info -q fast"),
        ("", ""),
    ],
)
def test_q_is_quality_before_a_quality_and_quiet_before_anything_else(given, spelled):
    assert " ".join(spell_out(given.split())) == spelled


def test_input_is_given_once(shot, capsys):
    assert main(["denoise", "shot.1.exr", "--hdr", "shot.2.exr", "-o", "clean.exr"]) == 2
    assert "INPUT must be given once" in capsys.readouterr().err


def test_shells_can_complete(shot):
    environment = {
        **os.environ,
        "_STILLRAY_COMPLETE": "complete_bash",
        "COMP_WORDS": "stillray denoise --model ba",
        "COMP_CWORD": "3",
    }
    command = [sys.executable, "-c", "import sys, stillray.cli as c; sys.exit(c.main([]))"]
    found = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert found.stdout.split() == ["balanced"]


def test_disk_full_is_one_line_and_leaves_only_whole_files(shot):
    # as large as a file may get: the first two frames fit, the third does not
    assert main(["denoise", "shot.1.exr", "-o", "clean.1.exr", *FAST]) == 0
    room = (shot / "clean.1.exr").stat().st_size
    (shot / "clean.1.exr").unlink()
    big = np.random.default_rng(0).random((4 * HEIGHT, 4 * WIDTH), np.float32)
    write_channels(shot / "shot.3.exr", {name: big for name in "RGB"})

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (room + 500, room + 500))

    command = [
        sys.executable,
        "-m",
        "stillray",
        "denoise",
        "shot.#.exr",
        "-o",
        "clean.#.exr",
        *FAST,
    ]
    ended = subprocess.run(command, capture_output=True, text=True, preexec_fn=limit)
    assert ended.returncode == 2, ended.stderr
    assert ended.stderr.count("\n") == 1
    assert "clean.3.exr: cannot be written" in ended.stderr
    assert outputs(shot) == ["clean.1.exr", "clean.2.exr"]
    assert [path.name for path in shot.iterdir() if path.name.startswith(".")] == []
    assert main([*command[3:], "--resume", "-q"]) == 0
    assert len(outputs(shot)) == 3


def test_folder_that_takes_no_files_is_named_before_any_work(shot, capsys):
    assert main(["denoise", "shot.#.exr", "-o", "/proc/clean.#.exr", *FAST]) == 2
    assert "/proc/clean.1.exr: the folder must exist and be writable" in capsys.readouterr().err


def test_memory_that_cannot_hold_a_frame_is_refused_and_enough_changes_nothing(shot, capsys):
    command = ["denoise", "shot.#.exr", "-o", "clean.#.exr", *FAST]
    assert main([*command, "--max-memory", "20M"]) == 2
    assert "max-memory must be " in capsys.readouterr().err
    assert outputs(shot) == []
    assert main([*command, "--max-memory", "2G"]) == 0
    capsys.readouterr()
    # a run that was short of memory need not do its frames again with more of it, or less
    assert main([*command, "--resume"]) == 0
    assert capsys.readouterr().out == "3 frames done already, nothing to do\n"


def test_a_files_names_reach_the_terminal_as_text(shot, capsys):
    planes = dict.fromkeys(("R", "G", "B", "\x1b[31mred"), np.ones((HEIGHT, WIDTH), np.float32))
    write_channels(shot / "odd.exr", planes)
    assert main(["info", "odd.exr", *FAST]) == 0
    assert main(["info", "odd.exr", "--layer", "color=none", *FAST]) == 2
    said = "".join(capsys.readouterr())
    assert "\x1b" not in said
    assert said.count(r"\x1b[31mred") == 3

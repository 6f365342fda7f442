"""The command line end to end: exit codes, one-line errors, and outputs whole or not at all."""

import json
import os
import subprocess
import sys

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
import typer

import stillray
from stillray import cli
from stillray.cli import main
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.read import read_exr, read_metadata
from stillray.model_spec import load

HEIGHT, WIDTH = 33, 18
GAPPY = ("shot.####.exr", "--on-missing", "skip")
FAST_WITH_GAP = ("-m", "fast", "--on-missing", "skip")  # the shot below lacks frame 4
NAMES = ("R", "G", "B", "albedo.R", "albedo.G", "albedo.B", "motion.X", "motion.Y")


def write_frame(path, seed=0, *, names=NAMES):
    rng = np.random.default_rng(seed)
    channels = {name: rng.random((HEIGHT, WIDTH), np.float32) for name in names}
    for name in names:
        if name.startswith("motion"):
            channels[name][:] = 0
    write_channels(path, channels)


@pytest.fixture
def shot(tmp_path, monkeypatch):
    """A sequence with a gap, in the current folder."""
    monkeypatch.chdir(tmp_path)
    for number in (1, 2, 3, 5):
        write_frame(tmp_path / f"shot.{number:04d}.exr", seed=number)
    return tmp_path


def fails(capsys, *arguments):
    """The one line on standard error of a command that must end with code 2."""
    assert main(arguments) == 2
    streams = capsys.readouterr()
    assert streams.err.startswith("error: ")
    assert streams.err.count("\n") == 1
    return streams.err


def outputs(folder):
    return sorted(path.name for path in folder.glob("clean*"))


def test_denoise_sequence_writes_every_frame_and_says_how_long(shot, capsys):
    assert main(["denoise", "shot.####.exr", "-o", "clean.%04d.exr", *FAST_WITH_GAP]) == 0
    assert outputs(shot) == [f"clean.{n:04d}.exr" for n in (1, 2, 3, 5)]
    assert list(shot.glob("*.part")) + list(shot.glob(".*")) == []
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("shot.0001.exr -> clean.0001.exr")
    assert lines[0].endswith(" ms")
    assert "history starts anew" in lines[3]  # frame 4 is missing: motion of 5 points into it
    assert lines[-1].startswith("4 frames, median ")
    assert "ms per frame" in lines[-1]


def test_denoise_result_is_that_of_one_denoiser_over_the_sequence(shot):
    assert main(["denoise", "shot.####.exr", "-o", "clean.####.exr", *FAST_WITH_GAP]) == 0
    with stillray.Denoiser("fast") as denoiser:
        for number in (1, 2, 3, 5):
            if number == 5:
                denoiser.reset()
            expected = denoiser.denoise(read_exr(f"shot.{number:04d}.exr"))
            written = read_exr(f"clean.{number:04d}.exr").color
            np.testing.assert_array_equal(written, expected.astype(np.float16))


def test_denoise_without_temporal_treats_each_frame_alone(shot):
    command = ["denoise", "shot.####.exr", "-o", "clean.####.exr", *FAST_WITH_GAP]
    assert main([*command, "--no-temporal"]) == 0
    frame = read_exr("shot.0003.exr")
    with stillray.Denoiser("fast", temporal=False) as denoiser:
        alone = denoiser.denoise(frame).astype(np.float16)
    np.testing.assert_array_equal(read_exr("clean.0003.exr").color, alone)
    assert main(command) == 0
    assert not np.array_equal(read_exr("clean.0003.exr").color, alone)


def test_denoise_one_file_keeps_its_windows(shot):
    write_channels(
        shot / "one.exr",
        {c: np.full((HEIGHT, WIDTH), 0.5, np.float32) for c in "RGB"},
        attributes={"shotName": "take 2"},
    )
    assert main(["denoise", "one.exr", "-o", "clean.exr", "--model", "fast"]) == 0
    assert read_metadata("clean.exr").getattribute("shotName") == "take 2"
    assert read_exr("clean.exr").shape == (HEIGHT, WIDTH)


def test_denoise_takes_features_from_separate_sequences(shot):
    for number in (1, 2, 3, 5):
        write_frame(shot / f"albedo.{number:04d}.exr", seed=number, names=("R", "G", "B"))
    command = ["denoise", "shot.####.exr", "-o", "clean.####.exr", *FAST_WITH_GAP]
    assert main([*command, "--albedo", "albedo.####.exr"]) == 0
    with stillray.Denoiser("fast") as denoiser:
        expected = denoiser.denoise(
            read_exr("shot.0001.exr", companions={"albedo": "albedo.0001.exr"})
        )
    np.testing.assert_array_equal(read_exr("clean.0001.exr").color, expected.astype(np.float16))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["gone.####.exr", "-o", "clean.####.exr"], ["gone.####.exr", "no file matches"]),
        (["gone.exr", "-o", "clean.exr"], ["gone.exr", "no such file"]),
        ([*GAPPY, "-o", "clean.exr"], ["output", "placeholder", "clean.exr"]),
        ([*GAPPY, "-o", "shot.%04d.exr"], ["overwrite", "shot.0001.exr"]),
        (["shot.0001.exr", "-o", "./shot.0001.exr"], ["overwrite", "shot.0001.exr"]),
        (["shot.0001.exr", "-o", "nowhere/clean.exr"], ["nowhere", "exist and be writable"]),
        (["shot.0001.exr", "-o", "shot.0002.exr/clean.exr"], ["exist and be writable"]),
        (["shot.0001.exr", "-o", "clean.png"], ["output", ".exr", "clean.png"]),
        (["shot.0001.exr", "-o", "clean.exr", "-m", "best"], ["model must be one of", "best"]),
        (["shot.0001.exr", "-o", "clean.exr", "--threads", "0"], ["threads", "0"]),
        (
            ["shot.0001.exr", "-o", "clean.exr", "--threads", "two"],
            ["--threads", "'two'"],
        ),
        (["shot.0001.exr", "-o", "clean.exr", "--normal", "n.exr"], ["n.exr"]),
        (["shot.0001.exr", "-o", "clean.exr", "--nonsense"], ["--nonsense"]),
        (["shot.0001.exr"], ["-o"]),
        ([], ["INPUT"]),
    ],
)
def test_denoise_bad_usage_is_one_line_and_writes_nothing(shot, capsys, arguments, words):
    before = sorted(shot.iterdir())
    line = fails(capsys, "denoise", *arguments)
    assert all(word in line for word in words), line
    assert sorted(shot.iterdir()) == before


def test_denoise_checks_the_last_frame_before_the_first_is_denoised(shot, capsys):
    write_frame(shot / "shot.0006.exr", names=("depth.Z",))
    assert "shot.0006.exr: must hold color" in fails(
        capsys, "denoise", "shot.####.exr", "-o", "clean.####.exr", *FAST_WITH_GAP
    )
    assert outputs(shot) == []


def test_denoise_missing_feature_frame_is_named_before_any_work(shot, capsys):
    write_frame(shot / "albedo.0001.exr", names=("R", "G", "B"))
    command = ["denoise", "shot.####.exr", "-o", "clean.####.exr", *FAST_WITH_GAP]
    assert "albedo.0002.exr: no such file" in fails(capsys, *command, "--albedo", "albedo.####.exr")
    assert outputs(shot) == []


def test_denoise_truncated_frame_stops_there_and_leaves_whole_files(shot, capsys):
    data = (shot / "shot.0003.exr").read_bytes()
    (shot / "shot.0003.exr").write_bytes(data[:-300])
    assert "shot.0003.exr: " in fails(
        capsys, "denoise", "shot.####.exr", "-o", "clean.####.exr", *FAST_WITH_GAP
    )
    assert outputs(shot) == ["clean.0001.exr", "clean.0002.exr"]
    assert read_exr("clean.0002.exr").shape == (HEIGHT, WIDTH)


def test_denoise_unexpected_failure_ends_with_code_1(shot, capsys, monkeypatch):
    def explode(self, frame):
        raise RuntimeError("the network is on fire")

    monkeypatch.setattr("stillray.pipeline.denoiser.Denoiser.denoise", explode)
    assert main(["denoise", "shot.0001.exr", "-o", "clean.exr", "-m", "fast"]) == 1
    assert capsys.readouterr().err.endswith("RuntimeError: the network is on fire\n")
    assert outputs(shot) == []


def test_resume_runs_only_what_is_missing_or_broken(shot, capsys):
    command = ["denoise", "shot.####.exr", "-o", "clean.####.exr", *FAST_WITH_GAP]
    assert main(command) == 0
    whole = {name: (shot / name).read_bytes() for name in outputs(shot)}
    (shot / "clean.0002.exr").unlink()
    (shot / "clean.0003.exr").write_bytes(whole["clean.0003.exr"][:-50])
    first = (shot / "clean.0001.exr").stat().st_mtime_ns
    capsys.readouterr()
    assert main([*command, "--resume"]) == 0
    text = capsys.readouterr().out
    assert "shot.0001.exr -> (warm-up, not written)" in text
    assert "2 frames, " in text
    assert "2 done already" in text
    assert (shot / "clean.0001.exr").stat().st_mtime_ns == first
    # with the whole past run again, resuming changes no pixel
    np.testing.assert_array_equal(read_exr("clean.0003.exr").color, _color(shot, whole))


def _color(folder, whole):
    (folder / "before.exr").write_bytes(whole["clean.0003.exr"])
    return read_exr(folder / "before.exr").color


def test_resume_with_everything_done_says_so(shot, capsys):
    command = ["denoise", "shot.####.exr", "-o", "clean.####.exr", *FAST_WITH_GAP]
    assert main(command) == 0
    before = {path: path.stat().st_mtime_ns for path in shot.iterdir()}
    capsys.readouterr()
    assert main([*command, "--resume"]) == 0
    assert capsys.readouterr().out == "4 frames done already, nothing to do\n"
    assert {path: path.stat().st_mtime_ns for path in shot.iterdir()} == before


def test_without_resume_finished_frames_are_denoised_again(shot, capsys):
    command = ["denoise", "shot.####.exr", "-o", "clean.####.exr", *FAST_WITH_GAP]
    assert main(command) == main(command) == 0
    assert capsys.readouterr().out.count("4 frames, ") == 2


def test_info_json_tells_roles_counts_and_stages(shot, capsys):
    channels = {name: np.full((HEIGHT, WIDTH), 0.5, np.float32) for name in NAMES}
    channels["R"][0, 0] = channels["G"][0, 0] = np.nan  # one pixel, two channels
    channels["G"][1, 1] = -1
    channels["cryptomatte.R"] = channels["R"]
    write_channels(shot / "f.exr", channels)
    assert main(["info", "f.exr", "--model", "fast", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["height"], facts["width"]) == (HEIGHT, WIDTH)
    assert facts["data_window"] == [0, 0, WIDTH, HEIGHT]
    assert [layer["role"] for layer in facts["layers"]] == ["color", "albedo", "motion"]
    assert facts["color_pixels"] == {
        "total": HEIGHT * WIDTH, "nan": 1, "infinite": 0, "negative": 1,
    }  # fmt: skip
    stages = {stage["name"]: stage for stage in facts["stages"]}
    assert stages["repair"]["runs"]
    assert stages["demodulate"]["runs"]
    assert stages["repair"]["reason"]


def test_info_prints_the_sign_flip_and_the_channels_left_over(shot, capsys):
    names = ["VL.Combined.R", "VL.Combined.G", "VL.Combined.B", "VL.Vector.X", "VL.Vector.Y"]
    write_frame(shot / "f.exr", names=[*names, "VL.Mist.Z"])
    assert main(["info", "f.exr", "--model", "fast"]) == 0
    text = capsys.readouterr().out
    assert "VL.Vector.X, -VL.Vector.Y" in text
    assert "channels without a role: VL.Mist.Z" in text
    assert f"{WIDTH} x {HEIGHT} pixels" in text
    assert "reconstruct" in text


def test_info_of_a_pattern_shows_its_first_frame(shot, capsys):
    assert main(["info", "shot.####.exr", "--model", "fast"]) == 0
    assert capsys.readouterr().out.startswith("shot.0001.exr: ")


def test_info_warns_of_normals_that_may_be_encoded(shot, capsys):
    write_frame(shot / "f.exr", names=("R", "G", "B", "normal.X", "normal.Y", "normal.Z"))
    assert main(["info", "f.exr", "--model", "fast"]) == 0
    assert "warning: normal has no negative component" in capsys.readouterr().out


def test_info_of_a_bad_file_is_one_line(shot, capsys):
    (shot / "bad.exr").write_bytes(b"")
    assert "bad.exr: " in fails(capsys, "info", "bad.exr", "--model", "fast")


def test_info_of_a_file_that_is_refused_still_shows_its_channels(shot, capsys):
    write_frame(shot / "f.exr", names=("mine.r1", "mine.g1", "mine.b1"))
    assert main(["info", "f.exr"]) == 2
    streams = capsys.readouterr()
    assert "channels: mine.b1, mine.g1, mine.r1" in streams.out
    assert "--layer color=NAME" in streams.err
    assert main(["info", "f.exr", "--json"]) == 2
    assert sorted(json.loads(capsys.readouterr().out)["channels"]) == [
        "mine.b1", "mine.g1", "mine.r1",
    ]  # fmt: skip


def test_denoise_makes_a_folder_that_is_named_with_a_slash(shot, capsys):
    arguments = ["denoise", "shot.0001.exr", "-m", "wskp-3s", "-o"]
    assert "as new/, is made" in fails(capsys, *arguments, "new/clean.exr")
    assert main([*arguments, "deep/new/", "--dry-run"]) == 0
    assert not (shot / "deep").exists()
    assert main([*arguments, "deep/new/"]) == 0
    assert [path.name for path in (shot / "deep/new").iterdir()] == ["shot.0001.exr"]


def test_denoise_says_what_of_the_structure_it_cannot_keep(shot, capsys):
    spec = oiio.ImageSpec(WIDTH, HEIGHT, 4, "half")
    spec.channelnames = ("R", "G", "B", "id")
    spec.channelformats = tuple(map(oiio.TypeDesc, ["half"] * 3 + ["uint"]))
    spec.attribute("compression", "dwaa")
    sink = oiio.ImageOutput.create("exr")
    assert sink.open("f.exr", spec)
    assert sink.write_image(np.zeros((HEIGHT, WIDTH, 4), np.float32))
    assert sink.close()
    assert main(["denoise", "f.exr", "-m", "wskp-3s", "-o", "clean.exr"]) == 0
    assert "note: compression dwaa becomes zip" in capsys.readouterr().out
    assert read_metadata("clean.exr").getattribute("compression") == "zip"


def test_models_json_lists_what_the_library_lists(capsys):
    assert main(["models", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert [model["name"] for model in listed] == [m.name for m in stillray.list_models()]
    assert {alias for model in listed for alias in model["quality"]} == {
        "fast", "balanced", "high",
    }  # fmt: skip


def test_models_table_has_a_line_a_model(capsys):
    assert main(["models"]) == 0
    text = capsys.readouterr().out
    for model in stillray.list_models():
        assert any(model.name in line and model.family in line for line in text.splitlines())


@pytest.mark.parametrize("flag", ["-v", "--verbose"])
def test_models_verbose_tells_what_each_does_otherwise_than_its_paper(flag, capsys):
    assert main(["models", flag]) == 0
    text = capsys.readouterr().out
    for model in stillray.list_models():
        _, _, told = text.partition(f"\n{model.name}: ")
        lines = told.split("\n\n")[0].splitlines()
        assert lines[3:] == [f"- {difference}" for difference in load(model.name).differs]
        assert len(lines) > 5


def test_models_verbose_tells_what_each_network_computes(capsys):
    assert main(["models", "-v"]) == 0
    told = capsys.readouterr().out.partition("\nwskp-6: ")[2].splitlines()[1]
    # six convolutions of 5x5, a multiply-add each, over 12, 16 (five times) and 12 planes
    weights = 25 * (12 * 16 + 4 * 16 * 16 + 16 * 12)
    gflop = 2 * weights * 1280 * 720 / 1e9
    assert told == f"Its network: {gflop:.1f} GFLOP for 1280x720 pixels."


def test_models_are_listed_without_their_differences_unless_asked(capsys):
    assert main(["models"]) == 0
    assert "; here " not in capsys.readouterr().out


def test_help_names_the_commands(capsys):
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    assert all(command in text for command in ("denoise", "info", "models"))


@pytest.mark.parametrize("names", [[], ["denoise"], ["tradeoff"]])
def test_help_alone_is_what_the_parser_prints(names, capsys):
    assert main([*names, "--help"]) == 0
    quick = capsys.readouterr().out
    parser = typer.main.get_command(cli.build_app())
    parser.main(args=[*names, "--help"], prog_name="stillray", standalone_mode=False)
    assert quick == capsys.readouterr().out


def test_help_loads_what_it_prints_alone():
    code = (
        "import sys; from stillray.cli import main; main(['denoise', '--help']); "
        "print(sorted({'pydantic', 'numpy', 'cv2', 'onnxruntime'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("\n[]\n")


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"stillray {stillray.__version__}\n"


def test_no_command_shows_the_help_and_a_wrong_one_is_bad_usage(capsys):
    assert main([]) == 0
    assert "Commands:" in capsys.readouterr().out
    assert "deonise" in fails(capsys, "deonise")


def test_module_run_as_a_program_gives_codes_and_clean_streams(shot):
    run = [sys.executable, "-m", "stillray"]
    good = subprocess.run([*run, "info", "shot.0001.exr", "-m", "fast"], capture_output=True)
    assert (good.returncode, good.stderr) == (0, b"")
    (shot / "bad.exr").write_bytes((shot / "shot.0001.exr").read_bytes()[:900])
    bad = subprocess.run([*run, "info", "bad.exr"], capture_output=True, text=True)
    assert (bad.returncode, bad.stdout) == (2, "")
    assert bad.stderr.count("\n") == 1


def test_output_into_a_closed_pipe_is_quiet(shot):
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "stillray", "models"]
    result = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE)
    os.close(writer)
    assert (result.returncode, result.stderr) == (1, b"")

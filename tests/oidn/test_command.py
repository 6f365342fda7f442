"""Programs that call oidnDenoise, with their own command lines."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from stillray.io.exr.read import read_exr, read_metadata
from stillray.io.exr.write import write_exr
from stillray.io.pfm import read_pfm, write_pfm
from stillray.oidn.command import main
from tests.conftest import clean_color, make_frame

ROOT = Path(__file__).parents[2]
ROOM = ROOT / "tests" / "data" / "room"
FAST = ("-q", "fast", "--threads", "1")


def psnr(image, reference):
    shown = [np.clip(a, 0, 1) ** (1 / 2.2) for a in (image, reference)]
    return -10 * np.log10(np.mean((shown[0] - shown[1]) ** 2))


@pytest.fixture
def files(tmp_path, monkeypatch):
    """Float maps of a small frame, in the current folder."""
    monkeypatch.chdir(tmp_path)
    frame = make_frame(40, 32)
    write_pfm("color.pfm", frame.color)
    write_pfm("albedo.pfm", frame.albedo)
    write_pfm("normal.pfm", frame.normal)
    return frame


@pytest.fixture
def room(tmp_path, monkeypatch):
    """Float maps of a rendered frame, in the current folder, and its reference."""
    monkeypatch.chdir(tmp_path)
    frame = read_exr(ROOM / "frame_0007.exr")
    write_pfm("in.pfm", frame.color)
    write_pfm("a.pfm", frame.albedo)
    write_pfm("n.pfm", frame.normal)
    return frame, read_exr(ROOM / "ref_0007.exr").color


def run(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "stillray.oidn", *arguments], capture_output=True, text=True
    )


def test_command_line_of_godots_lightmapper(room):
    frame, reference = room
    done = run(
        "--device", "default", "--filter", "RTLightmap", "--hdr", "in.pfm", "--nrm", "n.pfm",
        "--output", "out.pfm",
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    # as it reads the result: three lines, and 12 bytes a pixel
    kind, size, scale, pixels = Path("out.pfm").read_bytes().split(b"\n", 3)
    height, width = frame.shape
    assert (kind, size, float(scale)) == (b"PF", b"%d %d" % (width, height), -1)
    assert len(pixels) == 12 * width * height
    assert psnr(read_pfm("out.pfm"), reference) > psnr(frame.color, reference) + 10


def test_command_line_of_chunkys_plugin(room):
    frame, reference = room
    done = run("-ldr", "in.pfm", "-alb", "a.pfm", "-nrm", "n.pfm", "-o", "out.pfm")
    assert (done.returncode, done.stderr) == (0, "")
    clean, clipped = read_pfm("out.pfm"), np.clip(frame.color, 0, 1)
    assert clean.min() >= 0
    assert clean.max() <= 1
    # samples above 1 are lost, which darkens the picture: as near as their mean can come
    assert psnr(clean, reference) > psnr(clipped, reference) + 6


def test_srgb_files_stay_srgb(files, capsys):
    light = np.clip(files.color, 0, 1)
    write_pfm("color.pfm", light)
    assert main(["--ldr", "color.pfm", "--alb", "albedo.pfm", "-o", "light.pfm", *FAST]) == 0
    shown = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    write_pfm("color.pfm", shown)
    command = ["--ldr", "color.pfm", "--srgb", "--alb", "albedo.pfm", "-o", "shown.pfm", *FAST]
    assert main(command) == 0
    light, shown = read_pfm("light.pfm"), read_pfm("shown.pfm")
    expected = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(shown, expected, atol=2e-5)
    assert capsys.readouterr().err == ""


def test_what_is_ignored_is_said_in_one_line(files, capsys):
    command = [
        "--hdr", "color.pfm", "--output", "out.pfm", "--device", "cuda", "--clean_aux", "--is",
        "2.5", "-t", "half", "--maxmem", "4000", "--verbose", "2", "--affinity", "1", *FAST,
    ]  # fmt: skip
    assert main(command) == 0
    streams = capsys.readouterr()
    assert streams.err.startswith("ignored: --device cuda")
    assert streams.err.count("\n") == 1
    for name in ("--is", "--type half", "--affinity"):
        assert name in streams.err
    assert "32x40" in streams.out
    assert "network: " in streams.out
    main(["--hdr", "color.pfm", "-o", "plain.pfm", "-v", "0", *FAST])
    assert capsys.readouterr() == ("", "")
    np.testing.assert_allclose(read_pfm("out.pfm"), read_pfm("plain.pfm"), rtol=1e-4)


@pytest.mark.parametrize(
    ("given", "model"),
    [
        (["--hdr", "color.pfm"], "kpyr-5s-color"),
        (["--hdr", "color.pfm", "--alb", "albedo.pfm"], "kpyr-5s-still"),
        (["--alb", "albedo.pfm"], "kpyr-5s-albedo"),
        (["--nrm", "normal.pfm"], "kpyr-5s-color"),
    ],
)
def test_the_model_that_is_named_is_the_one_that_ran(given, model, files, capsys):
    write_pfm("normal.pfm", files.normal)
    assert main([*given, "-o", "out.pfm", "-q", "fast", "-v", "1"]) == 0
    assert f" {model}: 32x40" in capsys.readouterr().out


def test_exr_goes_in_and_comes_out(files, capsys):
    write_exr("color.exr", files.color)
    assert main(["--hdr", "color.exr", "--alb", "albedo.pfm", "-o", "out.exr", *FAST]) == 0
    clean = read_exr("out.exr").color
    assert psnr(clean, clean_color(40, 32)) > psnr(files.color, clean_color(40, 32)) + 8
    assert read_metadata("out.exr").nchannels == 3
    write_exr("albedo.exr", files.albedo)  # R, G, B alone are what the option says they are
    assert main(["--hdr", "color.exr", "--alb", "albedo.exr", "-o", "two.exr", *FAST]) == 0
    # rounded to half floats, what a network in integers is told may be the next step
    np.testing.assert_allclose(read_exr("two.exr").color, clean, atol=2e-2)
    np.testing.assert_allclose(read_exr("two.exr").color.mean(), clean.mean(), rtol=5e-3)


def test_directional_lightmaps_keep_their_sign(files, capsys):
    direction = np.full((16, 12, 3), (-0.5, 0.25, 0.75), np.float32)
    write_pfm("dir.pfm", direction)
    assert main(["-f", "RTLightmap", "--dir", "dir.pfm", "-o", "out.pfm", *FAST]) == 0
    np.testing.assert_allclose(read_pfm("out.pfm"), direction, atol=1e-5)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("-o out.pfm", "an input image must be given"),
        ("--hdr none.pfm -o out.pfm", "none.pfm: cannot be read"),
        ("--hdr color.pfm -o out.png", "out.png: must be a .pfm, .phm, .exr file"),
        ("--hdr color.png -o out.pfm", "color.png: must be a"),
        ("--hdr color.pfm --ldr color.pfm -o out.pfm", "not allowed with"),
        ("--hdr color.pfm --filter RTX -o out.pfm", "RTLightmap"),
        ("--hdr color.pfm --quality best -o out.pfm", "--quality/--q: must be one of default"),
        ("--hdr color.pfm --threads 0 -o out.pfm", "threads must be an integer, 1 or more"),
        ("--hdr color.pfm --maxmem 0 -o out.pfm", "maxmem must be"),
        ("--hdr color.pfm --weights w.tza -o out.pfm", "--weights"),
        ("--hdr color.pfm --ref r.pfm -o out.pfm", "--ref"),
        ("--hdr", "expected one argument"),
    ],
)
def test_what_cannot_be_done_is_one_line_and_exit_code_1(files, capsys, command, words):
    assert main(command.split()) == 1
    error = capsys.readouterr().err
    assert error.startswith("Error: ")
    assert error.count("\n") == 1
    assert words in error
    assert not Path("out.pfm").exists()


def test_help_and_devices_are_printed(capsys):
    assert main([]) == 1
    assert "oidnDenoise" in capsys.readouterr().err
    assert main(["--list_devices"]) == 0
    assert "CPU" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="0"):
        main(["-h"])
    assert "--clean_aux" in capsys.readouterr().out


def test_intels_name_is_installed_by_a_package_of_its_own_only():
    def scripts(folder):
        with (folder / "pyproject.toml").open("rb") as file:
            return tomllib.load(file)["project"]["scripts"]

    assert "oidnDenoise" not in scripts(ROOT)
    target = scripts(ROOT / "plugins" / "oidn_denoise")["oidnDenoise"]
    assert EntryPoint("oidnDenoise", target, "console_scripts").load() is main

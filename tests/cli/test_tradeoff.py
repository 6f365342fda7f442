from __future__ import annotations

import json
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("skimage")

import stillray
from stillray import cli
from stillray.compare import metrics
from stillray.errors import InputError
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.read import read_channels, read_exr
from stillray.models.registry import find_model, with_overrides
from stillray.pipeline.denoiser import Denoiser
from stillray_training import tradeoff
from stillray_training.pareto import Priced, advice, pareto_front
from tests.conftest import make_frame, remembered

COMMAND = sys.modules["stillray.cli.tradeoff"]  # the package names the function
METRIC = {metric.name: metric for metric in metrics.METRICS}
ROOM = Path(__file__).parents[1] / "data" / "room"


def _priced(**points):
    return [
        Priced(label=label, milliseconds=ms, scores={"psnr": psnr, "flip": flip})
        for label, (ms, psnr, flip) in points.items()
    ]


POINTS = _priced(
    slow=(100, 30.0, 0.05),
    slower=(150, 30.0, 0.05),  # no better than slow
    middle=(60, 28.0, 0.10),
    quick=(20, 25.0, 0.20),
    bad=(70, 27.0, 0.30),
    hair=(61, 28.001, 0.10),  # better in digits that are not shown
)


def test_the_front_holds_what_no_other_beats_in_both():
    assert [p.label for p in pareto_front(POINTS, METRIC["psnr"])] == [
        "quick", "middle", "hair", "slow",
    ]  # fmt: skip
    # lower is better
    assert [p.label for p in pareto_front(POINTS, METRIC["flip"])] == ["quick", "middle", "slow"]


def test_of_equally_fast_methods_the_better_one_is_on_the_front():
    points = _priced(worse=(10, 20.0, 0.2), better=(10, 21.0, 0.1))
    for metric in ("psnr", "flip"):
        assert [p.label for p in pareto_front(points, METRIC[metric])] == ["better"]


def test_every_method_off_the_front_is_beaten_by_one_on_it(rng):
    points = _priced(**{f"m{i}": tuple(rng.random(3)) for i in range(60)})
    front = pareto_front(points, METRIC["psnr"])
    for point in points:
        beaten = any(
            other.milliseconds <= point.milliseconds
            and other.scores["psnr"] >= point.scores["psnr"]
            for other in front
            if other is not point
        )
        assert beaten != (point in front)


def test_advice_is_a_sentence_to_act_on():
    assert advice(POINTS, METRIC["psnr"]) == (
        "PSNR: for 20 ms use quick (25.00 dB); 40 ms more buys 3.00 dB: middle; "
        "40 ms more buys 2.00 dB: slow"
    )
    assert advice(POINTS, METRIC["flip"]) == (
        "FLIP: for 20 ms use quick (0.200); 40 ms more buys 0.100: middle; "
        "40 ms more buys 0.050: slow"
    )
    assert advice(POINTS, METRIC["ssim"]) == "SSIM ↑: not measured"


def test_fewer_kernels_are_the_first_ones(rng):
    info = find_model("wskp-3s")
    frame = make_frame(33, 18)
    with (
        Denoiser(with_overrides(info, kernels=1)) as one,
        Denoiser(with_overrides(info, kernels=6)) as all_of_them,
    ):
        image = one.denoise(frame)
        with Denoiser(info) as plain:
            np.testing.assert_array_equal(all_of_them.denoise(frame), plain.denoise(frame))
    # a single 3x3 kernel brings light from the nearest neighbours only
    assert frame.albedo is not None
    dark = frame.color.copy()
    dark[:, 9:] = 0
    with Denoiser(with_overrides(info, kernels=1)) as one:
        clean = one.denoise(stillray.Frame(color=dark, albedo=frame.albedo))
    assert clean[:, :9].max() > 0
    assert (clean[:, 10:] == 0).all()
    assert np.isfinite(image).all()


def test_a_short_history_forgets():
    info = find_model("wskp-3s")
    for samples in (1, 16):
        with Denoiser(with_overrides(info, max_samples=samples)) as denoiser:
            for index in range(8):
                denoiser.denoise(make_frame(33, 18, index))
            held = remembered(denoiser).mean[..., 3].max()
        # samples are worth up to 1 each
        assert held <= samples + 1
        assert samples == 1 or held > 3


def test_settings_that_a_model_does_not_have_are_refused():
    with pytest.raises(InputError, match="kernels must be 1 to the 6 that wskp-3s fuses, got 7"):
        with_overrides(find_model("wskp-3s"), kernels=7)
    with pytest.raises(InputError, match="kernels must be 1 to the 0 that kpyr-5 fuses, got 1"):
        with_overrides(find_model("high"), kernels=1)
    with pytest.raises(InputError, match=r"max_samples must be 1 or more, got 0\.5"):
        with_overrides(find_model("wskp-3s"), max_samples=0.5)


def _distribution(folder: Path, entry_points: dict[str, str]) -> Path:
    """A folder for `sys.path` with stillray's metadata; it goes before what is installed."""
    info = folder / "metadata" / "stillray-0.0.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stillray\nVersion: 0.0.0\n")
    lines = [f"[{COMMAND.GROUP}]", *(f"{name} = {at}" for name, at in entry_points.items())]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
    return info.parent


@pytest.fixture
def offered(tmp_path, monkeypatch):
    """The entry points as pyproject.toml has them, whatever is installed.

    Real metadata, since other libraries ask `importlib.metadata` too, in their own ways.
    """
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    monkeypatch.syspath_prepend(_distribution(tmp_path, project["entry-points"][COMMAND.GROUP]))


@pytest.fixture
def not_offered(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(_distribution(tmp_path, {}))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A part of the bundled sequence, of its last frames only."""
    folder = tmp_path_factory.mktemp("sequences")
    (folder / "room").mkdir()
    for name in ("frame_0004", "frame_0005", "frame_0006", "frame_0007", "ref_0007"):
        planes = read_channels(ROOM / f"{name}.exr")
        part = {channel: plane[40:130, 100:228].copy() for channel, plane in planes.items()}
        write_channels(folder / "room" / f"{name}.exr", part)
    return folder


@pytest.mark.usefixtures("offered")
def test_models_options_and_peers_are_scored_and_timed(folder, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    plot = tmp_path / "t.png"
    options = ["tradeoff", str(folder), "--model", "wskp-3s", "--peer", "svgf"]
    assert cli.main([*options, "--json", "--plot", str(plot)]) == 0
    facts = json.loads(capsys.readouterr().out)
    methods = {method["label"]: method for method in facts["methods"]}
    assert {
        "wskp-3s", "wskp-3s, one frame", "wskp-3s, 2 of 6 kernels", "wskp-3s, 4 of 6 kernels",
        "wskp-3s, history of 4", "wskp-3s, history of 64", "SVGF",
    } <= set(methods)  # fmt: skip
    assert [name for name, method in methods.items() if method["peer"]] == ["SVGF"]
    frames = [read_exr(path) for path in sorted((folder / "room").glob("frame_*.exr"))]
    reference = read_exr(folder / "room" / "ref_0007.exr").color
    with Denoiser("wskp-3s") as denoiser:
        image = [denoiser.denoise(frame) for frame in frames][-1]
    expected = metrics.evaluate([image], [reference], names=["psnr"])["psnr"]
    assert methods["wskp-3s"]["scores"]["psnr"] == pytest.approx(expected, abs=1e-4)
    assert methods["wskp-3s, one frame"]["scores"]["psnr"] < expected
    assert facts["noisy"]["psnr"] < expected - 5
    assert min(method["milliseconds"] for method in methods.values()) > 0
    assert set(facts["fronts"]["psnr"]) <= set(methods)
    assert plot.stat().st_size > 10_000


@pytest.mark.usefixtures("offered")
def test_the_table_ends_with_advice_for_every_metric(folder, capsys):
    assert cli.main(["tradeoff", str(folder), "--model", "wskp-3s", "--no-peers"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("noisy") for line in lines)
    assert any(line.startswith("PSNR: for ") and " ms use " in line for line in lines)
    assert any(line.startswith("SMAPE: for ") for line in lines)


def test_an_ensemble_is_an_option_of_the_models_that_can():
    labels = {option.label for option in tradeoff.model_options("kpyr-5s")}
    assert {"kpyr-5s, ensemble of 2", "kpyr-5s, ensemble of 4"} <= labels
    assert not any("ensemble" in o.label for o in tradeoff.model_options("wskp-3s"))


def test_threads_change_no_picture_and_are_scored_once(monkeypatch):
    monkeypatch.setattr(tradeoff, "available_threads", lambda: 2)
    options = {option.label: option for option in tradeoff.model_options("wskp-3s")}
    assert options["wskp-3s, 1 thread"].same_picture_as == "wskp-3s"
    monkeypatch.setattr(tradeoff, "available_threads", lambda: 1)
    assert "wskp-3s, 1 thread" not in {o.label for o in tradeoff.model_options("wskp-3s")}


@pytest.mark.usefixtures("not_offered")
def test_without_the_evaluation_one_line_says_what_to_install(tmp_path, capsys):
    assert cli.main(["tradeoff", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error == "error: tradeoff needs the evaluation: pip install 'stillray[compare]'\n"


@pytest.mark.usefixtures("offered")
def test_a_folder_without_references_is_refused(tmp_path, capsys):
    assert cli.main(["tradeoff", str(tmp_path), "--model", "wskp-3s", "--no-peers"]) == 2
    assert "folder must hold sequences with references" in capsys.readouterr().err

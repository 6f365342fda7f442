from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

pytest.importorskip("flip_evaluator")
pytest.importorskip("skimage")

from stillray.compare import metrics
from stillray.errors import InputError
from stillray.io.exr.read_write import read_exr, write_channels
from stillray_training import evaluate, evaluate_clean
from stillray_training.peers import PEERS, find_peer
from tests.conftest import clean_color, make_frame

SIZE = 40, 48


def write_sequence(folder, frames, references):
    folder.mkdir(parents=True)
    for index in range(frames):
        frame = make_frame(*SIZE, index)
        layers = {
            "": ("RGB", frame.color), "albedo.": ("RGB", frame.albedo),
            "normal.": ("XYZ", frame.normal), "depth.": ("Z", frame.depth[..., None]),
            "motion.": ("XY", frame.motion),
        }  # fmt: skip
        write_channels(
            folder / f"frame_{index:04d}.exr",
            {
                prefix + channel: image[..., place]
                for prefix, (channels, image) in layers.items()
                for place, channel in enumerate(channels)
            },
        )
    truth = clean_color(*SIZE)
    for index in references:
        write_channels(
            folder / f"ref_{index:04d}.exr", {c: truth[..., i] for i, c in enumerate("RGB")}
        )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two sequences; only the second has references of consecutive frames."""
    folder = tmp_path_factory.mktemp("validation")
    write_sequence(folder / "one", 3, [2])
    write_sequence(folder / "two", 5, [0, 2, 3])
    return folder


def run(folder, **options):
    given = {"model": ["wskp-3"], "peer": ["svgf"], "peers": True, "report": None, "pictures": None}
    out = folder / "scores.json"
    evaluate.main(folder, **{**given, **options, "out": out})
    return json.loads(out.read_text())


def test_peers_and_models_are_scored_on_every_scene(folder, capsys):
    scores = run(folder, peer=["svgf", "bmfr"])
    rows = {"noisy", "accumulated", "wskp-3", "wskp-3, one frame", "SVGF", "BMFR"}
    assert set(scores) == rows
    assert all(set(row) == {"one", "two"} for row in scores.values())
    for method in ("wskp-3", "SVGF", "BMFR"):
        assert scores[method]["two"]["psnr"] > scores["noisy"]["two"]["psnr"] + 5
    table = capsys.readouterr().out
    assert "| SVGF | " in table


def test_a_perfect_picture_is_estimated_from_the_references(folder):
    pytest.importorskip("pyoidn")
    scores = run(folder, peer=["oidn-fast"])
    method = "OIDN fast, fed the references"
    assert scores[method]["two"]["psnr"] > scores["OIDN fast"]["two"]["psnr"] + 3
    assert scores[method]["two"]["flicker"] < 0.5 * scores["OIDN fast"]["two"]["flicker"]


def test_flicker_needs_consecutive_references(folder, capsys):
    scores = run(folder)
    assert "flicker" in scores["SVGF"]["two"]
    assert "flicker" not in scores["SVGF"]["one"]
    tables = capsys.readouterr().out.strip().split("\n\n")
    assert ["flicker" in table.splitlines()[0] for table in tables] == [False, False, True]


def test_the_last_referenced_frame_counts_not_the_last_frame(folder):
    truth = clean_color(*SIZE).astype(np.float32)
    third, last = (
        metrics.evaluate([make_frame(*SIZE, index).color], [truth])["psnr"] for index in (3, 4)
    )
    assert abs(third - last) > 0.01
    # files hold half precision
    assert run(folder)["noisy"]["two"]["psnr"] == pytest.approx(third, abs=2e-3)


def test_a_peer_that_remembers_sees_the_frames_before(folder):
    stream = find_peer("svgf").make()
    images = [stream.denoise(read_exr(folder / "two" / f"frame_{i:04d}.exr")) for i in range(4)]
    reference = read_exr(folder / "two" / "ref_0003.exr").color
    expected = metrics.evaluate(images[-1:], [reference])["psnr"]
    # an opened model makes the thread take denormals for 0: half floats below 6e-5 read as black
    assert run(folder)["SVGF"]["two"]["psnr"] == pytest.approx(expected, abs=1e-4)


def test_svgf_alone_differs_from_the_second_frame_on_when_its_last_pass_has_a_past(folder):
    frames = [read_exr(folder / "two" / f"frame_{i:04d}.exr") for i in range(2)]
    whole, alone = find_peer("svgf").make(), find_peer("svgf-alone").make()
    first, second = ([stream.denoise(frame) for stream in (whole, alone)] for frame in frames)
    np.testing.assert_allclose(first[0], first[1], rtol=1e-3, atol=1e-5)
    assert np.abs(second[0] - second[1]).max() > 1e-2 * second[0].max()


def test_two_runs_give_the_same_scores(folder):
    assert run(folder) == run(folder)


def test_the_page_of_clean_input_says_what_was_measured(folder, tmp_path):
    page = tmp_path / "page.md"
    evaluate_clean.main(folder, model=["nbg-2x1"], peer=["svgf"], report=page, pictures=None)
    text = page.read_text()
    assert "48x40" in text
    assert "frames a sequence: 3 or 4" in text
    assert "No model was trained on such frames" in text
    rows = run(folder, model=["nbg-2x1"])
    assert f"| nbg-2x1 | {evaluate.mean_scores(rows)['nbg-2x1']['psnr']:.2f} |" in text


def test_no_peers_when_none_are_wanted(folder):
    assert "SVGF" not in run(folder, peer=None, peers=False)


def test_installed_peers_run_when_none_is_named(monkeypatch):
    svgf, bmfr = (peer for peer in PEERS if peer.name in ("svgf", "bmfr"))
    absent = dataclasses.replace(bmfr, module="no_such_module")
    monkeypatch.setattr(evaluate, "PEERS", (svgf, absent))
    assert evaluate.choose_peers(None) == ["svgf"]
    assert "bmfr" in evaluate.left_out(None)
    assert "pip install" in evaluate.left_out(None)
    assert "bmfr" not in evaluate.left_out(["svgf"])


def test_a_missing_metric_is_told_in_one_line_and_leaves_the_table(folder, capsys, monkeypatch):
    absent = [
        dataclasses.replace(metric, module="no_such_module", package="no-such-package")
        if metric.name == "flip"
        else metric
        for metric in metrics.METRICS
        if metric.is_installed
    ]
    monkeypatch.setattr(metrics, "METRICS", tuple(absent))
    monkeypatch.setattr(evaluate, "METRICS", tuple(absent))
    run(folder)
    shown = capsys.readouterr()
    told = [line for line in shown.err.splitlines() if "left out" in line]
    assert told == ["left out for want of a package: flip (pip install no-such-package)"]
    assert "FLIP" not in shown.out
    assert "PSNR" in shown.out


def test_an_unknown_peer_stops_before_any_work(folder, tmp_path):
    with pytest.raises(InputError, match=r"peer must be one of .*, got nlm"):
        run(folder, peer=["svgf", "nlm"], pictures=tmp_path / "pictures")
    assert not (tmp_path / "pictures").exists()


def test_a_reference_without_its_frame_is_refused(tmp_path):
    write_sequence(tmp_path / "cut", 2, [1, 4])
    with pytest.raises(
        InputError, match=r"a reference must have its frame, got none for frame_0004\.exr"
    ):
        run(tmp_path)


def test_a_folder_without_references_is_refused(tmp_path):
    write_sequence(tmp_path / "bare", 2, [])
    with pytest.raises(InputError, match="folder must hold sequences with references"):
        run(tmp_path)


def test_the_report_says_how_far_models_are_from_their_peers(folder, tmp_path):
    report = tmp_path / "results.md"
    scores = run(folder, model=["kpyr-5s", "nbg-2x3"], peer=["svgf"], report=report)
    mean = evaluate.mean_scores(scores)
    (row,) = (
        line for line in report.read_text().splitlines() if line.startswith("| nbg-2x3 against")
    )
    psnr, ssim, smape = (cell.strip() for cell in row.split("|")[2:5])
    for cell, name in ((psnr, "psnr"), (ssim, "ssim")):
        apart = mean["nbg-2x3"][name] - mean["SVGF"][name]
        assert float(cell.strip("*")) == pytest.approx(apart, rel=0.01)
        assert cell.startswith("**") == (apart < 0)
    ratio = mean["nbg-2x3"]["smape"] / mean["SVGF"]["smape"]
    assert smape.strip("*") == f"x {ratio:.3g}"
    assert smape.startswith("**") == (ratio > 1)
    assert '| kpyr-5s ("fast") against SVGF |' in report.read_text()

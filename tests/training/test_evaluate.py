from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

pytest.importorskip("flip_evaluator")
pytest.importorskip("skimage")

from stillray.compare import metrics
from stillray.errors import InputError
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.read import read_exr
from stillray_training.evaluate import __main__ as evaluate
from stillray_training.evaluate import methods, report, scores
from stillray_training.film import film_variance, through_film
from stillray_training.peers import PEERS, find_peer
from stillray_training.simulate.sequence import RECORD
from tests.conftest import clean_color, make_frame

SIZE = 40, 48
FAST = "psnr,ssim,smape,relmse,flip,edge,bias,flicker"  # all but ColorVideoVDP


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


def write_still(folder, scene, count, noise):
    """A frame of some samples a pixel: the truth, and the noise of one sample times ``noise``."""
    frame, truth = make_frame(*SIZE, count), clean_color(*SIZE)
    path = folder / "spp" / scene / str(count) / "frame_0002.exr"
    path.parent.mkdir(parents=True)
    color = truth + noise * (frame.color - truth)
    layers = {
        "": ("RGB", color),
        "albedo.": ("RGB", frame.albedo),
        "normal.": ("XYZ", frame.normal),
    }
    write_channels(
        path,
        {
            prefix + channel: image[..., place]
            for prefix, (channels, image) in layers.items()
            for place, channel in enumerate(channels)
        },
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two sequences; only the second has references of consecutive frames."""
    folder = tmp_path_factory.mktemp("validation")
    write_sequence(folder / "one", 3, [2])
    write_sequence(folder / "two", 5, [0, 2, 3])
    return folder


@pytest.fixture(scope="module")
def stills(tmp_path_factory):
    """A sequence, and its last frame with 4 and with 16 samples a pixel, all but clean."""
    folder = tmp_path_factory.mktemp("stills")
    write_sequence(folder / "one", 3, [2])
    write_still(folder, "one", 16, 0.001)
    write_still(folder, "one", 4, 0.5)
    return folder


def run_all(folder, **options):
    given = {"model": ["wskp-3s"], "peer": ["svgf"], "peers": True, "metrics": FAST}
    out = folder / "scores.json"
    evaluate.main([str(folder)], **{**given, **options, "out": out})
    return json.loads(out.read_text())


def run(folder, **options):
    return run_all(folder, **{"only": "sequences", **options})["sequences"]


def test_peers_and_models_are_scored_on_every_scene(folder, capsys):
    found = run(folder, peer=["svgf", "bmfr"])
    rows = {"noisy", "accumulated", "wskp-3s", "wskp-3s, one frame", "SVGF", "BMFR"}
    assert set(found) == rows
    assert all(set(row) == {"one", "two"} for row in found.values())
    for method in ("wskp-3s", "SVGF", "BMFR"):
        assert found[method]["two"]["psnr"] > found["noisy"]["two"]["psnr"] + 5
    table = capsys.readouterr().out
    assert "| SVGF | " in table


def test_models_that_can_are_scored_as_ensembles_too(stills):
    found = run_all(stills, only="stills", model=["kpyr-5s", "wskp-3s"], ensemble=2)
    rows = found["stills, 4 samples a pixel"]
    assert set(rows) == {"noisy", "kpyr-5s", "kpyr-5s, ensemble of 2", "wskp-3s"}
    assert rows["kpyr-5s, ensemble of 2"]["one"] != rows["kpyr-5s"]["one"]


def test_references_are_filtered_to_see_what_their_own_noise_leaves(folder):
    pytest.importorskip("pyoidn")
    found = run(folder, peer=["oidn-high"])
    floor, shown = (
        found[name]["two"]["psnr"] for name in ("OIDN high, the references", "OIDN high")
    )
    assert floor > shown + 3


def test_stills_are_measured_at_every_count_fewest_samples_first(stills):
    results = run_all(stills, only="stills")
    assert list(results) == ["stills, 4 samples a pixel", "stills, 16 samples a pixel"]
    four, sixteen = (results[title]["noisy"]["one"]["psnr"] for title in results)
    assert sixteen > four + 20
    # what remembers frames has nothing to remember
    assert set(results["stills, 4 samples a pixel"]) == {"noisy", "wskp-3s"}
    assert list(run_all(stills, only="stills", stills="16")) == ["stills, 16 samples a pixel"]


def test_fed_the_reference_a_model_sees_no_noise(stills):
    rows = run_all(stills, only="fed,stills")
    assert set(rows["fed the references"]) == {"wskp-3s"}
    fed = rows["fed the references"]["wskp-3s"]["one"]["psnr"]
    assert fed > rows["stills, 4 samples a pixel"]["wskp-3s"]["one"]["psnr"]


def test_a_sequence_with_all_references_is_measured_frame_by_frame(tmp_path):
    write_sequence(tmp_path / "shadow", 4, [0, 1, 2, 3])
    rows = run_all(tmp_path)["shadow"]
    assert set(rows) == {"noisy", "wskp-3s", "wskp-3s, one frame", "SVGF"}
    assert list(rows["noisy"]) == [f"frame {index}" for index in range(4)]
    truth = clean_color(*SIZE).astype(np.float32)
    for index in range(4):
        expected = metrics.evaluate([make_frame(*SIZE, index).color], [truth], names=["psnr"])[
            "psnr"
        ]
        # files hold half precision
        assert rows["noisy"][f"frame {index}"]["psnr"] == pytest.approx(expected, abs=2e-3)
    alone, past = rows["wskp-3s, one frame"], rows["wskp-3s"]
    assert alone["frame 0"] == past["frame 0"]
    assert past["frame 3"]["psnr"] > alone["frame 3"]["psnr"]
    assert "flicker" in past["frame 1"]
    assert "flicker" not in past["frame 0"]


def test_a_picture_worse_than_its_input_is_listed(stills, capsys):
    rows = run_all(stills, only="stills")["stills, 16 samples a pixel"]
    assert rows["wskp-3s"]["one"]["psnr"] < rows["noisy"]["one"]["psnr"]
    listed = capsys.readouterr().out.split("## Worse than the input")[1]
    (line,) = (line for line in listed.splitlines() if "16 samples a pixel" in line)
    assert line.startswith("| stills, 16 samples a pixel | one | wskp-3s | psnr ")
    assert "4 samples a pixel | one | wskp-3s | psnr" not in listed.replace("16", "")


def test_a_bias_counts_as_worse_only_beyond_a_percent():
    rows = {"noisy": {"one": {"bias": -0.2}, "two": {"bias": -0.2}, "three": {"bias": -3.0}}}
    rows["ours"] = {"one": {"bias": 0.9}, "two": {"bias": -1.1}, "three": {"bias": -2.0}}
    (found,) = scores.worse_than_input({"set": rows}, ["ours"])
    assert (found.case, found.metric.name, found.value, found.noisy) == ("two", "bias", -1.1, -0.2)


def test_peers_are_taken_from_a_former_run(stills):
    pytest.importorskip("pyoidn")
    first = run_all(stills, only="stills", peer=["oidn-fast"])
    former = stills / "former.json"
    changed = json.loads((stills / "scores.json").read_text())
    for values in changed.values():
        values["OIDN fast"]["one"]["psnr"] = 12.5
        values["wskp-3s"]["one"]["psnr"] = 1.5
    former.write_text(json.dumps(changed))
    second = run_all(stills, only="stills", peers=False, peers_from=former, metrics="psnr,smape")
    for title, rows in second.items():
        assert rows["OIDN fast"]["one"]["psnr"] == 12.5
        assert set(rows["OIDN fast"]["one"]) == {"psnr", "smape"}
        # models are never taken over
        assert rows["wskp-3s"]["one"]["psnr"] == first[title]["wskp-3s"]["one"]["psnr"]


def test_several_folders_have_sets_of_their_own(folder, stills, tmp_path):
    out = tmp_path / "scores.json"
    evaluate.main(
        [str(folder), f"Blender={stills}"], model=["nbg-2x1"], peers=False, only="sequences",
        metrics="psnr", out=out,
    )  # fmt: skip
    found = json.loads(out.read_text())
    assert list(found) == ["sequences", "Blender, sequences"]
    assert set(found["sequences"]["noisy"]) == {"one", "two"}


def test_a_still_without_its_reference_is_refused(tmp_path):
    write_sequence(tmp_path / "one", 2, [1])
    write_still(tmp_path, "one", 4, 1.0)
    with pytest.raises(InputError, match=r"a still must have a reference, got none at .*ref_0002"):
        run_all(tmp_path)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"only": "still"}, "only must be out of sequences, frames, stills, fed, got still"),
        ({"metrics": "psnr,mse"}, "metrics must be out of .*, got mse"),
        ({"stills": "4,x"}, "stills must be numbers such as 4,16, got 4,x"),
    ],
)
def test_a_wrong_choice_is_refused(folder, options, message):
    with pytest.raises(InputError, match=message):
        run_all(folder, **options)


def test_flicker_needs_consecutive_references(folder, capsys):
    found = run(folder)
    assert "flicker" in found["SVGF"]["two"]
    assert "flicker" not in found["SVGF"]["one"]
    headings = [line for line in capsys.readouterr().out.splitlines() if "PSNR" in line]
    assert ["flicker" in line for line in headings] == [False, False, True]


def test_the_last_referenced_frame_counts_not_the_last_frame(folder):
    truth = clean_color(*SIZE).astype(np.float32)
    third, last = (
        metrics.evaluate([make_frame(*SIZE, index).color], [truth], names=["psnr"])["psnr"]
        for index in (3, 4)
    )
    assert abs(third - last) > 0.01
    # files hold half precision
    assert run(folder)["noisy"]["two"]["psnr"] == pytest.approx(third, abs=2e-3)


def test_a_peer_that_remembers_sees_the_frames_before(folder):
    stream = find_peer("svgf").make()
    images = [stream.denoise(read_exr(folder / "two" / f"frame_{i:04d}.exr")) for i in range(4)]
    reference = read_exr(folder / "two" / "ref_0003.exr").color
    expected = metrics.evaluate(images[-1:], [reference], names=["psnr"])["psnr"]
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


def test_no_peers_when_none_are_wanted(folder):
    assert "SVGF" not in run(folder, peer=None, peers=False)


def test_installed_peers_run_when_none_is_named(monkeypatch):
    svgf, bmfr = (peer for peer in PEERS if peer.name in ("svgf", "bmfr"))
    absent = dataclasses.replace(bmfr, module="no_such_module")
    monkeypatch.setattr(methods, "PEERS", (svgf, absent))
    assert methods.choose_peers(None) == ["svgf"]
    assert "bmfr" in methods.left_out(None)
    assert "pip install" in methods.left_out(None)
    assert "bmfr" not in methods.left_out(["svgf"])


def test_a_missing_metric_is_told_in_one_line_and_leaves_the_table(folder, capsys, monkeypatch):
    absent = [
        dataclasses.replace(metric, module="no_such_module", package="no-such-package")
        if metric.name == "flip"
        else metric
        for metric in metrics.METRICS
        if metric.is_installed
    ]
    monkeypatch.setattr(metrics, "METRICS", tuple(absent))
    for module in (methods, report, scores):
        monkeypatch.setattr(module, "METRICS", tuple(absent))
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
    page = tmp_path / "results.md"
    mean = scores.mean_scores(run(folder, model=["kpyr-5s", "nbg-2x3"], report=page))
    (row,) = (
        line for line in page.read_text().splitlines() if line.startswith("| nbg-2x3 against")
    )
    psnr, ssim, smape = (cell.strip() for cell in row.split("|")[2:5])
    for cell, name in ((psnr, "psnr"), (ssim, "ssim")):
        apart = mean["nbg-2x3"][name] - mean["SVGF"][name]
        assert float(cell.strip("*")) == pytest.approx(apart, rel=0.01)
        assert cell.startswith("**") == (apart < 0)
    ratio = mean["nbg-2x3"]["smape"] / mean["SVGF"]["smape"]
    assert smape.strip("*") == f"x {ratio:.3g}"
    assert smape.startswith("**") == (ratio > 1)
    assert '| kpyr-5s ("fast") against SVGF |' in page.read_text()


@pytest.mark.parametrize(
    ("option", "expected"), [("box", [0.5, 12**-0.5]), (None, [0.5, None]), ("none", [None, None])]
)
def test_models_are_told_the_filter_that_files_have_then_the_one_that_is_named(
    tmp_path, option, expected
):
    write_sequence(tmp_path / "a", 1, [0])
    write_sequence(tmp_path / "b", 1, [0])
    path = tmp_path / "a" / "frame_0000.exr"
    frame = read_exr(path)
    write_channels(
        path,
        {c: frame.color[..., i] for i, c in enumerate("RGB")},
        attributes={"stillray:pixelFilter": "gaussian:2"},
    )
    cases = evaluate.find_all([str(tmp_path)], pixel_filter=option)
    told = [case.read()[0][-1].filter_spread for case in cases]
    assert told == [each and pytest.approx(each) for each in expected]


def test_models_are_told_the_samples_that_files_say_then_those_of_the_record(tmp_path):
    for name in "abc":
        write_sequence(tmp_path / name, 1, [0])
    path = tmp_path / "a" / "frame_0000.exr"
    color = read_exr(path).color
    planes = {c: color[..., i] for i, c in enumerate("RGB")}
    write_channels(path, planes, attributes={"stillray:samples": 4.0})
    for name in "ab":
        (tmp_path / name / RECORD).write_text(json.dumps({"options": {"spp": 16}}))
    told = [case.read()[0][-1].samples for case in evaluate.find_all([str(tmp_path)])]
    assert told == [4, 16, None]


def test_frames_and_references_go_through_a_film_whose_samples_count_in_several_pixels(tmp_path):
    write_sequence(tmp_path / "a", 2, [1])
    plain, soft = (
        evaluate.find_all([str(tmp_path)], pixel_filter="box", film=film)[0].read()
        for film in (0.0, 0.5)
    )
    for before, after in ((plain[0][-1].color, soft[0][-1].color), (plain[1][0], soft[1][0])):
        np.testing.assert_allclose(after, through_film(before, 0.5))
        assert np.abs(np.diff(after, axis=0)).mean() < np.abs(np.diff(before, axis=0)).mean()
    assert plain[0][-1].filter_spread == pytest.approx(12**-0.5)
    assert soft[0][-1].filter_spread == pytest.approx((1 / 12 + film_variance(0.5)) ** 0.5)


def test_buffers_can_be_kept_from_what_denoises(tmp_path):
    write_sequence(tmp_path / "a", 2, [1])
    whole, bare = (
        evaluate.find_all([str(tmp_path)], without=without)[0].read()[0][-1]
        for without in ((), ("albedo", "depth"))
    )
    assert whole.albedo is not None
    assert (bare.albedo, bare.depth) == (None, None)
    np.testing.assert_array_equal(bare.normal, whole.normal)
    np.testing.assert_array_equal(bare.color, whole.color)
    assert evaluate.withheld("albedo,depth") == ["albedo", "depth"]
    with pytest.raises(InputError, match=r"without must be out of albedo, .*, got color"):
        evaluate.withheld("color")


@pytest.mark.parametrize("film", [-0.1, 1.5, float("nan")])
def test_a_film_of_no_width_is_refused(tmp_path, film):
    with pytest.raises(InputError, match="film must be 0 to 1 pixels"):
        evaluate.find_all([str(tmp_path)], film=film)

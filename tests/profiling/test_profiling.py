from __future__ import annotations

import dataclasses
import itertools
import json

import cv2
import numpy as np
import pytest

import stillray
from stillray import cli
from stillray.arrays.strips import planes_of
from stillray.errors import InputError
from stillray.io.exr.read import read_exr
from stillray.model_spec import load
from stillray.models.registry import find_model
from stillray.profiling import measure as measuring
from stillray.profiling import plot, results, scaling
from stillray.profiling.clip import Clip, open_clip, write_frame
from stillray.profiling.cost import Cost
from stillray.profiling.machine import PeakRates
from stillray.profiling.measure import ORDER, REST, TOTAL, Run, Setting, Summary, measure
from stillray.profiling.results import Result
from stillray.profiling.scaling import Curve, fitted_exponent, in_words
from stillray.profiling.synthetic import swing, tiled
from stillray.stages import reproject as rep

SIZE = 36, 64


def test_made_up_frames_are_the_same_each_time_and_hold_what_is_hard():
    first, second = swing(90, 160)
    again = swing(90, 160)[0]
    np.testing.assert_array_equal(first.color, again.color)
    assert (first.color != second.color).any()
    assert first.shape == (90, 160)
    assert np.isfinite(first.color).all()
    lit = first.color.max(axis=-1)
    assert 0.3 < (lit == 0).mean() < 0.7  # paths that found no light
    assert lit.max() > 100 * np.median(lit[lit > 0])  # fireflies
    background = first.depth == 0
    assert 0 < background.mean() < 0.1
    assert (first.albedo[background] == 0).all()
    assert (first.normal[background] == 0).all()
    mirror = ~background & (first.albedo.max(axis=-1) == 0)
    assert mirror.any()
    length = np.linalg.norm(first.normal[~background], axis=-1)
    np.testing.assert_allclose(length, 1, atol=1e-3)


def test_the_motion_of_made_up_frames_leads_to_the_other_frame():
    # the albedo of what moved is found where the motion says: but for what was hidden
    for now, before in itertools.permutations(swing(180, 320)):
        positions = rep.positions_of(now.motion, slice(0, 180))
        inside = (positions >= 0).all(axis=-1) & (positions <= (319, 179)).all(axis=-1)
        found = cv2.remap(before.albedo, positions, None, cv2.INTER_LINEAR)
        moved = np.abs(found - now.albedo).max(axis=-1)[inside]
        stood = np.abs(before.albedo - now.albedo).max(axis=-1)[inside]
        assert np.mean(moved > 0.2) < 0.4 * np.mean(stood > 0.2)
        assert np.median(moved) < 0.1 * np.median(stood)
        assert np.abs(now.motion).max() > 1


def test_made_up_surfaces_keep_their_history_and_what_is_uncovered_has_none(spec):
    now, before = swing(180, 320)
    rows = slice(0, 180)
    positions = rep.positions_of(now.motion, rows)
    previous = rep.PreviousFrame(
        np.ones((180, 320, 4), np.float32),
        rep.pack(before.normal, before.depth),
        np.ones((181, 321), np.uint8),
    )
    kept = rep.reproject(
        previous,
        planes_of(rep.pack(now.normal, now.depth)),
        positions,
        rows,
        spec.temporal,
    )[..., 3]
    assert np.mean(kept > 0.5) > 0.85
    assert 1e-4 < np.mean(kept[20:-20, 20:-20] == 0) < 0.05


def test_tiling_repeats_and_cuts_every_buffer():
    frame = swing(*SIZE)[0]
    wide = tiled(frame, 50, 150)
    assert wide.shape == (50, 150)
    for name in ("color", "albedo", "normal", "depth", "motion"):
        small, large = getattr(frame, name), getattr(wide, name)
        np.testing.assert_array_equal(large[:36, 64:128], small)
        np.testing.assert_array_equal(large[36:, 128:150], small[:14, :22])
    assert tiled(frame, *SIZE) is frame


def test_a_clip_of_files_ends_with_a_cut_and_made_up_frames_do_not(tmp_path):
    for index, frame in enumerate(swing(*SIZE)):
        write_frame(tmp_path / f"shot.{index:04d}.exr", frame)
    clip = open_clip(str(tmp_path / "shot.####.exr"))
    assert [clip.frame(turn)[1] for turn in range(5)] == [True, False, True, False, True]
    assert clip.path == tmp_path / "shot.0000.exr"
    np.testing.assert_allclose(clip.frames[1].depth, swing(*SIZE)[1].depth, rtol=1e-3)
    made_up = open_clip(size=SIZE)
    assert [made_up.frame(turn)[1] for turn in range(4)] == [True, False, False, False]
    cut = open_clip(str(tmp_path / "shot.####.exr"), (20, 70))
    assert cut.shape == (20, 70)
    assert cut.path is None  # the file is not what is denoised


def test_percentiles_are_values_that_were_measured():
    values = [float(v) for v in np.random.default_rng(0).permutation(200)]
    got = Summary.of(values)
    assert got == Summary(median=99.5, p95=190.0, p99=198.0, worst=199.0)
    assert Summary.of([7.0]) == Summary(median=7.0, p95=7.0, p99=7.0, worst=7.0)


def test_made_up_frames_have_second_halves_for_models_that_learn_from_both():
    clip = open_clip(size=SIZE)
    halves = clip.for_model(load("online")).frames
    for frame in halves:
        assert frame.color_b.shape == frame.color.shape
        assert np.abs(frame.color_b - frame.color).mean() > 0.1  # noise of its own
        assert abs(np.median(frame.color_b) - np.median(frame.color)) < 0.1  # of the same light
    assert all("color_b" not in frame.given for frame in clip.for_model(load("kpyr-5")).frames)


def test_cuts_are_not_counted_as_warm_frames(monkeypatch):
    class Recorder:
        temporal, precision = True, "float32"

        def __init__(self):
            self.model = find_model("fast")
            self.seen, self.last_timings = [], {"network": 0.0}

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def reset(self):
            self.seen.append("cut")

        def denoise(self, frame):
            self.seen.append(frame)
            return frame.color

    recorder = Recorder()
    monkeypatch.setattr(measuring, "open_denoiser", lambda setting: recorder)
    first, second = swing(*SIZE)
    clip = Clip(frames=(first, second), endless=False)
    setting = Setting(model="fast", height=36, width=64, threads=1)
    (run,) = measure([setting], clip, 0, files=False)
    # one first frame, two that settle, and three that are warm, each after its cut
    assert len(run.warm) == 3
    assert recorder.seen.count("cut") == recorder.seen.count(first)
    assert recorder.seen[-1] is second
    assert recorder.seen.count(second) == 4


def test_settings_are_measured_in_turn_and_nothing_is_unaccounted_for():
    settings = [
        Setting(model="fast", height=36, width=64, threads=1, temporal=temporal)
        for temporal in (True, False)
    ]
    rounds = []
    runs = measure(settings, open_clip(size=SIZE), 0, progress=rounds.append)
    assert rounds == [1, 2, 3]
    with_past, alone = (run.stages() for run in runs)
    assert {"reproject", "accumulate", "read", "write", REST} <= set(with_past)
    assert "reproject" not in alone
    assert list(with_past) == [name for name in (*ORDER, TOTAL) if name in with_past]
    for run in runs:
        for row in (run.first, *run.warm):
            parts = sum(value for name, value in row.items() if name != TOTAL)
            assert parts == pytest.approx(row[TOTAL])


def _result(model="fast", temporal=True):
    stages = {"network": 30.0, "reconstruct": 12.0, REST: 1.0, TOTAL: 43.0}
    run = Run(
        setting=Setting(model=model, height=720, width=1280, threads=2, temporal=temporal),
        info=find_model(model),
        buffers=("color",),
        load=5.0,
        load_busy=1.0,
        first=stages,
        warm=[stages, {name: 2 * value for name, value in stages.items()}],
        files={"read": [9.0], "write": [8.0]},
    )
    work = {
        "network": Cost(operations=2e9, bytes=1e6),
        "reconstruct": Cost(operations=1e6, bytes=4e6),
    }
    return Result(run=run, work=work, peaks=PeakRates(operations=1e11, bandwidth=1e9), memory=None)


def test_the_floor_of_a_frame_is_that_of_its_stages():
    result = _result()
    assert result.roofline("network") == pytest.approx(20)
    assert result.roofline("reconstruct") == pytest.approx(4)
    assert result.roofline(REST) is None
    assert result.roofline(TOTAL) == pytest.approx(24)


def test_a_profile_is_drawn(tmp_path):
    matplotlib = pytest.importorskip("matplotlib")
    path = tmp_path / "profile.png"
    plot.draw_profile([_result(), _result("high", temporal=False)], path)
    image = cv2.imread(str(path))
    assert image.shape[1] > 600
    # a stage has its colour whatever else runs; the network's bar is the wider
    palette = [c for kind in ("tab20", "tab20b") for c in matplotlib.colormaps[kind].colors]
    network, reconstruct = (
        np.round(255 * np.array(palette[ORDER.index(name)])) for name in ("network", "reconstruct")
    )
    wide, narrow = (
        int((np.abs(image[..., ::-1] - colour).max(axis=-1) < 3).sum())
        for colour in (network, reconstruct)
    )
    assert wide > 2 * narrow > 0


def test_without_matplotlib_a_plot_is_refused_before_anything_is_measured(monkeypatch, capsys):
    monkeypatch.setattr(plot, "find_spec", lambda name: None)
    assert cli.main(["profile", "--plot", "x.png"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "pip install 'stillray[compare]'" in error


@pytest.fixture
def known_peaks(monkeypatch):
    """Rates of a machine that are not measured, which takes seconds."""
    peaks = PeakRates(operations=1e11, bandwidth=1e10)
    monkeypatch.setattr(results, "measure_peak_rates", lambda threads: peaks)


def test_profile_reports_every_stage_as_json(capsys):
    options = [
        "profile",
        "--model",
        "wskp-3s",
        "--size",
        "64x36",
        "--threads",
        "1",
        "--seconds",
        "0",
    ]
    assert cli.main([*options, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    (run,) = facts["runs"]
    assert (run["model"], run["height"], run["width"], run["threads"]) == ("wskp-3s", 36, 64, 1)
    assert run["buffers"] == ["albedo", "color", "depth", "motion", "normal"]
    assert run["memory_mib"]["peak"] > run["memory_mib"]["net"] > 0
    network = run["stages"]["network"]
    products = 36 * 8 * 32 + 9 * (32 * 32 + 32 * 4 * 12)  # of 2x2 pixels
    assert network["operations"] == 2 * products * 18 * 32
    roofline = 1e3 * network["operations"] / run["peaks"]["operations"]
    assert network["roofline"] == pytest.approx(roofline)
    assert network["ratio"] == pytest.approx(network["median"] / roofline)
    assert network["median"] <= network["p95"] <= network["p99"] <= network["worst"]


@pytest.mark.usefixtures("known_peaks")
def test_profile_reports_every_stage_as_a_table(capsys):
    (run,) = profiled(capsys, "--model", "wskp-3s")["runs"]
    options = ["--model", "wskp-3s", "--size", "64x36", "--threads", "1", "--seconds", "0"]
    assert cli.main(["profile", *options, "--no-memory"]) == 0
    table = capsys.readouterr().out
    assert "wskp-3s, 64 x 36, 1 thread" in table
    for stage in run["stages"]:
        assert stage in table


@pytest.mark.usefixtures("known_peaks")
def test_models_of_the_qualities_are_profiled_unless_others_are_asked_for(capsys):
    names = {
        chosen: [row["model"] for row in profiled(capsys, *options)["runs"]]
        for chosen, options in (("", ()), ("all", ("-m", "all")), ("one", ("-m", "wskp-3s")))
    }
    qualities = {find_model(quality).name for quality in ("fast", "balanced", "high")}
    assert set(names[""]) == qualities
    assert set(names["all"]) == {info.name for info in stillray.list_models()}
    assert names["one"] == ["wskp-3s"]


@pytest.mark.usefixtures("known_peaks")
def test_ensembles_are_profiled_one_beside_the_other(capsys):
    once, thrice = profiled(capsys, "-m", "kpyr-5s", "--ensemble", "1", "--ensemble", "3")["runs"]
    assert (once["ensemble"], thrice["ensemble"]) == (1, 3)
    for stage in ("network", "reconstruct"):
        work = [run["stages"][stage]["operations"] for run in (once, thrice)]
        assert work[1] == 3 * work[0]
    assert thrice["stages"]["encode"]["operations"] == once["stages"]["encode"]["operations"]


def profiled(capsys, *options):
    """The JSON of a profile of small frames."""
    given = ["--size", "48x32", "--seconds", "0", "--no-memory", "--json", *options]
    assert cli.main(["profile", *given]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.usefixtures("known_peaks")
def test_a_user_s_own_file_is_profiled_at_its_size(tmp_path, capsys):
    frame = swing(*SIZE)[0]
    write_frame(tmp_path / "a.exr", stillray.Frame(color=frame.color))
    options = ["--model", "wskp-3s", "--seconds", "0", "--no-memory", "--json"]
    assert cli.main(["profile", str(tmp_path / "a.exr"), *options]) == 0
    (run,) = json.loads(capsys.readouterr().out)["runs"]
    assert (run["height"], run["width"]) == SIZE
    assert run["buffers"] == ["color"]
    assert "reproject" not in run["stages"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--size", "720"], "size must be WIDTHxHEIGHT in pixels, 1 to 32768 each, got 720"),
        (["--size", "0x9"], "size must be WIDTHxHEIGHT in pixels, 1 to 32768 each, got 0x9"),
        (["--threads", "0"], "threads must be 1 or more, got 0"),
        (["--ensemble", "2", "-m", "wskp-3"], "ensemble must be 1 with wskp-3, got 2"),
        (["--provider", "Nonsense"], "providers must be among"),
        (["--model", "slow"], "model must be one of"),
        (["none.exr"], "none.exr: no such file"),
        (["--plot", "no/folder.png"], "plot must be in a folder that exists, got no/folder.png"),
        (["--scaling", "a.exr"], "--scaling makes its own frames up, got the input a.exr"),
        (["--scaling", "--model", "fast", "--model", "high"], "--scaling takes one model"),
    ],
)
def test_a_wrong_option_is_told_in_one_line(options, message, capsys):
    assert cli.main(["profile", *options]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_an_exponent_is_that_of_the_power_law():
    values = [1.0, 2.0, 4.0, 10.0]
    assert fitted_exponent(values, [3 * v**1.3 for v in values]) == pytest.approx(1.3)
    assert fitted_exponent([2.0], [1.0]) is None
    assert fitted_exponent(values, [0.0, 1, 2, 3]) is None


def test_a_curve_says_its_exponent_and_its_ends(tmp_path):
    curve = Curve(
        name="pixels",
        subject="a warm frame",
        values=[1.0, 4.0],
        labels=["small", "large"],
        milliseconds=[10.0, 20.0],
        memory=[1.0, 4.0],
        left_out="8K would not fit",
    )
    assert in_words(curve) == (
        "a warm frame: time ~ pixels^0.50, memory ~ pixels^1.00; "
        "small 10.0 ms, large 20.0 ms (2.00 times); 8K would not fit"
    )
    pytest.importorskip("matplotlib")
    plot.draw_curves([dataclasses.replace(curve, memory=[])] * 3 + [curve], tmp_path / "c.png")
    assert cv2.imread(str(tmp_path / "c.png")).shape[1] > 600


def test_sizes_that_memory_does_not_allow_are_left_out(monkeypatch):
    taken = []

    def alone(setting, seconds):
        taken.append((setting.height, setting.width))
        memory = measuring.Memory(peak=setting.height * setting.width, net=1.0)
        return float(setting.height * setting.width), memory

    monkeypatch.setattr(scaling, "measure_alone", alone)
    monkeypatch.setattr(scaling, "available_memory", lambda: 1000.0)
    curve = scaling.against_pixels("fast", [(10, 10), (20, 20), (30, 30), (9, 9)], threads=1)
    assert taken == [(10, 10), (20, 20)]  # 900 would be more than its share of 1000
    assert "30 x 30 would not fit" in curve.left_out
    assert curve.exponent == pytest.approx(1)


def test_any_number_and_size_of_kernels_goes_through_the_real_reconstruction(monkeypatch):
    seen = []

    class Spy(scaling.FusedKernelsModel):
        def reconstruct(self, light, outputs, strips, timings):
            image = super().reconstruct(light, outputs, strips, timings)
            sizes = self.spec.decoder.kernel_sizes
            seen.append((sizes, len(outputs[0]), np.isfinite(image).all()))
            return image

    monkeypatch.setattr(scaling, "FusedKernelsModel", Spy)
    times = scaling.time_reconstruction([(3,), (31,), (3, 5, 7)], threads=1, size=SIZE, rounds=1)
    assert len(times) == 3
    assert min(times) > 0
    assert set(seen) == {((3,), 2, True), ((31,), 2, True), ((3, 5, 7), 6, True)}


def test_written_frames_read_back(tmp_path):
    frame = swing(*SIZE)[0]
    write_frame(tmp_path / "a.exr", frame)
    back = read_exr(tmp_path / "a.exr")
    for name in ("albedo", "normal", "depth", "motion"):
        np.testing.assert_allclose(getattr(back, name), getattr(frame, name), rtol=1e-3, atol=1e-3)


def test_bad_kernels_of_another_family_are_refused():
    with pytest.raises(InputError, match="must be of the weight-sharing kernels, got kpyr-5"):
        scaling.with_kernels(find_model("kpyr-5").spec, (3,))

"""A frame graph where a model is named, in `stillray.Denoiser` and from files to files: all stages
run where a provider runs them, and the state is kept there.

The CPU is a provider as any other: bindings and states go the same way, in main memory.
"""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import onnx  # noqa: E402

import stillray  # noqa: E402
from stillray.batch.api import ShotOptions, plan_run  # noqa: E402
from stillray.batch.chunks import denoise_chunk, split  # noqa: E402
from stillray.cli import main  # noqa: E402
from stillray.errors import InputError  # noqa: E402
from stillray.frame import Frame  # noqa: E402
from stillray.io.exr.new_file import write_channels  # noqa: E402
from stillray.io.exr.read import read_exr, read_picture  # noqa: E402
from stillray.models.frame_graph import PORTS_KEY  # noqa: E402
from stillray.models.frame_session import FrameSession, device_of  # noqa: E402
from stillray.models.registry import with_overrides  # noqa: E402
from stillray.profiling import report, results  # noqa: E402
from stillray.profiling.machine import PeakRates  # noqa: E402
from stillray_export.frame_graph.moving import sequence  # noqa: E402

NAME = "kpyr-5s"
CPU = "CPUExecutionProvider"
CUT = 5  # of the sequence
ROOM = Path(__file__).parents[2] / "data" / "room"
CUT_IN_FILES = 3  # the number of a frame of `shot`
#: dB of tone-mapped pictures
PARITY = 80


@pytest.fixture(scope="module")
def path(frame_graph):
    return frame_graph(NAME)


@pytest.fixture(scope="module")
def opened(path):
    with stillray.Denoiser(path, threads=1, providers=[CPU]) as made:
        yield made


@pytest.fixture
def denoiser(opened):
    """At its first frame: to open the graph takes longer than most of what is asked of it."""
    opened.state = None
    return opened


class Spy:
    """An engine that keeps what went through it."""

    def __init__(self, engine):
        self.engine, self.runs = engine, []

    def run(self, graph, inputs):
        outputs = self.engine.run(graph, inputs)
        self.runs.append((inputs, outputs))
        return outputs

    def close(self):
        self.engine.close()


def decibels(got, wanted):
    got, wanted = (image / (1 + image) for image in (got, wanted))
    return -10 * np.log10(np.square(got - wanted).mean() + 1e-30)


def test_a_sequence_with_a_cut_is_that_of_the_stages(denoiser):
    with stillray.Denoiser(NAME, threads=1, precision="float32") as stages:
        for index, frame in enumerate(sequence(CUT + 2, 33, 47)):
            if index == CUT:
                denoiser.reset()
                stages.reset()
            assert decibels(denoiser.denoise(frame), stages.denoise(frame)) > PARITY


@pytest.mark.parametrize("spread", [12**-0.5, 0.35, 0.42, 1.0])
def test_the_pixel_filter_is_told(denoiser, spread):
    with stillray.Denoiser(NAME, threads=1, precision="float32") as stages:
        for frame in sequence(2, 33, 47):
            told = replace(frame, filter_spread=spread)
            assert decibels(denoiser.denoise(told), stages.denoise(told)) > PARITY


def test_a_soft_pixel_filter_changes_the_picture_and_a_box_does_not(denoiser):
    (frame,) = sequence(1, 33, 47)
    pictures = {}
    for spread in (None, 12**-0.5, 0.42):
        denoiser.reset()
        pictures[spread] = denoiser.denoise(replace(frame, filter_spread=spread))
    np.testing.assert_array_equal(pictures[None], pictures[12**-0.5])
    assert decibels(pictures[None], pictures[0.42]) < PARITY


def test_it_says_where_it_runs_and_what_it_says_is_what_runs(denoiser):
    first, second = sequence(2, 17, 20)
    for frame, state in ((first, "begins anew: first frame"), (second, "goes on")):
        (stage,) = denoiser.stages(frame)
        assert stage.runs
        assert f"in one graph on {CPU}, its state kept in main memory" in stage.reason
        assert state in stage.reason
        denoiser.denoise(frame)
        assert set(denoiser.last_timings) == {stage.name}


def test_the_state_is_handed_on_as_it_was_left_and_the_rest_are_arrays(path):
    engine = Spy(FrameSession(path, threads=1, providers=(CPU,)))
    with stillray.Denoiser(path, engine=engine) as denoiser:
        for frame in sequence(2, 17, 20):
            denoiser.denoise(frame)
    engine.close()
    (_, left), (given, _) = engine.runs
    states = {name for name in given if name.startswith("past_")}
    assert len(states) >= 5
    for name, value in given.items():
        if name in states:
            assert value is left[name.replace("past_", "next_")]
            assert not isinstance(value, np.ndarray)
        else:
            assert isinstance(value, np.ndarray)


def test_a_state_that_was_kept_gives_the_same_picture_again(denoiser):
    first, second, third = sequence(3, 17, 20)
    kept = denoiser.denoise(first)
    copy, state = kept.copy(), denoiser.state
    wanted = denoiser.denoise(second)
    denoiser.denoise(third)
    denoiser.state = state
    np.testing.assert_array_equal(denoiser.denoise(second), wanted)
    np.testing.assert_array_equal(kept, copy)


def test_what_a_frame_lacks_and_what_begins_anew(path, denoiser):
    first, second = sequence(2, 25, 30)
    flat = Frame(color=first.color, motion=first.motion, samples=4)
    with stillray.Denoiser(NAME, threads=1, precision="float32") as stages:
        assert decibels(denoiser.denoise(flat), stages.denoise(flat)) > PARITY
        (stage,) = denoiser.stages(second)
        assert "normal or depth were given in one" in stage.reason
        stages.reset()
        assert decibels(denoiser.denoise(second), stages.denoise(second)) > PARITY
    larger = sequence(1, 26, 30)[0]
    assert "a new size" in denoiser.stages(larger)[0].reason
    with stillray.Denoiser(path, threads=1, temporal=False) as alone:
        np.testing.assert_array_equal(alone.denoise(second), alone.denoise(second))


def test_other_layers_and_other_settings_are_refused(denoiser):
    (frame,) = sequence(1, 9, 9)
    with pytest.raises(InputError, match=f"layers must be none with {NAME}"):
        denoiser.denoise_layers(frame, {"diffuse": frame.color})
    with pytest.raises(InputError, match="must be a network to have other settings"):
        with_overrides(denoiser.model, max_samples=4)


def test_profile_tells_time_size_and_nodes_of_a_graph(path, tmp_path, capsys, monkeypatch):
    peaks = PeakRates(operations=1e11, bandwidth=1e10)
    monkeypatch.setattr(results, "measure_peak_rates", lambda threads: peaks)
    measured, as_dict = [], report.as_dict
    monkeypatch.setattr(report, "as_dict", lambda *told: measured.append(told[0]) or as_dict(*told))
    plot = tmp_path / "plot.png"
    options = ["--size", "33x17", "--threads", "1", "--seconds", "0", "--no-memory", "--json"]
    command = ["profile", "-m", str(path), "--provider", CPU, "--plot", str(plot)]
    assert main([*command, *options]) == 0
    (run,) = json.loads(capsys.readouterr().out)["runs"]
    assert (run["model"], run["provider"]) == (f"{NAME}.frame", CPU)
    assert set(run["stages"]) == {"read", "frame", "rest", "total", "write"}
    assert run["stages"]["frame"]["median"] > 0.5 * run["stages"]["total"]["median"]
    nodes = Counter(node.op_type for node in onnx.load_model(str(path)).graph.node)
    assert run["operators"] == nodes
    assert run["size_bytes"] == path.stat().st_size
    ((result,),) = measured
    told = " ".join(report.remarks(result))
    ((commonest, count),) = nodes.most_common(1)
    assert f"{nodes.total()} nodes: {count} {commonest}" in told
    assert "roofline" not in told
    assert plot.stat().st_size


def test_where_there_is_no_graph_it_says_how_to_make_one(tmp_path):
    with pytest.raises(InputError, match=r"stillray-export kpyr-5 --frame-graph makes it"):
        stillray.Denoiser(tmp_path / "kpyr-5.frame.onnx", providers=[CPU])


def test_providers_that_are_not_there_are_refused(path):
    with pytest.raises(InputError, match=r"providers must be among .*, got NoSuchProvider"):
        stillray.Denoiser(path, providers=["NoSuchProvider"])


def _with_operator(model, operator, domain=""):
    model.graph.node.append(onnx.helper.make_node(operator, ["color"], ["more"], domain=domain))


def _with_graph(model):
    inner = onnx.helper.make_graph([], "inner", [], [])
    model.graph.node.append(onnx.helper.make_node("If", ["color"], ["x"], then_branch=inner))


def _with_tensor_elsewhere(model):
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = onnx.TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="/etc/passwd")


def _with_port(model, **changes):
    (entry,) = (part for part in model.metadata_props if part.key == PORTS_KEY)
    told = json.loads(entry.value)
    told["inputs"][1].update(changes)
    entry.value = json.dumps(told)


@pytest.mark.parametrize(
    ("bend", "message"),
    [
        (lambda model: _with_operator(model, "NonZero"), "operators that no export .*NonZero"),
        (lambda model: _with_operator(model, "Add", "mine"), "the operator Add of mine"),
        (_with_graph, "not a usable frame graph: its attribute holds field"),
        (_with_tensor_elsewhere, "not a usable frame graph: its tensor holds field"),
        (lambda model: _with_port(model, name="given"), "buffers of a frame, takes given"),
        (lambda model: _with_port(model, neutral="nought"), "neutral number, got nought"),
        (lambda model: _with_port(model, shape="height, width, 10000000000"), "channels at most"),
        (lambda model: _with_port(model, next="next_albedo_"), "must give next_albedo_"),
    ],
)
def test_bent_graphs_are_refused_in_one_line(path, tmp_path, bend, message):
    model = onnx.load_model(str(path))
    bend(model)
    bent = tmp_path / "bent.frame.onnx"
    bent.write_bytes(model.SerializeToString())
    with pytest.raises(InputError, match=message) as found:
        stillray.Denoiser(bent)
    assert "\n" not in str(found.value)


@pytest.mark.parametrize(
    ("providers", "device"),
    [
        (None, ("cpu", 0)),
        ([CPU], ("cpu", 0)),
        (["CUDAExecutionProvider", CPU], ("cuda", 0)),
        ([("CUDAExecutionProvider", {"device_id": "1"})], ("cuda", 1)),
        ([("DmlExecutionProvider", {"device_id": 2})], ("dml", 2)),
        (["CoreMLExecutionProvider"], ("cpu", 0)),
    ],
)
def test_the_state_is_kept_where_the_first_provider_keeps_tensors(providers, device):
    assert device_of(providers) == device


def turned(frame):
    """The frame as in a mirror, motion too."""
    buffers = {name: getattr(frame, name)[:, ::-1] for name in ("color", "albedo", "normal")}
    motion = frame.motion[:, ::-1] * np.float32([-1, 1])
    return replace(frame, **buffers, depth=frame.depth[:, ::-1], motion=motion)


@pytest.fixture
def shot(tmp_path, monkeypatch):
    """Four frames with a cut in the middle, in the current folder; large enough to find it."""
    monkeypatch.chdir(tmp_path)
    for number in range(1, 5):
        frame = read_exr(ROOM / f"frame_{number:04d}.exr")
        frame = turned(frame) if number >= CUT_IN_FILES else frame
        channels = {name: frame.color[..., i] for i, name in enumerate("RGB")}
        channels |= {f"albedo.{name}": frame.albedo[..., i] for i, name in enumerate("RGB")}
        channels |= {f"normal.{name}": frame.normal[..., i] for i, name in enumerate("XYZ")}
        channels |= {f"motion.{name}": frame.motion[..., i] for i, name in enumerate("XY")}
        channels |= {"depth.Z": frame.depth}
        cropped = {name: np.ascontiguousarray(plane[:96, :144]) for name, plane in channels.items()}
        write_channels(tmp_path / f"shot.{number}.exr", cropped)
    return tmp_path


def run(path, *options):
    command = ["denoise", "shot.#.exr", "-o", "clean.#.exr", "-m", str(path), "--threads", "1"]
    return main([*command, *options])


def events(capsys):
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def pictures():
    return [read_picture(f"clean.{number}.exr") for number in range(1, 5)]


def test_files_with_a_cut_are_those_of_the_denoiser_also_in_parts(path, shot, denoiser, capsys):
    assert run(path, "--json") == 0
    *frames, _ = events(capsys)
    assert [f["number"] for f in frames if f["cut"] is not None] == [CUT_IN_FILES]
    whole = pictures()
    for number, picture in enumerate(whole, 1):
        if number == CUT_IN_FILES:
            denoiser.reset()
        wanted = denoiser.denoise(read_exr(f"shot.{number}.exr"))
        np.testing.assert_array_equal(picture, wanted.astype(np.float16))

    for number in (2, 4):  # as if it had been killed, or were another machine's
        (shot / f"clean.{number}.exr").unlink()
    assert run(path, "--json", "--resume", "--frames", "1-2") == 0
    assert [f["output"] for f in events(capsys)[:-1]] == [None, "clean.2.exr"]
    planned = plan_run(["shot.#.exr"], "clean.#.exr", str(path), ShotOptions(workers=2, chunk=2))
    chunk = split(planned.jobs, 2, memory=planned.work.memory)["3-4"]
    done = denoise_chunk(chunk, 1, work=planned.work)
    assert (done.already, done.error) == (1, None)
    np.testing.assert_array_equal(pictures(), whole)


def test_a_dry_run_tells_what_the_graph_does_of_each_frame(path, shot, capsys):
    assert run(path, "--dry-run", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["model"] == f"{NAME}.frame"
    first, following = facts["stages_first"], facts["stages_following"]
    assert [stage["name"] for stage in (*first, *following)] == ["frame", "frame"]
    assert "begins anew" in first[0]["reason"]
    assert "goes on" in following[0]["reason"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--aovs", "all"), f"aovs must not be given with {NAME}.frame, which denoises the beauty"),
        (("--max-memory", "4G"), f"max-memory must not be given with {NAME}.frame"),
        (("--state", "past.npz"), "state must be that of a model that learns"),
        (("--provider", "NoSuch"), "providers must be among"),
    ],
)
def test_what_a_graph_cannot_do_with_files_is_refused_in_one_line(
    path, shot, capsys, options, message
):
    assert run(path, "--quiet", *options) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not list(shot.glob("clean*"))

"""A frame graph in `stillray.Denoiser`: all stages where a provider runs them, and the state there.

The CPU is a provider as any other: bindings and states go the same way, in main memory.
"""

from __future__ import annotations

import json

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import onnx  # noqa: E402

import stillray  # noqa: E402
from stillray.errors import InputError  # noqa: E402
from stillray.frame import Frame  # noqa: E402
from stillray.models.frame_graph import PORTS_KEY  # noqa: E402
from stillray.models.frame_session import FrameSession, device_of  # noqa: E402
from stillray.models.registry import find_model, with_overrides  # noqa: E402
from stillray_export.frame_graph.export import write  # noqa: E402
from tests.export.frame_graph.moving import sequence  # noqa: E402

NAME = "kpyr-5s"
CPU = "CPUExecutionProvider"
CUT = 5  # of the sequence
#: dB of tone-mapped pictures
PARITY = 80


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write(find_model(NAME), tmp_path_factory.mktemp("graph"))


@pytest.fixture
def denoiser(path):
    with stillray.Denoiser(path, threads=1, providers=[CPU]) as made:
        yield made


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
    with stillray.Denoiser(NAME, threads=1) as stages:
        for index, frame in enumerate(sequence(CUT + 2, 33, 47)):
            if index == CUT:
                denoiser.reset()
                stages.reset()
            assert decibels(denoiser.denoise(frame), stages.denoise(frame)) > PARITY


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
    with stillray.Denoiser(NAME, threads=1) as stages:
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

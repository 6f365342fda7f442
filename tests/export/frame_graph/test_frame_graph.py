"""One ONNX file a frame beside the runtime, picture by picture."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import stillray  # noqa: E402
from stillray.cli import main  # noqa: E402
from stillray.errors import InputError  # noqa: E402
from stillray.frame import Frame  # noqa: E402
from stillray.models.registry import find_model  # noqa: E402
from stillray_export.frame_graph.export import write  # noqa: E402
from stillray_export.frame_graph.moving import sequence  # noqa: E402

#: What the cases are tested on; the other kernel pyramid is in one.
NAME = "kpyr-5"
#: dB of tone-mapped pictures
PARITY = 80
_NEUTRAL = {
    "albedo": (-1, 3),
    "normal": (0, 3),
    "depth": (0,),
    "motion": (1e7, 2),
    "samples": (-1,),
    "filter_spread": (-1,),
}


@pytest.fixture(scope="module")
def exported(frame_graph):
    """Frame graphs by their model's name, opened when they are first asked for."""
    return cache(lambda name: Graph(frame_graph(name)))


@pytest.fixture
def graph(exported):
    found = exported(NAME)
    found.cut()
    return found


class Graph:
    """A frame graph as an engine runs it."""

    def __init__(self, path):
        import onnxruntime as ort

        self.path = path
        options = ort.SessionOptions()
        options.intra_op_num_threads = 1
        self.session = ort.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        self.cut()

    def cut(self):
        """A first frame comes."""
        self.state = {
            value.name: np.zeros([n if isinstance(n, int) else 1 for n in value.shape], np.float32)
            for value in self.session.get_inputs()
            if value.name.startswith("past_")
        }

    def __call__(self, frame):
        given = {"color": frame.color}
        for name, (neutral, *channels) in _NEUTRAL.items():
            value = getattr(frame, name)
            given[name] = np.full((1, 1, *channels), neutral) if value is None else value
            if np.ndim(given[name]) == 0:
                given[name] = np.full((1, 1), value)
            given[name] = given[name].astype(np.float32)
        names = [value.name for value in self.session.get_outputs()]
        left = dict(zip(names, self.session.run(None, {**given, **self.state}), strict=True))
        self.state = {name: left[name.replace("past_", "next_")] for name in self.state}
        return left["denoised"]


def alone(frame):
    """A frame without a past, as the runtime has it."""
    with stillray.Denoiser(NAME, threads=1, precision="float32") as denoiser:
        return denoiser.denoise(frame)


def decibels(got, wanted):
    got, wanted = (image / (1 + image) for image in (got, wanted))
    return -10 * np.log10(np.square(got - wanted).mean() + 1e-30)


@pytest.mark.parametrize(("name", "size"), [(NAME, (61, 90)), ("kpyr-5s", (48, 33))])
def test_eight_frames_with_all_that_goes_wrong_are_the_runtimes(exported, name, size):
    graph = exported(name)
    graph.cut()
    with stillray.Denoiser(name, threads=1, precision="float32") as denoiser:
        for frame in sequence(8, *size):
            got, wanted = graph(frame), denoiser.denoise(frame)
            assert got.shape == wanted.shape
            assert decibels(got, wanted) > PARITY
            assert decibels(got[-1:], wanted[-1:]) > PARITY  # rows that no cell of 16 fills


def _only(*names):
    return lambda frame: Frame(color=frame.color, **{name: getattr(frame, name) for name in names})


@pytest.mark.parametrize(
    "part",
    [
        _only(),
        _only("motion"),
        _only("albedo", "normal", "motion"),
        _only("depth", "motion"),
        lambda frame: Frame(color=frame.color, motion=frame.motion, samples=4),
        lambda frame: Frame(color=frame.color, motion=frame.motion, filter_spread=0.37),
    ],
    ids=["color", "motion", "no depth", "depth", "samples", "filter"],
)
def test_buffers_that_are_left_out_are_left_out(graph, part):
    with stillray.Denoiser(NAME, threads=1, precision="float32") as denoiser:
        for frame in map(part, sequence(3, 40, 50)):
            assert decibels(graph(frame), denoiser.denoise(frame)) > PARITY


def test_pixels_without_samples_are_filled_in(graph):
    with stillray.Denoiser(NAME, threads=1, precision="float32") as denoiser:
        for index, frame in enumerate(sequence(3, 40, 50)):
            samples = np.random.default_rng(index).choice([0, 1, 8, np.nan], frame.shape)
            given = _only("albedo", "motion")(frame)
            given = Frame(
                color=given.color, albedo=given.albedo, motion=given.motion, samples=samples
            )
            assert decibels(graph(given), denoiser.denoise(given)) > PARITY


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (1, 40), (16, 16)])
def test_any_size_runs_and_a_first_frame_is_the_runtimes(graph, size):
    first, second = sequence(2, *size)
    # of one row that is mirrored features are alike: of squares that cancel rounding is left
    cancels = min(size) == 1
    assert decibels(graph(first), alone(first)) > PARITY - 5 * cancels
    assert np.isfinite(graph(second)).all()


def test_a_state_of_zeros_is_a_cut(graph):
    first, second = sequence(2, 40, 50)
    graph(first)
    graph.cut()
    assert decibels(graph(second), alone(second)) > PARITY


def test_a_frame_graph_holds_nothing_that_browsers_fail_at(graph):
    import onnx

    nodes = onnx.load_model(str(graph.path)).graph.node
    operators = {node.op_type for node in nodes}
    assert not operators & {"Split", "If", "Loop", "NonZero", "TopK", "GridSample", "IsNaN", "Or"}
    assert {node.domain for node in nodes} == {""}
    assert b"/site-packages/" not in graph.path.read_bytes()


def test_info_lists_what_a_frame_graph_takes_and_gives(graph, capsys):
    path = str(graph.path)
    assert main(["info", path]) == 0  # no picture by its name
    text = capsys.readouterr().out
    assert "past_mean" in text
    assert "squared exposed irradiance" in text
    assert main(["info", path, "--graph", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["size_bytes"] == graph.path.stat().st_size
    assert f"{sum(facts['operators'].values())} nodes" in text
    session = graph.session
    assert [port["name"] for port in facts["inputs"]] == [x.name for x in session.get_inputs()]
    assert [port["name"] for port in facts["outputs"]] == [x.name for x in session.get_outputs()]
    ranks = {x.name: len(x.shape) for x in (*session.get_inputs(), *session.get_outputs())}
    for port in (*facts["inputs"], *facts["outputs"]):
        assert len(port["shape"].split(", ")) == ranks[port["name"]]


def test_info_of_what_is_no_frame_graph_says_so_or_how_to_make_one(capsys):
    assert main(["info", "kpyr-5", "--graph"]) == 2
    assert "stillray-export kpyr-5 --frame-graph" in capsys.readouterr().err
    assert main(["info", str(find_model("kpyr-5").path)]) == 2
    assert "not a frame graph" in capsys.readouterr().err


def test_other_families_have_no_frame_graph(tmp_path):
    with pytest.raises(InputError, match="made of kernel pyramids"):
        write(find_model("wskp-3s"), tmp_path)

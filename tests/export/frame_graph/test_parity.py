"""What is compared before a frame graph is kept."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")

import cv2  # noqa: E402
import onnx  # noqa: E402

from stillray.models.registry import find_model  # noqa: E402
from stillray_export import to_onnx  # noqa: E402
from stillray_export.frame_graph import export, parity  # noqa: E402
from stillray_export.parity import ParityError  # noqa: E402

NAME = "kpyr-5s"
SIZE = (20, 33)


@pytest.fixture(scope="module")
def graph(frame_graph):
    return frame_graph(NAME)


def brighter(graph, path, output, factor):
    """The same graph with one output that is multiplied."""
    model = onnx.load_model(str(graph))
    for node in model.graph.node:
        node.output[:] = ["before" if name == output else name for name in node.output]
        node.input[:] = ["before" if name == output else name for name in node.input]
    model.graph.initializer.append(
        onnx.helper.make_tensor("factor", onnx.TensorProto.FLOAT, [], [factor])
    )
    model.graph.node.append(onnx.helper.make_node("Mul", ["before", "factor"], [output]))
    path.write_bytes(model.SerializeToString())
    return path


def test_a_graph_that_differs_is_refused_and_one_that_does_not_is_not(graph, tmp_path):
    info = find_model(NAME)
    parity.check(graph, info, SIZE)
    bent = brighter(graph, tmp_path / "bent.frame.onnx", "denoised", 1.001)
    with pytest.raises(ParityError, match=r"kpyr-5s: the picture of frame 0 .* must be 80"):
        parity.check(bent, info, SIZE)
    # a state that is wrong shows in the next frame
    bent = brighter(graph, tmp_path / "bent.frame.onnx", "next_mean", 1.1)
    with pytest.raises(ParityError, match="the picture of frame 1 "):
        parity.check(bent, info, SIZE)


def test_the_command_writes_nothing_that_was_refused(graph, tmp_path, monkeypatch):
    bent = brighter(graph, tmp_path / "bent.frame.onnx", "denoised", 1.01)
    bent = onnx.load_model(str(bent))
    monkeypatch.setattr(export, "frame_graph", lambda info: bent)
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(ParityError):
        to_onnx.main(run=NAME, out=out, frame_graph=True)
    assert not list(out.iterdir())
    monkeypatch.setattr(export, "frame_graph", lambda info: onnx.load_model(str(graph)))
    to_onnx.main(run=NAME, out=out, frame_graph=True)
    assert (out / graph.name).read_bytes() == graph.read_bytes()


def test_the_table_has_every_stage_and_pictures_are_drawn(graph, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(parity, "SIZE", SIZE)
    parity.main(graph, source=None, model=None, pictures=tmp_path)
    head, _, *rows = capsys.readouterr().out.splitlines()
    assert head.strip("| ").split(" | ")[1:] == list(parity.COLUMNS)
    assert len(rows) == 8
    cells = [cell.strip() for cell in rows[-1].split("|")[1:-1]]
    assert all(float(cell) > 50 for cell in cells[1:])  # also of noise and albedo
    shown = cv2.imread(str(tmp_path / f"{NAME}.7.png"))
    assert shown.shape == (SIZE[0], 3 * SIZE[1], 3)

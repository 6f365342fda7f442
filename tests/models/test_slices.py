"""Networks that take some planes of a tensor: where they cut is known before they run."""

from __future__ import annotations

import numpy as np
import pytest

from stillray.models.network_graph import GraphError, Planes, interface_of
from stillray.models.onnx_file import Graph, parse_onnx
from stillray.models.protobuf import WireError

onnx = pytest.importorskip("onnx")


def model(places, kinds=None):
    """Planes ``places[0]`` to ``places[1]`` of six, multiplied by themselves."""
    names = ["start", "end", "axis", "step"]
    kinds = kinds or [onnx.TensorProto.INT64] * 4
    tensors = [
        onnx.numpy_helper.from_array(
            np.array([value], onnx.helper.tensor_dtype_to_np_dtype(kind)), name
        )
        for name, value, kind in zip(names, places, kinds, strict=True)
    ]
    nodes = [
        onnx.helper.make_node("Slice", ["features", *names], ["part"]),
        onnx.helper.make_node("Mul", ["part", "part"], ["logits"]),
    ]
    shape = [1, 6, "height", "width"]
    features = onnx.helper.make_tensor_value_info("features", onnx.TensorProto.FLOAT, shape)
    logits = onnx.helper.make_tensor_value_info("logits", onnx.TensorProto.FLOAT, None)
    graph = onnx.helper.make_graph(nodes, "g", [features], [logits], tensors)
    opsets = [onnx.helper.make_opsetid("", 18)]
    return onnx.helper.make_model(graph, opset_imports=opsets).SerializeToString()


def graph_of(places, kinds=None) -> Graph:
    return parse_onnx(model(places, kinds)).graph


@pytest.mark.parametrize(("places", "count"), [((0, 2, 1, 1), 2), ((4, 2**63 - 1, 1, 1), 2)])
def test_planes_that_are_taken_are_counted(places, count):
    assert interface_of(graph_of(places)).outputs == (Planes(count, 1),)


@pytest.mark.parametrize(
    ("places", "message"),
    [
        ((0, 2, 2, 1), "must have axis 1, got 2"),
        ((0, 2, 1, 2), "must take every plane, got steps of 2"),
        ((6, 9, 1, 1), "must take planes that there are, got 6 to 6"),
        ((-3, 6, 1, 1), "must take planes that there are, got -3 to 6"),
        ((2, 2, 1, 1), "must take planes that there are, got 2 to 2"),
    ],
)
def test_other_cuts_are_refused(places, message):
    with pytest.raises(GraphError, match=message):
        interface_of(graph_of(places))


def test_places_are_whole_numbers_of_one_kind():
    kinds = [onnx.TensorProto.FLOAT, *[onnx.TensorProto.INT64] * 3]
    with pytest.raises(GraphError, match="must take a whole number for start"):
        interface_of(graph_of((0, 2, 1, 1), kinds))
    kinds[0] = onnx.TensorProto.INT32
    with pytest.raises(GraphError, match="must take a whole number for start"):
        interface_of(graph_of((0, 2, 1, 1), kinds))
    kinds[0] = onnx.TensorProto.INT16
    with pytest.raises(WireError, match="its tensor start must hold float32, or integers"):
        graph_of((0, 2, 1, 1), kinds)

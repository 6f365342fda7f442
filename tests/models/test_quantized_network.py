"""Networks of 8-bit integers: what they give is known before they run, and others are refused."""

from __future__ import annotations

import numpy as np
import pytest

from stillray.models.network_graph import GraphError, Planes, interface_of
from stillray.models.onnx_file import parse_onnx
from stillray.models.protobuf import WireError

onnx = pytest.importorskip("onnx")


def model(**changes):
    """A convolution of 3 planes to 2, with weights, what it takes and what it gives in integers."""
    tensors = {
        "weights": np.ones((2, 3, 1, 1), np.int8),
        "weight_scale": np.full(2, 0.1, np.float32),
        "weight_zero": np.zeros(2, np.int8),
        "bias": np.array([5, -5], np.int32),
        "bias_scale": np.full(2, 0.01, np.float32),
        "bias_zero": np.zeros(2, np.int32),
        "scale": np.array(1 / 255, np.float32),
        "zero": np.array(3, np.uint8),
    }
    tensors |= changes
    nodes = [
        onnx.helper.make_node(operator, inputs, [output])
        for operator, inputs, output in [
            ("QuantizeLinear", ["features", "scale", "zero"], "given"),
            ("DequantizeLinear", ["given", "scale", "zero"], "seen"),
            ("DequantizeLinear", ["weights", "weight_scale", "weight_zero"], "w"),
            ("DequantizeLinear", ["bias", "bias_scale", "bias_zero"], "b"),
            ("Conv", ["seen", "w", "b"], "logits"),
        ]
    ]
    for node in nodes[2:4]:
        node.attribute.append(onnx.helper.make_attribute("axis", 0))
    shape = [1, 3, "height", "width"]
    features = onnx.helper.make_tensor_value_info("features", onnx.TensorProto.FLOAT, shape)
    logits = onnx.helper.make_tensor_value_info("logits", onnx.TensorProto.FLOAT, None)
    initializers = [onnx.numpy_helper.from_array(value, name) for name, value in tensors.items()]
    graph = onnx.helper.make_graph(nodes, "g", [features], [logits], initializers)
    opsets = [onnx.helper.make_opsetid("", 18)]
    return onnx.helper.make_model(graph, opset_imports=opsets)


def graph_of(**changes):
    return parse_onnx(model(**changes).SerializeToString()).graph


def test_planes_of_a_network_of_integers_are_counted():
    found = interface_of(graph_of())
    assert (found.features, found.outputs, found.multiplications) == (3, (Planes(2, 1),), 6)


def test_tensors_are_the_integers_of_the_file():
    tensors = graph_of().tensors
    assert tensors["weights"].dtype == np.int8
    np.testing.assert_array_equal(tensors["bias"], [5, -5])
    assert tensors["zero"] == 3


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scale": np.ones(3, np.float32)}, "QuantizeLinear must have one scale for an image"),
        ({"scale": np.array(0, np.float32)}, "must have a scale above 0, got 0"),
        ({"scale": np.array(2, np.uint8)}, "must take scale as float32"),
        ({"zero": np.array(3, np.int32)}, "must make integers of 8 bits of an image"),
        ({"zero": np.array(3, np.float32)}, "must take zero from the file, as integers"),
        ({"weight_scale": np.ones(3, np.float32)}, "must have a scale and a zero for each output"),
        ({"weight_zero": np.zeros(2, np.int32)}, "must have a scale and a zero for each output"),
        ({"bias": np.ones(2, np.float32)}, "must take bias from the file, as integers"),
        ({"bias_scale": np.full(2, 3e38, np.float32)}, "must give finite numbers"),
        ({"weights": np.ones((2, 4, 1, 1), np.int8)}, "Conv must take 4 planes, got 3"),
    ],
)
def test_other_integers_are_refused(changes, message):
    with pytest.raises(GraphError, match=message):
        interface_of(graph_of(**changes))


def test_a_tensor_of_integers_has_the_bytes_that_it_claims():
    made = model()
    made.graph.initializer[0].raw_data = made.graph.initializer[0].raw_data[:-1]
    with pytest.raises(WireError, match="its tensor weights has not the size that it claims"):
        parse_onnx(made.SerializeToString())

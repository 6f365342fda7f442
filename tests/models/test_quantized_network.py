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
        (
            {"weights": np.array([[[[64]], [[65]], [[0]]]] * 2, np.int8)},
            r"no two neighbours of one sign add up to more than 128: make the file anew",
        ),
        ({"scale": np.ones(3, np.float32)}, "QuantizeLinear must have one scale for an image"),
        ({"scale": np.array(0, np.float32)}, "must have a scale above 0, got 0"),
        ({"scale": np.array(2, np.uint8)}, "must take scale as float32"),
        ({"zero": np.array(3, np.int32)}, "must make integers of 8 bits without a sign"),
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


def doubled(**nodes):
    """Pixels of integers that are doubled by copies: the convolution gives them twice."""
    make = onnx.helper.make_node
    steps = {
        "made": make("QuantizeLinear", ["low", "scale", "zero"], ["made"]),
        "pixels": make("Transpose", ["made"], ["pixels"], perm=[0, 2, 3, 1]),
        "beside": make("Reshape", ["pixels", "of one"], ["beside"]),
        "rows": make("Reshape", ["beside", "of rows"], ["rows"]),
        "twice": make("Concat", ["rows", "rows"], ["twice"], axis=1),
        "below": make("Reshape", ["twice", "of rows"], ["below"]),
        "planes": make("Transpose", ["below"], ["planes"], perm=[1, 3, 0, 2]),
        "logits": make("DequantizeLinear", ["planes", "scale", "zero"], ["logits"]),
    } | nodes
    tensors = {
        "weights": np.ones((4, 3, 2, 2), np.float32),
        "of one": np.array([0, 0, -1, 2]), "of rows": np.array([-1, 1, 0, 2]),
        "of three": np.array([0, 0, -1, 3]), "of four": np.array([-1, 1, 0, 4]), "1": np.array([1]),
        "scale": np.array(0.5, np.float32), "zero": np.array(3, np.uint8),
        "other": np.array(0.25, np.float32),
    }  # fmt: skip
    convolved = make("Conv", ["features", "weights"], ["low"], strides=[2, 2])
    shape = [1, 3, "height", "width"]
    features = onnx.helper.make_tensor_value_info("features", onnx.TensorProto.FLOAT, shape)
    logits = onnx.helper.make_tensor_value_info("logits", onnx.TensorProto.FLOAT, None)
    held = [onnx.numpy_helper.from_array(value, name) for name, value in tensors.items()]
    graph = onnx.helper.make_graph(
        [convolved, *filter(None, steps.values())], "g", [features], [logits], held
    )
    opsets = [onnx.helper.make_opsetid("", 18)]
    made = onnx.helper.make_model(graph, opset_imports=opsets)
    return interface_of(parse_onnx(made.SerializeToString()).graph)


def test_copies_beside_and_below_each_other_double_an_image():
    assert doubled().outputs == (Planes(2, 1),)


def node(operator, inputs, output, **attributes):
    return onnx.helper.make_node(operator, inputs, [output], **attributes)


@pytest.mark.parametrize(
    ("nodes", "message"),
    [
        ({"pixels": node("Transpose", ["made"], "pixels", perm=[0, 3, 1, 2])},
         "Transpose must turn planes in a known way, got perm .0, 3, 1, 2."),
        ({"pixels": node("Transpose", ["low"], "pixels", perm=[0, 2, 3, 1])},
         "Transpose must take integers"),
        ({"beside": node("Reshape", ["pixels", "of three"], "beside")},
         "must make pixels of pairs, or rows, got .0, 0, -1, 3. of pixels"),
        ({"beside": node("Reshape", ["made", "of one"], "beside")}, "got .0, 0, -1, 2. of planes"),
        ({"beside": node("Reshape", ["pixels", "1"], "beside")}, "must take a shape for 1"),
        ({"rows": node("Reshape", ["beside", "of four"], "rows")}, "got .-1, 1, 0, 4. of pixels"),
        ({"twice": node("Concat", ["rows"], "twice", axis=1)}, "must take rows of pixels twice"),
        ({"twice": node("Concat", ["rows", "rows", "rows"], "twice", axis=1)},
         "must take rows of pixels twice"),
        ({"twice": node("Concat", ["rows", "pixels"], "twice", axis=1)},
         "must take rows of pixels twice"),
        ({"twice": node("Concat", ["made", "rows"], "twice", axis=1)},
         "Concat must take made as planes of numbers"),
        ({"logits": node("DequantizeLinear", ["planes", "other", "zero"], "logits")},
         "must take planes that were made integers in the same steps"),
        ({"logits": node("DequantizeLinear", ["below", "scale", "zero"], "logits")},
         "must take planes that were made integers in the same steps"),
        ({"logits": node("Relu", ["planes"], "logits")}, "must take planes as planes of numbers"),
        ({"rows": node("Reshape", ["beside", "of rows"], "rows"),
          "logits": node("Transpose", ["pixels"], "logits", perm=[0, 3, 1, 2]),
          "below": node("Reshape", ["below 2", "of rows"], "below")},
         "Reshape takes below 2, which nothing has given"),
    ],
)  # fmt: skip
def test_other_copies_are_refused(nodes, message):
    with pytest.raises(GraphError, match=message):
        doubled(**nodes)


def test_an_image_of_the_frames_own_size_is_not_doubled():
    """Reduced by nothing, it would be larger than the frame."""
    again = {
        "more": node("Transpose", ["planes"], "more", perm=[0, 2, 3, 1]),
        "again": node("Reshape", ["more", "of rows"], "again"),
        "more twice": node("Concat", ["again", "again"], "more twice", axis=1),
        "too high": node("Reshape", ["more twice", "of rows"], "too high"),
    }
    with pytest.raises(GraphError, match="Reshape must double what was reduced"):
        doubled(**again)


def test_outputs_are_whole_pixels_in_planes():
    end = {"planes": node("Transpose", ["below"], "logits", perm=[1, 3, 0, 2]), "logits": None}
    assert doubled(**end).outputs[0].steps is not None
    rest = dict.fromkeys(["rows", "twice", "below", "planes", "logits"])
    for last in (
        node("Reshape", ["pixels", "of one"], "logits"),
        node("Transpose", ["made"], "logits", perm=[0, 2, 3, 1]),
    ):
        with pytest.raises(GraphError, match="every output must be planes of whole pixels"):
            doubled(**{**rest, "beside": last})

"""Integers whose sums fit into 16 bits are the same with AVX2 alone as with VNNI."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")

import onnx
from hypothesis import given
from hypothesis import strategies as st
from onnx import helper, numpy_helper
from onnxruntime import GraphOptimizationLevel, InferenceSession, SessionOptions

from stillray.models.registry import find_model
from stillray.models.small_sums import MOST, neighbours_sum
from stillray_export.integer_layout import arrange
from stillray_export.quantize import quantized
from stillray_export.small_sums import scales_of_outputs


@given(st.data())
def test_two_neighbours_of_one_sign_are_added_up(data):
    outputs, inputs, height, width = (data.draw(st.integers(1, 4)) for _ in range(4))
    first = data.draw(st.integers(0, 1))
    count = outputs * inputs * height * width
    drawn = data.draw(st.lists(st.integers(-127, 127), min_size=count, max_size=count))
    weights = np.reshape(drawn, (outputs, inputs, height, width)).astype(np.int8)
    expected = []
    for own in weights.astype(int):
        row = [own[i, y, x] for y in range(height) for x in range(width) for i in range(inputs)]
        pairs = [row[place : place + 2] for place in range(first, len(row), 2)]
        sums = [abs(sum(w for w in two if w * sign > 0)) for two in pairs for sign in (1, -1)]
        expected.append(max(sums, default=0))
    np.testing.assert_array_equal(neighbours_sum(weights, first), expected)


@pytest.mark.parametrize("inputs", [4, 7])
def test_scales_are_the_finest_that_keep_sums_small(rng, inputs):
    weights = rng.normal(size=(50, inputs, 3, 3)) * rng.lognormal(size=(50, 1, 1, 1))
    weights[0] = 0.0
    scale = scales_of_outputs(weights)
    made = np.rint(weights / scale[:, None, None, None])
    assert scale[0] == 1.0
    for first in (0, 1)[: 1 + inputs % 2]:
        assert neighbours_sum(made, first).max() <= MOST
    largest = np.abs(made[1:]).max(axis=(1, 2, 3))
    assert largest.min() >= MOST // 2 - 1  # seven bits at the least
    assert np.median(largest) > 1.3 * MOST / 2


def convolution(weights):
    outputs, inputs, height, width = weights.shape
    pads = [height // 2, width // 2] * 2
    nodes = [
        helper.make_node(
            "Conv", ["features", "w", "b"], ["made"], name="made", strides=[1, 1], pads=pads
        ),
        helper.make_node("Relu", ["made"], ["logits"]),
    ]
    features, logits = (
        helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [1, count, "height", "width"])
        for name, count in (("features", inputs), ("logits", outputs))
    )
    initializers = [
        numpy_helper.from_array(array.astype(np.float32), name)
        for name, array in (("w", weights), ("b", np.zeros(outputs)))
    ]
    graph = helper.make_graph(nodes, "g", [features], [logits], initializers)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)


@pytest.mark.parametrize("pairs", [False, True])
@pytest.mark.parametrize("inputs", [16, 13])
def test_weights_that_are_all_as_large_do_not_overflow(tmp_path, rng, inputs, pairs):
    # signs alone, so that without a coarser scale half of all sums of two leave 16 bits
    weights = np.sign(rng.normal(size=(16, inputs, 3, 3)))
    path = tmp_path / "large.onnx"
    onnx.save(convolution(weights), path)
    # a plane is nowhere between, so that one is as bright as can be wherever it is not 0
    given = np.where(rng.random((1, 32, 32, inputs)) < 0.5, 0, 255).astype(np.uint8)
    network = quantized(path, [given.transpose(0, 3, 1, 2) / np.float32(255.0)])
    assert arrange(network.graph, integers_out=True, pairs=pairs) == pairs
    assert_as_said(network, given)


def assert_as_said(network, given):
    # each operator by itself, in floats, which hold these integers exactly
    said, found = (
        _run(network, given, level)
        for level in (
            GraphOptimizationLevel.ORT_DISABLE_ALL,
            GraphOptimizationLevel.ORT_ENABLE_ALL,
        )
    )
    for expected, made in zip(said, found, strict=True):
        difference = np.abs(made.astype(int) - expected.astype(int))
        assert difference.max() <= 1  # a half is rounded up or down
        assert (difference > 0).mean() < 0.01


def _run(network, given, level):
    options = SessionOptions()
    options.graph_optimization_level = level
    options.intra_op_num_threads = 1
    session = InferenceSession(network.SerializeToString(), options)
    return session.run(None, {session.get_inputs()[0].name: given})


PACKAGED = sorted(
    path
    for name in ("kpyr-5", "munet-x2")
    for path in find_model(name).path.parent.glob("*.int8*.onnx")
)


@pytest.mark.parametrize("path", PACKAGED, ids=lambda path: path.stem)
def test_each_convolution_that_ships_is_computed_here_as_its_integers_say(path, rng):
    network = onnx.load(path)
    tensors = {each.name: each for each in network.graph.initializer}
    makers = {node.output[0]: node for node in network.graph.node}
    convolutions = [node for node in network.graph.node if node.op_type == "Conv"]
    assert len(convolutions) > 20
    for node in convolutions:
        weights, bias = (makers[name] for name in node.input[1:])
        outputs, inputs, *_ = tensors[weights.input[0]].dims
        scale = numpy_helper.to_array(tensors[makers[node.input[0]].input[1]])
        # wide enough for whatever comes of planes that are dark or bright, nowhere between
        steps = numpy_helper.to_array(tensors[weights.input[0]]).astype(float)
        range_ = np.abs(steps).sum(axis=(1, 2, 3)) * numpy_helper.to_array(
            tensors[weights.input[1]]
        )
        own = {
            "scale": scale,
            "zero": np.uint8(0),
            "wide": np.float32(range_.max() * scale * 255 / 127),
            "middle": np.uint8(128),
        }
        nodes = [
            helper.make_node("DequantizeLinear", ["given", "scale", "zero"], [node.input[0]]),
            weights,
            bias,
            node,
            helper.make_node("QuantizeLinear", [node.output[0], "wide", "middle"], ["made"]),
        ]
        planes, made = (
            helper.make_tensor_value_info(what, onnx.TensorProto.UINT8, [1, count, None, None])
            for what, count in (("given", inputs), ("made", outputs))
        )
        kept = [tensors[what] for each in (weights, bias) for what in each.input]
        kept += [numpy_helper.from_array(np.asarray(value), what) for what, value in own.items()]
        graph = helper.make_graph(nodes, "g", [planes], [made], kept)
        model = helper.make_model(graph, opset_imports=network.opset_import, ir_version=10)
        given = np.where(rng.random((1, inputs, 16, 16)) < 0.5, 0, 255).astype(np.uint8)
        assert_as_said(model, given)

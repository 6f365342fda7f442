"""Networks whose input is pixels of 8-bit integers: in which steps, is known before they run."""

from __future__ import annotations

import numpy as np
import pytest

from stillray.arrays.strips import Strips
from stillray.arrays.workspace import Workspace
from stillray.families.network_input import NetworkInput
from stillray.models.network_graph import GraphError, Planes, interface_of
from stillray.models.onnx_file import parse_onnx
from stillray.models.precision import int8_path
from stillray.models.protobuf import WireError
from stillray.models.registry import find_model
from stillray.models.steps import Steps, in_steps, layout_of
from stillray.pipeline.opening import engine_of_model

onnx = pytest.importorskip("onnx")
UINT8, FLOAT = onnx.TensorProto.UINT8, onnx.TensorProto.FLOAT
FIRST, SECOND = Steps(0.5, 3), Steps(0.25, 100)


def model(nodes=None, *, shape=(1, "height", "width", 5), kind=UINT8, **changes):
    """Planes 0 and 1 in one kind of steps, planes 2 to 4 in another; the first two come out."""
    tensors = {
        "0": np.array([0], np.int64), "2": np.array([2], np.int64), "5": np.array([5], np.int64),
        "1": np.array([1], np.int64),
        "scale": np.array(FIRST.scale, np.float32), "zero": np.array(FIRST.zero, np.uint8),
        "scale 2": np.array(SECOND.scale, np.float32), "zero 2": np.array(SECOND.zero, np.uint8),
    } | changes  # fmt: skip
    make = onnx.helper.make_node
    nodes = nodes or [
        make("Transpose", ["features"], ["planes"], perm=[0, 3, 1, 2]),
        make("Slice", ["planes", "0", "2", "1"], ["two"]),
        make("Slice", ["planes", "2", "5", "1"], ["three"]),
        make("DequantizeLinear", ["two", "scale", "zero"], ["numbers"]),
        make("DequantizeLinear", ["three", "scale 2", "zero 2"], ["more"]),
        make("Relu", ["numbers"], ["logits"]),
    ]
    features = onnx.helper.make_tensor_value_info("features", kind, shape)
    logits = onnx.helper.make_tensor_value_info("logits", FLOAT, None)
    initializers = [onnx.numpy_helper.from_array(value, name) for name, value in tensors.items()]
    graph = onnx.helper.make_graph(nodes, "g", [features], [logits], initializers)
    opsets = [onnx.helper.make_opsetid("", 18)]
    return onnx.helper.make_model(graph, opset_imports=opsets)


def interface(*args, **changes):
    return interface_of(parse_onnx(model(*args, **changes).SerializeToString()).graph)


def test_every_plane_has_steps_of_its_own():
    found = interface()
    assert (found.features, found.outputs) == (5, (Planes(2, 1),))
    assert found.steps == (FIRST, FIRST, SECOND, SECOND, SECOND)


def nodes_with(place, node):
    nodes = list(model().graph.node)
    nodes[place] = node
    return nodes


def node(operator, inputs, outputs, **attributes):
    return onnx.helper.make_node(operator, inputs, outputs, **attributes)


@pytest.mark.parametrize(
    ("nodes", "message"),
    [
        (nodes_with(0, node("Transpose", ["features"], ["planes"], perm=[0, 1, 3, 2])),
         "Transpose must have perm"),
        (nodes_with(0, node("Transpose", ["features"], ["planes"])), "Transpose must have perm"),
        (nodes_with(0, node("Relu", ["features"], ["planes"])), "Relu must not take the input's"),
        (nodes_with(3, node("Relu", ["two"], ["numbers"])), "Relu must not take the input's"),
        (nodes_with(5, node("Add", ["numbers", "two"], ["logits"])), "must not take the input's"),
        (nodes_with(4, node("Relu", ["numbers"], ["more"])), "every plane of integers must be"),
        (nodes_with(5, node("DequantizeLinear", ["two", "scale 2", "zero 2"], ["logits"])),
         "DequantizeLinear must agree on steps"),
        (nodes_with(5, node("Transpose", ["numbers"], ["logits"], perm=[0, 3, 1, 2])),
         "Transpose must take integers"),
        (nodes_with(1, node("Slice", ["planes", "0", "5", "1"], ["three"])), "a name of its own"),
    ],
)  # fmt: skip
def test_other_ways_to_numbers_are_refused(nodes, message):
    with pytest.raises(GraphError, match=message):
        interface(nodes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"zero": np.array(3, np.int8)}, "must make integers of 8 bits without a sign"),
        ({"scale": np.array(0, np.float32)}, "must have a scale above 0"),
        ({"shape": (1, 5, "height", "width")}, "must have shape .1, height, width, planes"),
        ({"shape": (1, "height", "width", 2000)}, "must have 1 to 1024 planes, got 2000"),
        ({"kind": FLOAT, "shape": (1, 5, "height", "width")}, "Transpose must take integers"),
    ],
)
def test_other_inputs_are_refused(changes, message):
    with pytest.raises(GraphError, match=message):
        interface(**changes)
    with pytest.raises(WireError, match="must be float32 or uint8"):
        interface(kind=onnx.TensorProto.INT8)


@pytest.mark.parametrize(
    "told", ["[0, 1, 1]", "[0, -1]", "[]", "[0, 1, 3]", "3", "[0, 1, 2.0]", "{", "[" * 10**5]
)
def test_places_that_cannot_be_are_refused(told):
    with pytest.raises(
        ValueError, match=r"stillray\.places must hold some of 3 places, each once, got .{0,80}$"
    ):
        layout_of((FIRST, FIRST, SECOND), told)


_STEPS = (FIRST, SECOND, FIRST, SECOND, FIRST)
#: Of five planes, the first of which is the last integer of a pixel.
LAYOUT = layout_of(_STEPS, "[4, 2, 1, 0, 3]")
#: The same, and three integers that are of none.
SPARE = layout_of((*_STEPS, FIRST, FIRST, FIRST), "[4, 2, 1, 0, 3]")


class Takes:
    """An engine of a network that takes this input."""

    def __init__(self, layout):
        self.feature_layout = layout


@pytest.mark.parametrize("width", [40, 48])
@pytest.mark.parametrize("layout", [LAYOUT, SPARE])
def test_pixels_are_made_strip_by_strip_as_planes_are(rng, width, layout):
    planes = (20 * rng.normal(size=(5, 35, width))).astype(np.float32)
    planes[:, 3, :4] = 1e6, -1e6, 1e-38, 0  # beyond the first and last step
    strips, found = Strips(2, pixels=4 * 48), []
    for taken in (None, layout):
        strips.workspace.array("planes in steps", (8, 4, 48), np.uint8)[:] = 9  # of another use
        made = NetworkInput(Takes(taken), 5, (48, 48), Workspace(), strips)

        def pack(rows, made=made):
            made.fill(rows, width, lambda out: np.copyto(out, planes[:, rows]))

        strips.run(pack, 35, width)
        made.mirror(35, width)
        found.append(made.array)
    numbers, integers = found
    assert numbers.shape == (1, 5, 48, 48)
    assert (integers.shape, integers.dtype) == ((1, 48, 48, layout.size), np.uint8)
    assert not integers[..., 5:].any()
    np.testing.assert_array_equal(numbers[0, :, :35, :width], planes)
    np.testing.assert_array_equal(numbers[0, :, 35:], numbers[0, :, 34:21:-1])
    for values, column in zip(numbers[0], layout.columns, strict=True):
        plane, step = integers[0, ..., column.place], column.steps
        exact = np.clip(values.astype(np.float64) / step.scale + step.zero, 0, 255)
        assert np.abs(plane - exact).max() <= 0.5 + 1e-4


@pytest.mark.parametrize("layout", [None, LAYOUT, SPARE])
def test_planes_that_lie_apart_are_put_as_those_that_are_written(rng, layout):
    planes = (20 * rng.normal(size=(5, 16, 24))).astype(np.float32)
    given = [*planes[:4], np.broadcast_to(planes[4, :, :1], (16, 24))]
    planes[4] = given[4]
    strips, arrays = Strips(1, pixels=3 * 24), []
    for kind in ("put", "fill"):
        made = NetworkInput(Takes(layout), 5, (16, 24), Workspace(), strips)

        def work(rows, made=made, kind=kind):
            if kind == "put":
                made.put(rows, [plane[rows] for plane in given])
            else:
                made.fill(rows, 24, lambda out: np.copyto(out, planes[:, rows]))

        strips.run(work, 16, 24)
        arrays.append(made.array)
    np.testing.assert_array_equal(*arrays)
    assert np.ptp(arrays[0]) > 20


def test_halves_are_rounded_to_even():
    values = np.array([[[0.25, 0.75, 1.25]]], np.float32)
    out = in_steps(
        values, layout_of((Steps(0.5, 100),), None), np.empty((1, 3, 1), np.uint8), Workspace()
    )
    assert out.ravel().tolist() == [100, 102, 102]


def test_a_number_a_little_below_a_half_is_rounded_down():
    """Half a step less a millionth: beside a zero of 139 float32 does not tell it from a half."""
    values = np.array([[[0.5 - 1e-6, 0.5 + 1e-6]]], np.float32)
    out = in_steps(
        values, layout_of((Steps(1.0, 139),), None), np.empty((1, 2, 1), np.uint8), Workspace()
    )
    assert out.ravel().tolist() == [139, 140]


def test_planes_of_floats_are_taken_too():
    """An engine that somebody wrapped may be given what networks of floats take."""
    model = find_model("kpyr-5")
    engine = engine_of_model(model, 1, None, int8_path(model.path))
    try:
        planes = np.random.default_rng(0).normal(size=(1, 16, 32, 48)).astype(np.float32)
        pixels = np.empty((32, 48, 16), np.uint8)
        in_steps(planes[0], engine.feature_layout, pixels, Workspace())
        of_planes = engine.run("network", {"features": planes})
        of_pixels = engine.run("network", {"features": pixels[None]})
        for name, found in of_planes.items():
            np.testing.assert_array_equal(found.integers, of_pixels[name].integers)
    finally:
        engine.close()

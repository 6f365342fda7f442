"""Networks of integers whose planes were rearranged give the same integers."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")

import onnx
from onnx import helper, numpy_helper
from onnxruntime import InferenceSession

from stillray.errors import InputError
from stillray.models.network_graph import Planes, interface_of
from stillray.models.onnx_file import parse_onnx
from stillray_export.integer_layout import arrange, paired
from stillray_export.quantize import quantized

PLANES = 6  # of the frame's size, fewer than are enough


def network(rng, finest=PLANES, first=3, rises=True):
    """A U of three levels: two convolutions down, two doublings up, logits of each level.

    Unless it ``rises``, the second doubling is of what logits are made of, too.
    """
    tensors, nodes = {}, []

    def convolve(name, taken, outputs, inputs, size, step=1):
        tensors[f"{name}.weight"] = rng.normal(size=(outputs, inputs, size, size)) / size
        tensors[f"{name}.bias"] = rng.normal(size=outputs)
        pad = (size - 1) // 2
        nodes.append(
            helper.make_node(
                "Conv",
                [taken, f"{name}.weight", f"{name}.bias"],
                [name],
                name=name,
                kernel_shape=[size, size],
                strides=[step, step],
                pads=[pad, pad, pad, pad],
            )
        )
        nodes.append(helper.make_node("Relu", [name], [f"{name} cut"]))
        return f"{name} cut"

    def double(taken):
        attributes = {"mode": "nearest", "nearest_mode": "floor"}
        nodes.append(
            helper.make_node(
                "Resize",
                [taken, "", "twice"],
                [f"{taken} twice"],
                name=f"{taken} twice",
                coordinate_transformation_mode="asymmetric",
                **attributes,
            )
        )
        return f"{taken} twice"

    tensors["twice"] = np.array([1, 1, 2, 2])
    top = convolve("enter", "features", finest, 5, first)
    middle = convolve("down", top, 8, finest, 3, 2)
    low = convolve("lower", middle, 12, 8, 3, 2)
    up = double(convolve("rise", low, 8, 12, 1))
    nodes.append(helper.make_node("Concat", [up, middle], ["both"], axis=1))
    middle = convolve("decode", "both", 10, 16, 3)
    up = double(convolve("rise more", middle, finest, 10, 1) if rises else middle)
    nodes.append(helper.make_node("Add", [up, top], ["sum"]))
    top = convolve("last", "sum", finest, finest, 3)
    outputs = []
    for level, (taken, planes) in enumerate([(top, finest), (middle, 10), (low, 12)]):
        convolve(f"logits_{level}", taken, 7 - level, planes, 3)
        outputs.append(helper.make_tensor_value_info(f"logits_{level}", 1, None))
        nodes.pop()
    features = helper.make_tensor_value_info("features", 1, [1, 5, "height", "width"])
    held = [
        numpy_helper.from_array(np.asarray(value, np.float32), name)
        for name, value in tensors.items()
    ]
    graph = helper.make_graph(nodes, "g", [features], outputs, held)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)


@pytest.fixture
def integers(rng, tmp_path):
    """Of a network, in integers as ONNX Runtime's quantisation leaves it."""

    def made(**changes):
        path = tmp_path / "floats.onnx"
        onnx.save(network(rng, **changes), path)
        return quantized(path, [rng.normal(size=(1, 5, 16, 24)).astype(np.float32)])

    return made


def arranged(before, *, integers_out=False, pairs=True):
    """A rearranged copy, and the shapes of its tensors."""
    after = onnx.ModelProto()
    after.CopyFrom(before)
    arrange(after.graph, integers_out=integers_out, pairs=pairs)
    return after, {tensor.name: list(tensor.dims) for tensor in after.graph.initializer}


def require_same(before, after, pixels):
    """Both give the same numbers bit by bit, and not the same everywhere."""
    for old, new in zip(run(before, pixels), run(after, pixels), strict=True):
        np.testing.assert_array_equal(new, old)
        assert np.ptp(old) > 0


def run(model, pixels):
    return InferenceSession(model.SerializeToString()).run(None, {"features": pixels})


def operators(model):
    return [node.op_type for node in model.graph.node]


@pytest.mark.parametrize("first", [1, 3, 5])
@pytest.mark.parametrize("size", [(4, 4), (8, 20), (36, 28)])
def test_integers_are_the_same_bit_by_bit(integers, rng, size, first):
    before = integers(first=first)
    after, shapes = arranged(before)
    pixels = rng.integers(0, 256, (1, *size, 5), np.uint8)
    require_same(before, after, pixels)
    assert "Resize" in operators(before)
    assert "Resize" not in operators(after)
    (entry,) = [node for node in after.graph.node if node.name == "enter"]
    assert shapes["enter.weight_quantized"][:2] == [2 * PLANES, 10]
    assert entry.op_type == "Conv"


def test_a_doubling_of_what_others_take_stays_and_no_pixels_are_paired(integers, rng):
    before = integers(finest=10, rises=False)
    after, shapes = arranged(before)
    pixels = rng.integers(0, 256, (1, 8, 20, 5), np.uint8)
    require_same(before, after, pixels)
    assert operators(before).count("Resize") == 2
    assert operators(after).count("Resize") == 1
    assert shapes["enter.weight_quantized"][:2] == [10, 5]


def test_pixels_are_paired_only_where_it_is_asked_for(integers, rng):
    before = integers()
    after, shapes = arranged(before, pairs=False)
    require_same(before, after, rng.integers(0, 256, (1, 12, 16, 5), np.uint8))
    assert shapes["enter.weight_quantized"][:2] == [PLANES, 5]
    assert "Resize" not in operators(after)


def test_many_planes_are_not_paired(integers, rng):
    before = integers(finest=32)
    after, shapes = arranged(before)
    pixels = rng.integers(0, 256, (1, 12, 16, 5), np.uint8)
    require_same(before, after, pixels)
    assert shapes["enter.weight_quantized"][:2] == [32, 5]


def test_outputs_stay_integers_whose_steps_the_file_tells(integers, rng):
    before = integers()
    after, _ = arranged(before, integers_out=True)
    pixels = rng.integers(0, 256, (1, 8, 12, 5), np.uint8)
    found = interface_of(parse_onnx(after.SerializeToString()).graph)
    assert [(planes.count, planes.reduction) for planes in found.outputs] == [
        (7, 1),
        (6, 2),
        (5, 4),
    ]
    for old, new, planes in zip(
        run(before, pixels), run(after, pixels), found.outputs, strict=True
    ):
        assert new.dtype == np.uint8
        assert planes.steps is not None
        numbers = (new.astype(np.float32) - planes.steps.zero) * np.float32(planes.steps.scale)
        np.testing.assert_array_equal(numbers, old)
    with pytest.raises(InputError, match="logits_0 must be made of integers"):
        arrange(after.graph, integers_out=True, pairs=True)


def test_a_file_tells_the_same_planes_before_and_after(integers):
    before = integers()
    told = interface_of(parse_onnx(before.SerializeToString()).graph)
    assert arrange(before.graph, integers_out=False, pairs=True)
    found = interface_of(parse_onnx(before.SerializeToString()).graph)
    assert found.outputs == told.outputs == (Planes(7, 1), Planes(6, 2), Planes(5, 4))
    assert found.steps == told.steps
    assert found.multiplications > told.multiplications  # by those with 0


@pytest.mark.parametrize(("size", "step", "pads"), [(3, 1, 1), (1, 1, 0), (5, 1, 2), (3, 2, 1)])
def test_weights_of_pairs_give_what_those_of_pixels_give(rng, size, step, pads):
    pixels = rng.integers(-9, 9, (2, 10))  # planes, columns of one row
    weights = rng.integers(-9, 9, (3, 2, 1, size))
    line = np.pad(pixels, ((0, 0), (pads, pads)))
    expected = np.array(
        [
            [np.sum(line[:, at : at + size] * kernel[:, 0]) for at in range(0, 10, step)]
            for kernel in weights
        ]
    )
    given = weights if step == 2 else np.concatenate([weights, weights])
    of_pairs, before, after = paired(given, step, (pads, pads))
    pairs = (
        pixels.reshape(2, 5, 2).transpose(2, 0, 1).reshape(4, 5)
    )  # the left pixel's planes first
    line = np.pad(pairs, ((0, 0), (before, after)))
    wide = of_pairs.shape[3]
    found = np.array(
        [[np.sum(line[:, at : at + wide] * kernel[:, 0]) for at in range(5)] for kernel in of_pairs]
    )
    if step == 1:
        found = found.reshape(2, 3, 5).transpose(1, 2, 0).reshape(3, 10)
    np.testing.assert_array_equal(found, expected)

"""What rounded weights shift is taken off biases."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")

import onnx
from onnx import helper, numpy_helper
from onnxruntime import InferenceSession
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static

from stillray_export.bias_correction import correct_biases

PLANES = 6


def network(rng):
    """Two convolutions, the first of which few integers hold: one of its weights is far larger."""
    tensors = {}
    nodes, source = [], "features"
    for name in ("first", "second"):
        weights = rng.normal(size=(PLANES, PLANES, 3, 3)) / 10
        weights[:, 0, 1, 1] = 12
        tensors |= {f"{name}.weight": weights, f"{name}.bias": rng.normal(size=PLANES)}
        made = f"{name} made"
        nodes.append(
            helper.make_node(
                "Conv", [source, f"{name}.weight", f"{name}.bias"], [made], pads=[1] * 4
            )
        )
        source = made
    features, logits = (
        helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [1, PLANES, 24, 24])
        for name in ("features", source)
    )
    kept = [
        numpy_helper.from_array(array.astype(np.float32), name) for name, array in tensors.items()
    ]
    graph = helper.make_graph(nodes, "g", [features], [logits], kept)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)


class Reader(CalibrationDataReader):
    def __init__(self, features):
        self._left = iter(features)

    def get_next(self):
        found = next(self._left, None)
        return None if found is None else {"features": found}


def integers_of(floats, features, folder):
    given, made = folder / "floats.onnx", folder / "int8.onnx"
    onnx.save(floats, given)
    quantize_static(
        given, made, Reader(features), quant_format=QuantFormat.QDQ, per_channel=True,
        activation_type=QuantType.QUInt8, weight_type=QuantType.QInt8,
    )  # fmt: skip
    return onnx.load(made)


def shifts(floats, integers, features):
    """How far the mean of each plane is off, in standard deviations of the plane."""
    wanted, found = (
        np.concatenate(
            [
                InferenceSession(m.SerializeToString()).run(None, {"features": f})[0]
                for f in features
            ]
        )
        for m in (floats, integers)
    )
    return np.abs((found - wanted).mean((0, 2, 3))) / wanted.std((0, 2, 3))


def frames(rng, count=3):
    # some planes change little, as a frame's do: rounding their weights shifts all pixels
    level = np.linspace(0, 1, PLANES).reshape(1, -1, 1, 1)
    return [(level + 0.1 * rng.random((1, PLANES, 24, 24))).astype("f4") for _ in range(count)]


def test_a_frame_beyond_the_scales_shifts_no_others(rng, tmp_path):
    floats, seen, unseen = network(rng), frames(rng, 5), frames(rng)
    found = []
    for more in ([], [40 * seen[0]]):
        integers = integers_of(floats, seen, tmp_path)
        correct_biases(floats, integers, [*seen, *more])
        found.append(shifts(floats, integers, unseen))
    np.testing.assert_allclose(found[1], found[0], atol=0.05)


def test_means_are_those_of_floats_on_frames_that_were_not_seen(rng, tmp_path):
    floats, seen, unseen = network(rng), frames(rng), frames(rng)
    integers = integers_of(floats, seen, tmp_path)
    before = shifts(floats, integers, unseen)
    correct_biases(floats, integers, seen)
    after = shifts(floats, integers, unseen)
    assert before.mean() > 0.05
    assert after.mean() < before.mean() / 4
    assert after.max() < 0.05

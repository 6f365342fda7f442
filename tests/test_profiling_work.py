from __future__ import annotations

import pytest

onnx = pytest.importorskip("onnx")

from stillray.profiling.work import network_work  # noqa: E402
from stillray.registry import find_model  # noqa: E402


def test_a_chain_of_convolutions_is_counted_by_hand():
    products = 5 * 5 * (12 * 16 + 16 * 16 + 16 * 12)
    assert network_work(find_model("wskp-3").path, 33, 18).operations == 2 * products * 33 * 18


def test_strided_and_coarse_convolutions_count_at_their_own_size(tmp_path):
    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    weights = [
        onnx.numpy_helper.from_array(array, name)
        for name, array in (
            ("first", onnx.numpy_helper.np.ones((4, 3, 3, 3), "float32")),
            ("second", onnx.numpy_helper.np.ones((2, 4, 1, 1), "float32")),
        )
    ]
    nodes = [
        helper.make_node("Conv", ["x", "first"], ["y"], strides=[2, 2], pads=[1, 1, 1, 1]),
        helper.make_node("Conv", ["y", "second"], ["z"]),
    ]
    graph = helper.make_graph(
        nodes,
        "two",
        [helper.make_tensor_value_info("x", kind, [1, 3, "h", "w"])],
        [helper.make_tensor_value_info("z", kind, [1, 2, "a", "b"])],
        weights,
    )
    path = tmp_path / "two.onnx"
    # the oldest format that all versions of ONNX Runtime read
    onnx.save(
        helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9), path
    )
    assert network_work(path, 8, 12).operations == 2 * 4 * 6 * (3 * 3 * 3 * 4 + 4 * 2)

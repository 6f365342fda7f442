from __future__ import annotations

import dataclasses

import pytest

onnx = pytest.importorskip("onnx")

from stillray.frame import Frame  # noqa: E402
from stillray.models.registry import find_model  # noqa: E402
from stillray.pipeline.denoiser import Denoiser  # noqa: E402
from stillray.profiling.cost import Cost, network_cost, stage_costs  # noqa: E402
from stillray.profiling.machine import PeakRates  # noqa: E402
from stillray.profiling.measure import ORDER  # noqa: E402
from stillray.profiling.scaling import with_kernels  # noqa: E402
from stillray.profiling.synthetic import swing  # noqa: E402


def test_a_chain_of_convolutions_is_counted_by_hand():
    # 6x6 pixels make a square of 2x2, 3x3 of those the next, and twelve logits a pixel in the end
    products = 6 * 6 * 8 * 32 + 3 * 3 * (32 * 32 + 32 * 4 * 12)
    assert network_cost(find_model("wskp-3s").path, 34, 18).operations == 2 * products * 17 * 9


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
        helper.make_node("Conv", ["features", "first"], ["y"], strides=[2, 2], pads=[1, 1, 1, 1]),
        helper.make_node("Conv", ["y", "second"], ["z"]),
    ]
    graph = helper.make_graph(
        nodes,
        "two",
        [helper.make_tensor_value_info("features", kind, [1, 3, "h", "w"])],
        [helper.make_tensor_value_info("z", kind, [1, 2, "a", "b"])],
        weights,
    )
    path = tmp_path / "two.onnx"
    # the oldest format that all versions of ONNX Runtime read
    onnx.save(
        helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9), path
    )
    assert network_cost(path, 8, 12).operations == 2 * 4 * 6 * (3 * 3 * 3 * 4 + 4 * 2)


def test_a_model_s_work_is_that_of_its_padded_size():
    # a kernel pyramid's input is rounded up to 16 pixels
    info = find_model("kpyr-5")
    frame = swing(33, 18)[0]
    got = stage_costs(info, frame)["network"]
    assert got.operations == network_cost(info.path, 48, 32).operations


def test_a_model_that_doubles_works_at_the_picture_s_size():
    info = find_model("munet-x2")
    frame = swing(17, 20)[0]  # 34 x 40 pixels of the picture, in cells of 8
    got = stage_costs(info, frame)["network"]
    assert got.operations == network_cost(info.path, 40, 40).operations


def test_the_floor_is_the_dearer_of_operations_and_bytes():
    peaks = PeakRates(operations=2e9, bandwidth=1e9)
    assert Cost(operations=4e6, bytes=1e6).roofline(peaks) == pytest.approx(2)
    assert Cost(operations=4e6, bytes=3e6).roofline(peaks) == pytest.approx(3)


@pytest.mark.parametrize("model", ["kpyr-5", "wskp-mr", "munet-x2"])
def test_every_stage_that_runs_has_work_and_less_buffers_are_less_of_it(model):
    info = find_model(model)
    full = swing(16, 24)[0]
    with Denoiser(info) as denoiser:
        for _ in range(2):
            denoiser.denoise(full)
        assert set(denoiser.last_timings) <= set(stage_costs(info, full))
    bare = stage_costs(info, Frame(color=full.color))
    assert bare["inspect"].bytes == 3 * 4 * 16 * 24
    assert bare["encode"].bytes < stage_costs(info, full)["encode"].bytes


@pytest.mark.parametrize("model", ["kpyr-5", "kpyr-5-still", "nbg-2x3", "wskp-3", "munet-x2"])
def test_no_stage_is_left_out_of_the_table(model):
    with Denoiser(model, threads=1) as denoiser:
        for frame in swing(24, 32)[:2]:
            denoiser.denoise(frame)
            assert set(denoiser.last_timings) <= set(ORDER)


def test_reconstruction_counts_kernels_and_not_their_sizes():
    def operations(*sizes):
        info = find_model("wskp-3s")
        changed = dataclasses.replace(info, spec=with_kernels(info.spec, sizes))
        return stage_costs(changed, swing(16, 24)[0])["reconstruct"].operations

    assert operations(3) == operations(31)
    assert operations(3, 5) > 1.8 * operations(3)

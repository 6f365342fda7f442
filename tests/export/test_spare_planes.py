"""Networks of integers with planes that say nothing give the same integers."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

import onnx
from onnx import helper, numpy_helper
from onnxruntime import InferenceSession

from stillray.arrays.workspace import Workspace
from stillray.errors import InputError
from stillray.models.onnx_file import parse_onnx
from stillray.models.precision import int8_path, is_made_of, pairs_path
from stillray.models.registry import find_model
from stillray.models.session import checked
from stillray.models.steps import PLACES_KEY, in_steps
from stillray_export import spare_planes
from stillray_export.integer_layout import arrange
from stillray_export.quantize import quantized
from stillray_export.spare_planes import add_spare_planes


def network(rng, path, *, features, outputs, size=3):
    """A network of one convolution in, its half a resolution lower, and one out."""
    nodes, tensors = [], {}

    def convolve(name, taken, planes, step, kernel):
        tensors[f"{name}.weight"] = rng.normal(size=(*planes, kernel, kernel)) / kernel
        tensors[f"{name}.bias"] = rng.normal(size=planes[0])
        pads = [(kernel - 1) // 2] * 4
        given = [taken, f"{name}.weight", f"{name}.bias"]
        shape = {"kernel_shape": [kernel] * 2, "strides": [step] * 2, "pads": pads}
        nodes.append(helper.make_node("Conv", given, [name], name=name, **shape))

    convolve("enter", "features", (16, features), 1, 3)
    nodes.append(helper.make_node("Relu", ["enter"], ["top"]))
    convolve("logits_1", "top", (outputs, 16), 2, 3)
    convolve("logits_0", "top", (outputs, 16), 1, size)
    given = helper.make_tensor_value_info("features", 1, [1, features, "height", "width"])
    made = [helper.make_tensor_value_info(f"logits_{level}", 1, None) for level in (0, 1)]
    held = [
        numpy_helper.from_array(np.asarray(value, np.float32), name)
        for name, value in tensors.items()
    ]
    graph = helper.make_graph(nodes, "g", [given], made, held)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    onnx.save(model, path)
    return quantized(path, [rng.normal(size=(1, features, 16, 24)).astype(np.float32)])


def planes_in_steps(model, planes):
    """Pixels as the runtime makes them for a network."""
    data = model.SerializeToString()
    layout = checked(data, "test")[1].layout
    shape = (*planes.shape[1:], layout.size)
    return in_steps(planes, layout, np.empty(shape, np.uint8), Workspace())


def outputs_of(model, planes):
    session = InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    return session.run(None, {"features": planes_in_steps(model, planes)[None]})


@pytest.mark.parametrize("pairs", [False, True])
@pytest.mark.parametrize("integers_out", [False, True])
@pytest.mark.parametrize(("features", "outputs"), [(13, 26), (9, 20), (10, 17), (16, 26), (16, 24)])
def test_what_a_network_gives_is_the_same_bit_by_bit(
    rng, tmp_path, features, outputs, pairs, integers_out
):
    before = network(rng, tmp_path / "floats.onnx", features=features, outputs=outputs)
    assert arrange(before.graph, integers_out=integers_out, pairs=pairs) == pairs
    after = onnx.ModelProto()
    after.CopyFrom(before)
    assert add_spare_planes(after.graph, pairs=pairs) == (outputs != 24)
    planes = rng.normal(size=(features, 12, 20)).astype(np.float32)
    for old, new in zip(outputs_of(before, planes), outputs_of(after, planes), strict=True):
        np.testing.assert_array_equal(new, old)
        assert np.ptp(old) > 0
    _, told = checked(before.SerializeToString(), "before")
    _, found = checked(after.SerializeToString(), "after")
    assert (found.features, found.outputs) == (features, told.outputs)


def test_convolutions_are_of_multiples_that_are_quick(rng, tmp_path):
    for pairs, multiple in ((False, 8), (True, 4)):
        made = network(rng, tmp_path / "floats.onnx", features=13, outputs=26)
        arrange(made.graph, integers_out=True, pairs=pairs)
        add_spare_planes(made.graph, pairs=pairs)
        shapes = {tensor.name: tensor.dims for tensor in made.graph.initializer}
        for name in ("enter", "logits_0", "logits_1"):
            count, taken, *_ = shapes[f"{name}.weight_quantized"]
            assert count % multiple == taken % 4 == 0
            assert shapes[f"{name}.bias_quantized"] == [count]
        (features,) = made.graph.input
        assert features.type.tensor_type.shape.dim[3].dim_value == (14 if pairs else 16)
        assert not add_spare_planes(made.graph, pairs=pairs)  # it has them


def test_single_pixels_and_few_planes_stay_as_they_are(rng, tmp_path):
    for size, outputs in ((1, 26), (3, 12)):
        made = network(rng, tmp_path / "floats.onnx", features=8, outputs=outputs, size=size)
        arrange(made.graph, integers_out=True, pairs=False)
        add_spare_planes(made.graph, pairs=False)
        shapes = {tensor.name: tensor.dims for tensor in made.graph.initializer}
        assert shapes["logits_0.weight_quantized"][0] == outputs


def test_spare_integers_of_a_pixel_count_nothing(rng, tmp_path):
    made = network(rng, tmp_path / "floats.onnx", features=13, outputs=26)
    arrange(made.graph, integers_out=True, pairs=False)
    add_spare_planes(made.graph, pairs=False)
    session = InferenceSession(made.SerializeToString())
    pixels = rng.integers(0, 256, (1, 12, 16, 16), np.uint8)
    other = pixels.copy()
    other[..., 13:] = 255 - other[..., 13:]
    for one, two in zip(
        *(session.run(None, {"features": x}) for x in (pixels, other)), strict=True
    ):
        np.testing.assert_array_equal(one, two)


def test_a_file_must_tell_as_many_places_as_it_takes_features(rng, tmp_path):
    made = network(rng, tmp_path / "floats.onnx", features=13, outputs=26)
    arrange(made.graph, integers_out=True, pairs=False)
    add_spare_planes(made.graph, pairs=False)
    (told,) = [entry for entry in made.metadata_props if entry.key == PLACES_KEY]
    assert sorted(json.loads(told.value)) == list(range(13))
    told.value = json.dumps([*range(12), 16])
    with pytest.raises(InputError, match=r"stillray\.places must hold some of 16 places"):
        checked(made.SerializeToString(), "told wrongly")


def test_files_that_were_made_before_get_them(rng, tmp_path):
    model = find_model("kpyr-5-still")
    floats = Path(shutil.copy(model.path, tmp_path))
    pixels, pairs = int8_path(floats), pairs_path(floats)
    planes = rng.normal(size=(1, 13, 32, 48)).astype(np.float32)
    made = quantized(floats, [planes])
    for path in (pixels, pairs):
        network = onnx.ModelProto()
        network.CopyFrom(made)
        assert arrange(network.graph, integers_out=True, pairs=path == pairs) == (path == pairs)
        onnx.save(network, path)
    before = [outputs_of(onnx.load(path), planes[0]) for path in (pixels, pairs)]
    spare_planes.main(str(floats))
    files = [path.read_bytes() for path in (pixels, pairs)]
    assert is_made_of(pixels, floats)
    assert is_made_of(pairs, pixels)
    for path, width, given in ((pixels, 16, before[0]), (pairs, 14, before[1])):
        assert parse_onnx(path.read_bytes()).graph.inputs[0].shape[3] == width
        for old, new in zip(given, outputs_of(onnx.load(path), planes[0]), strict=True):
            np.testing.assert_array_equal(new, old)
    spare_planes.main(str(floats))  # they have them
    assert [path.read_bytes() for path in (pixels, pairs)] == files

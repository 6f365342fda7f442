"""A network in integers of 8 bits computes what it did in floats, to their rounding."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")

from onnx import numpy_helper  # noqa: E402

from stillray.arrays.workspace import Workspace  # noqa: E402
from stillray.models.precision import chosen, int8_path  # noqa: E402
from stillray.models.registry import SPEC_KEY, find_model  # noqa: E402
from stillray.models.session import open_session, read_checked  # noqa: E402
from stillray.models.steps import in_steps  # noqa: E402
from stillray_export.quantize import features_of, quantized  # noqa: E402

ROOM = Path(__file__).parents[1] / "data" / "room"


def test_integers_compute_what_floats_do_and_know_their_file(tmp_path, rng):
    model = find_model("wskp-3s")
    features = [rng.random((1, len(model.spec.network.features), 32, 48), np.float32)] * 2
    copied = tmp_path / "small.onnx"
    copied.write_bytes(model.path.read_bytes())
    integers = int8_path(copied)
    integers.write_bytes(quantized(copied, features).SerializeToString())
    assert chosen(copied, "int8", None) == integers
    file, interface = read_checked(integers)
    assert interface.outputs == model.interface.outputs
    assert json.loads(file.metadata[SPEC_KEY])["name"] == "wskp-3s"
    assert file.graph.tensors["network.blocks.0.0.weight_quantized"].dtype == np.int8
    assert interface.steps is not None
    pixels = np.empty((32, 48, interface.features), np.uint8)
    in_steps(features[0][0], interface.layout, pixels, Workspace())
    of_floats, of_integers = (
        open_session(path, threads=1).run(None, {"features": given})[0]
        for path, given in ((copied, features[0]), (integers, pixels[None]))
    )
    step = np.ptp(of_floats) / 255
    assert 0 < np.abs(of_integers - of_floats).mean() < 3 * step


def test_frames_of_several_sizes_give_the_network_that_their_common_part_gives(rng):
    model = find_model("wskp-3s")
    planes = rng.random((1, len(model.spec.network.features), 34, 50), np.float32)
    part = planes[..., :32, :48]
    mixed, alike = (quantized(model.path, given) for given in ([part, planes], [part, part]))
    assert mixed.SerializeToString() == alike.SerializeToString()


def test_biases_are_those_of_floats_unless_they_take_back_what_rounding_shifts(rng):
    model = find_model("wskp-3s")
    features = [rng.random((1, len(model.spec.network.features), 32, 48), np.float32)]
    given = arrays(onnx.load(model.path))
    kept = arrays(quantized(model.path, features, shift_biases=False))
    shifted = arrays(quantized(model.path, features))
    biases = [name for name in given if name.endswith(".bias")]
    moved = 0
    for name in biases:
        step = kept[f"{name}_quantized_scale"]
        whole = np.abs(kept[f"{name}_quantized"] * step - given[name])
        assert (whole <= 0.51 * step).all()
        moved += np.abs(shifted[f"{name}_quantized"] - kept[f"{name}_quantized"]).sum()
    assert biases
    assert moved > 0


def arrays(network: onnx.ModelProto) -> dict[str, np.ndarray]:
    return {tensor.name: numpy_helper.to_array(tensor) for tensor in network.graph.initializer}


def test_scales_are_of_first_second_and_last_frames_and_of_one_between():
    model = find_model("kpyr-5s")
    third, sixth = (list(features_of(model, ROOM, between)) for between in (0, 3))
    assert [array.shape[:2] for array in third] == [(1, 10)] * 4
    same = [np.array_equal(one, other) for one, other in zip(third, sixth, strict=True)]
    assert same == [True, True, False, True]
    again = list(features_of(model, ROOM, 5))  # the last is there already: it begins anew
    assert all(np.array_equal(one, other) for one, other in zip(third, again, strict=True))

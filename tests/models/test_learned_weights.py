"""Files of models that learn: their weights may be given anew, and nothing else is let in."""

import os
from pathlib import Path

import numpy as np
import pytest

onnx = pytest.importorskip("onnx")

from onnx.reference import ReferenceEvaluator  # noqa: E402

from stillray.errors import InputError  # noqa: E402
from stillray.models.network import Network  # noqa: E402
from stillray.models.onnx_file import with_constants  # noqa: E402
from stillray.models.registry import find_model, steps_of  # noqa: E402


def pooling(model):
    return next(node for node in model.graph.node if node.op_type == "MaxPool")


def first_weights(model):
    return next(t for t in model.graph.initializer if t.name == "down_0_0.weight")


def other_window(model):
    attribute = next(a for a in pooling(model).attribute if a.name == "kernel_shape")
    attribute.ints[:] = [3, 3]


def no_strides(model):
    node = pooling(model)
    kept = [a for a in node.attribute if a.name != "strides"]
    del node.attribute[:]
    node.attribute.extend(kept)


def other_shape(model):
    model.graph.input[1].type.tensor_type.shape.dim[0].dim_value += 1


def free_shape(model):
    model.graph.input[1].type.tensor_type.shape.dim[0].dim_param = "n"


def fewer(model):
    del model.graph.input[3]


def turned(model):
    first, second = (onnx.ValueInfoProto.FromString(v.SerializeToString())
                     for v in model.graph.input[1:3])  # fmt: skip
    del model.graph.input[1:3]
    model.graph.input.insert(1, second)
    model.graph.input.insert(2, first)


def twice(model):
    model.graph.input.append(model.graph.input[1])


def unknown(model):
    model.graph.initializer.remove(first_weights(model))


@pytest.mark.parametrize(
    "bend", [other_window, no_strides, other_shape, free_shape, fewer, turned, twice, unknown]
)
def test_a_bent_file_is_refused(tmp_path, bend):
    model = onnx.load(str(find_model("online").path))
    bend(model)
    path = tmp_path / "bent.onnx"
    onnx.save(model, str(path))
    with pytest.raises(InputError, match=r"bent\.onnx"):
        find_model(path)


def test_an_ordinary_model_takes_no_weights(tmp_path):
    """Its weights are the file's: what is an input could be anything by the time it runs."""
    model = onnx.load(str(find_model("fast").path))
    tensor = model.graph.initializer[0]
    model.graph.input.append(
        onnx.helper.make_tensor_value_info(tensor.name, tensor.data_type, tensor.dims)
    )
    path = tmp_path / "bent.onnx"
    onnx.save(model, str(path))
    with pytest.raises(InputError, match="weights"):
        find_model(path)


def test_a_file_of_ones_own_is_taken(tmp_path):
    model = onnx.load(str(find_model("online").path))
    tensor = first_weights(model)
    tensor.raw_data = np.zeros(tuple(tensor.dims), np.float32).tobytes()
    path = tmp_path / "mine.onnx"
    onnx.save(model, str(path))
    assert find_model(path).family == "cross-regression"


def test_families_that_learn_alone_have_a_step():
    assert steps_of("kernel-pyramid") == {}
    assert steps_of("cross-regression")["train_step"].is_file()


def network_of(path, **options):
    return Network(path, threads=1, providers=None, **options)


def test_weights_are_taken_anew_whenever_they_change(rng):
    """As the reference of ONNX runs the file, which has them as inputs."""
    path = find_model("online").path
    file = onnx.load(str(path))
    reference = ReferenceEvaluator(file)
    features = rng.random((1, 15, 12, 20)).astype(np.float32)
    held = {t.name: onnx.numpy_helper.to_array(t) for t in file.graph.initializer}
    weights = {source.name: held[source.name] for source in file.graph.input[1:]}
    others = {n: rng.normal(0, 0.2, w.shape).astype(np.float32) for n, w in weights.items()}
    one = {"out.bias": np.full_like(weights["out.bias"], 3)}
    network = network_of(path)
    for given in ({}, others, others, weights, one, {}):
        inputs = {"features": features, **given}
        (expected,) = reference.run(None, inputs)
        found = network.run("network", inputs)["parameters"]
        np.testing.assert_allclose(found, expected[0], rtol=1e-3, atol=1e-3)
    for values in others.values():  # what was given is not held on to
        values[:] = 0
    assert np.ptp(network.run("network", {"features": features, **others})["parameters"]) == 0
    network.close()


def test_weights_are_constants_and_nothing_else_of_the_file_changes():
    data = find_model("online-warm").path.read_bytes()
    before = onnx.load_from_string(data)
    names = [source.name for source in before.graph.input[1:]]
    after = onnx.load_from_string(with_constants(data, names, {}))
    assert [source.name for source in after.graph.input] == ["features"]
    after.graph.input.extend(before.graph.input[1:])
    assert after == before


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="tells memory in use on Linux")
def test_a_network_that_is_closed_gives_its_memory_back():
    def used():  # MiB
        return (
            int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") >> 20
        )

    features = np.zeros((1, 15, 1024, 1024), np.float32)
    network_of(find_model("online").path).close()
    before = used()
    network = network_of(find_model("online").path)
    network.run("network", {"features": features})
    held = used() - before
    network.close()
    assert held > 150
    assert used() - before < held / 3

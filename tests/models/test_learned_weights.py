"""Files of models that learn: their weights may be given anew, and nothing else is let in."""

import numpy as np
import pytest

onnx = pytest.importorskip("onnx")

from stillray.errors import InputError  # noqa: E402
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

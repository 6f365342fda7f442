"""Model files that somebody bent, on purpose or not: ``python -m tests.model_spec.bent_models
SEED COUNT FOLDER``.

Run as a program of its own, so that a crash or a hang inside a C++ library is seen by the test that
starts it and cannot take the test run with it. Each model must denoise two frames, or be refused
in one line, within 30 seconds of processor time and 2 GiB of memory. `KINDS` names those that once
were not; `bend` makes others at random.
"""

from __future__ import annotations

import json
import resource
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

import stillray
from stillray.models.registry import PROVENANCE_KEY, SPEC_KEY

MODELS = Path(stillray.__file__).parent / "models"
SECONDS = 30  # of processor time, a model
MOST_MEMORY = 2 * 2**30
EXTREMES: tuple[Any, ...] = (
    0, -1, 1, 2, 3, 200_001, 10**9, 2**31, 2**63, 10**30, 0.5, -0.0, 1e-40, 1e308, float("inf"),
    float("nan"), True, None, "", "x" * 10_000, "\x1b[31mred", [], [3] * 1000, [[[]]], {}, {"a": 1},
)  # fmt: skip

Bend = Callable[[onnx.ModelProto], None]


def whole(name: str = "wskp-3s") -> onnx.ModelProto:
    """A model as it comes with stillray."""
    return onnx.load(str(MODELS / f"{name}.onnx"))


def set_metadata(model: onnx.ModelProto, key: str, text: str) -> None:
    """Replace an entry of a model's metadata."""
    for entry in model.metadata_props:
        if entry.key == key:
            entry.value = text


def spec_of(model: onnx.ModelProto) -> dict[str, Any]:
    """The specification in a model, as nested dictionaries."""
    return json.loads(next(e.value for e in model.metadata_props if e.key == SPEC_KEY))


def in_spec(*path: str, value: Any) -> Bend:
    """Set one value of the specification."""

    def bend(model: onnx.ModelProto) -> None:
        spec = spec_of(model)
        owner = spec
        for key in path[:-1]:
            owner = owner[key]
        owner[path[-1]] = value
        set_metadata(model, SPEC_KEY, json.dumps(spec))

    return bend


def as_metadata(key: str, text: str) -> Bend:
    """Set a whole entry of the metadata."""
    return lambda model: set_metadata(model, key, text)


def with_node(operator: str, outputs: int = 1, **attributes: Any) -> Bend:
    """Put a node between the features and the first convolution."""

    def bend(model: onnx.ModelProto) -> None:
        names = [f"bent{index}" for index in range(outputs)]
        node = helper.make_node(operator, ["features"], names, **attributes)
        model.graph.node[0].input[0] = names[0]
        model.graph.node.insert(0, node)

    return bend


def in_first_convolution(**attributes: Any) -> Bend:
    """Set attributes of the first convolution."""

    def bend(model: onnx.ModelProto) -> None:
        node = model.graph.node[0]
        kept = [a for a in node.attribute if a.name not in attributes]
        del node.attribute[:]
        node.attribute.extend([*kept, *(helper.make_attribute(*a) for a in attributes.items())])

    return bend


def _endless_loop(model: onnx.ModelProto) -> None:
    body = helper.make_graph(
        [
            helper.make_node("Identity", ["go"], ["on"]),
            helper.make_node("Identity", ["carried"], ["out"]),
        ],
        "body",
        [
            helper.make_tensor_value_info("count", TensorProto.INT64, []),
            helper.make_tensor_value_info("go", TensorProto.BOOL, []),
            helper.make_tensor_value_info("carried", TensorProto.FLOAT, None),
        ],
        [
            helper.make_tensor_value_info("on", TensorProto.BOOL, []),
            helper.make_tensor_value_info("out", TensorProto.FLOAT, None),
        ],
    )
    model.graph.initializer.append(numpy_helper.from_array(np.array(True), "true"))
    node = helper.make_node("Loop", ["", "true", "features"], ["bent"], body=body)
    model.graph.node[0].input[0] = "bent"
    model.graph.node.insert(0, node)


def _folded_constant(model: onnx.ModelProto) -> None:
    size = numpy_helper.from_array(np.array([2**31], np.int64), "size")
    model.graph.initializer.append(size)
    model.graph.node.insert(0, helper.make_node("ConstantOfShape", ["size"], ["gigabytes"]))


def _external_data(model: onnx.ModelProto) -> None:
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", "/etc/passwd"


def _function(model: onnx.ModelProto) -> None:
    node = helper.make_node("Relu", ["x"], ["y"])
    opset = [helper.make_opsetid("", 18)]
    model.functions.append(helper.make_function("bent", "Relu2", ["x"], ["y"], [node], opset))


def _foreign_operator(model: onnx.ModelProto) -> None:
    model.opset_import.append(helper.make_opsetid("com.microsoft", 1))
    with_node("Gelu", domain="com.microsoft")(model)


def _doubled_planes(model: onnx.ModelProto) -> None:
    last = "features"
    for index in range(40):
        node = helper.make_node("Concat", [last, last], [f"double{index}"], axis=1)
        model.graph.node.insert(index, node)
        last = f"double{index}"


def _long_chain(model: onnx.ModelProto) -> None:
    size = numpy_helper.from_array(np.zeros((1000, 1000, 1, 1), np.float32), "large")
    narrow = numpy_helper.from_array(np.zeros((1000, 8, 1, 1), np.float32), "narrow")
    model.graph.initializer.extend([size, narrow])
    nodes = [helper.make_node("Conv", ["features", "narrow"], ["wide0"])]
    nodes += [helper.make_node("Conv", [f"wide{i}", "large"], [f"wide{i + 1}"]) for i in range(500)]
    for index, node in enumerate(nodes):
        model.graph.node.insert(index, node)


def _enlarged(model: onnx.ModelProto) -> None:
    scales = numpy_helper.from_array(np.array([1, 1, 1e4, 1e4], np.float32), "scales")
    model.graph.initializer.append(scales)
    model.graph.node[0].input[0] = "large"
    model.graph.node.insert(0, helper.make_node("Resize", ["features", "", "scales"], ["large"]))


def _first_weights(value: float) -> Bend:
    def bend(model: onnx.ModelProto) -> None:
        tensor = model.graph.initializer[0]
        values = numpy_helper.to_array(tensor).copy()
        values.flat[0] = value
        tensor.CopyFrom(numpy_helper.from_array(values, tensor.name))

    return bend


def _claimed_size(model: onnx.ModelProto) -> None:
    model.graph.initializer[0].dims[0] = 2**40


def _renamed_input(model: onnx.ModelProto) -> None:
    model.graph.input[0].name = "picture"
    model.graph.node[0].input[0] = "picture"


def _flat_input(model: onnx.ModelProto) -> None:
    del model.graph.input[0].type.tensor_type.shape.dim[2:]


def _fixed_input(model: onnx.ModelProto) -> None:
    model.graph.input[0].type.tensor_type.shape.dim[2].dim_value = 64


def _circle(model: onnx.ModelProto) -> None:
    model.graph.node[0].input[0] = model.graph.node[1].output[0]


def _without_provenance(model: onnx.ModelProto) -> None:
    del model.metadata_props[1]


_DEEP = "[" * 100_000
_PLENTY = json.dumps({"parameters": 1, "scores": {"psnr": 1e300}})

#: What must be refused: name to how a model of `whole` is bent, and a part of the message.
KINDS: dict[str, tuple[Bend, str]] = {
    "kernel of 200001": (in_spec("decoder", "kernel_sizes", value=[200_001]), "1 to 127 pixels"),
    "kernel of 1e9": (in_spec("decoder", "kernel_sizes", value=[10**9 + 1]), "1 to 127 pixels"),
    "no kernels": (in_spec("decoder", "kernel_sizes", value=[]), "number of decoder.kernel_sizes"),
    "other kernels": (in_spec("decoder", "kernel_sizes", value=[3, 5]), "must give what its"),
    "other block": (in_spec("network", "block", value=1), "must give what its"),
    "other features": (in_spec("network", "features", value=["depth"]), "the 1 features of"),
    "no features": (in_spec("network", "features", value=[]), "must not be empty"),
    "local size": (in_spec("transfer", "local_size", value=10**9 + 1), "1 to 255 pixels"),
    "not a number": (in_spec("transfer", "middle", value=float("nan")), "got nan"),
    "huge integer": (in_spec("transfer", "middle", value=10**400), "must be of type float"),
    "escape in a name": (in_spec("name", value="\x1b[2Jgone"), "printable"),
    "path as a name": (in_spec("name", value="../../etc/x"), "without slashes"),
    "deep specification": (as_metadata(SPEC_KEY, _DEEP), "must be JSON"),
    "long specification": (as_metadata(SPEC_KEY, " " * 10**6), "characters at most"),
    "list as specification": (as_metadata(SPEC_KEY, "[1]"), "must be a table"),
    "no provenance": (_without_provenance, "no stillray.provenance"),
    "provenance null": (as_metadata(PROVENANCE_KEY, "null"), "must be a table"),
    "provenance a list": (as_metadata(PROVENANCE_KEY, "[]"), "must be a table"),
    "deep provenance": (as_metadata(PROVENANCE_KEY, _DEEP), "provenance cannot be used"),
    "infinite parameters": (as_metadata(PROVENANCE_KEY, '{"parameters": 1e999}'), "a count"),
    "scores beyond all": (as_metadata(PROVENANCE_KEY, _PLENTY), "scores must be numbers"),
    "endless loop": (_endless_loop, "tensor true must hold float32"),
    "folded constant": (_folded_constant, "got ConstantOfShape"),
    "external data": (_external_data, "which no export writes"),
    "function": (_function, "field 25, which no export writes"),
    "foreign operator": (_foreign_operator, "needs operators of com.microsoft"),
    "unknown operator": (with_node("Softmax", axis=1), "got Softmax"),
    "doubled planes": (_doubled_planes, "more than 1024"),
    "much work": (_long_chain, "multiplications a pixel"),
    "enlarged": (_enlarged, "must double what was reduced"),
    "pads": (in_first_convolution(pads=[10**9] * 4), "must keep the size"),
    "dilations": (in_first_convolution(dilations=[10**6] * 2), "must have dilations"),
    "group": (in_first_convolution(group=2), "must have group 1"),
    "strides": (in_first_convolution(strides=[0, 0]), "must have strides"),
    "kernel shape": (in_first_convolution(kernel_shape=[10**9, 3]), "must have kernel_shape"),
    "infinite weight": (_first_weights(float("inf")), "not finite"),
    "claimed size": (_claimed_size, "has not the size that it claims"),
    "renamed input": (_renamed_input, "the one input must be features"),
    "flat input": (_flat_input, "must have shape (1, planes, height, width)"),
    "fixed input": (_fixed_input, "must have shape (1, planes, height, width)"),
    "circle": (_circle, "which nothing has given"),
}


def bend(name: str, rng: np.random.Generator) -> bytes:
    """A model with one fault or a few, of its specification, its graph or its bytes."""
    model = whole(name)
    kind = int(rng.integers(4))
    if kind == 0:
        spec = spec_of(model)
        for _ in range(int(rng.integers(1, 3))):
            _bend_value(spec, rng)
        set_metadata(model, SPEC_KEY, json.dumps(spec))
    elif kind == 1:
        for _ in range(int(rng.integers(1, 3))):
            _bend_graph(model, rng)
    data = bytearray(model.SerializeToString())
    for _ in range(int(rng.integers(1, 4)) if kind > 1 else 0):
        _bend_bytes(data, rng)
    return bytes(data)


def _bend_value(spec: dict[str, Any], rng: np.random.Generator) -> None:
    owner: Any = spec
    while True:
        keys = list(owner) if isinstance(owner, dict) else list(range(len(owner)))
        if not keys:
            return
        key = keys[int(rng.integers(len(keys)))]
        if isinstance(owner[key], dict | list) and rng.random() < 0.9:
            owner = owner[key]
            continue
        value = owner[key]
        if isinstance(value, int | float) and rng.random() < 0.4:
            owner[key] = value + type(value)(rng.integers(-3, 4))
        else:
            owner[key] = EXTREMES[int(rng.integers(len(EXTREMES)))]
        return


def _bend_graph(model: onnx.ModelProto, rng: np.random.Generator) -> None:
    graph = model.graph
    if not graph.node or not graph.output:  # an earlier fault took all of them
        return
    node = graph.node[int(rng.integers(len(graph.node)))]
    names = [n for other in graph.node for n in (*other.input, *other.output)]
    name = names[int(rng.integers(len(names)))]
    kind = rng.integers(8)
    if kind == 0 and node.input:
        node.input[int(rng.integers(len(node.input)))] = name
    elif kind == 1:
        node.op_type = ("Relu", "Conv", "Add", "Loop", "Expand", "")[int(rng.integers(6))]
    elif kind == 2:
        graph.node.remove(node)
    elif kind == 3:
        graph.node.insert(0, node)
    elif kind == 4 and node.attribute:
        attribute = node.attribute[int(rng.integers(len(node.attribute)))]
        value = int((0, -1, 2, 7, 10**9, 2**62)[int(rng.integers(6))])
        if attribute.ints:
            attribute.ints[int(rng.integers(len(attribute.ints)))] = value
        else:
            attribute.i = value
    elif kind == 5:
        tensor = graph.initializer[int(rng.integers(len(graph.initializer)))]
        if tensor.dims:
            tensor.dims[int(rng.integers(len(tensor.dims)))] = int(2 ** rng.integers(0, 62))
    elif kind == 6:
        graph.output[int(rng.integers(len(graph.output)))].name = name
    else:
        del graph.output[int(rng.integers(len(graph.output)))]


def _bend_bytes(data: bytearray, rng: np.random.Generator) -> None:
    # weights are most of a file, and seldom of interest: what surrounds them lies at both ends
    near = int(rng.integers(1, min(len(data), 6000)))
    at = near if rng.random() < 0.5 else len(data) - near
    kind = rng.integers(5)
    if kind == 0:
        data[at] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        data[at : at + 4] = rng.bytes(4)
    elif kind == 2:
        del data[at : at + int(rng.integers(1, 40))]
    elif kind == 3:
        data[at:at] = data[at : at + int(rng.integers(1, 200))]
    else:
        data[at : at + 9] = b"\xff" * 9


def attempt(path: Path) -> bool:
    """Whether a model denoises two frames; raises what is not an `InputError` of one line."""
    rng = np.random.default_rng(0)
    try:
        with stillray.Denoiser(path, threads=1) as denoiser:
            for _ in range(2):
                frame = stillray.Frame(color=rng.random((20, 28, 3), np.float32))
                picture = denoiser.denoise(frame)
                assert picture.shape == frame.color.shape
    except stillray.InputError as error:
        message = str(error)
        assert message.strip(), "an error without words"
        assert "\n" not in message, message
        assert len(message) < 1000, message
        return False
    return True


def main() -> None:
    """Bend models one after the other, and try each."""
    seed, count, folder = int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])
    folder.mkdir(parents=True, exist_ok=True)
    names = ("wskp-3s", "nbg-2x1", "kpyr-5s")
    path, ran = folder / "bent.onnx", 0
    for number in range(count):
        path.write_bytes(bend(names[number % len(names)], np.random.default_rng((seed, number))))
        print(number, flush=True)  # the last one printed is the one that crashed
        signal.setitimer(signal.ITIMER_PROF, SECONDS)  # ends the process, wherever it hangs
        with np.errstate(all="ignore"):
            ran += attempt(path)
        most = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        assert most < MOST_MEMORY, f"{most} bytes were taken"
    path.unlink()
    print(f"{ran} of {count} denoised")


if __name__ == "__main__":
    main()

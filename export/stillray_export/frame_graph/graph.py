"""From a module to an ONNX graph that accelerators and browsers take."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence

import numpy as np
import onnx
import torch
from onnx import helper, numpy_helper
from torch import Tensor, nn

OPSET = 18
_DOMAIN = "stillray"
_NETWORK = "Network"


class Placeholder(nn.Module):
    """Stands for a network whose graph is put in later, by `traced`.

    Parameters
    ----------
    outputs
        Planes of each of its outputs, and the pixels along an axis that one of theirs is of.
    """

    def __init__(self, outputs: Sequence[tuple[int, int]]) -> None:
        super().__init__()
        self.outputs = tuple(outputs)

    def forward(self, features: Tensor) -> tuple[Tensor, ...]:
        """``(1, features, h, w)`` to logits of the right sizes."""
        found: tuple[Tensor, ...] = _Node.apply(features, self.outputs)
        return found


class _Node(torch.autograd.Function):
    @staticmethod
    def forward(ctx, features, outputs):  # type: ignore[no-untyped-def]
        height, width = features.shape[2:]
        return tuple(
            features.new_zeros(1, planes, height // by, width // by) for planes, by in outputs
        )

    @staticmethod
    def symbolic(g, features, outputs):  # type: ignore[no-untyped-def]
        found = g.op(f"{_DOMAIN}::{_NETWORK}", features, outputs=len(outputs))
        # types, else the exporter complains of each
        for value, (planes, _) in zip(found, outputs, strict=True):
            value.setType(features.type().with_sizes([1, planes, None, None]))
        return found


def traced(
    module: nn.Module,
    example: Sequence[Tensor],
    names: tuple[Sequence[str], Sequence[str]],
    network: onnx.ModelProto,
    sizes: tuple[int, int] = (0, 1),
) -> onnx.ModelProto:
    """The graph of a module, with a network's own in the place of its `Placeholder`.

    By the exporter that traces: sizes stay what they were computed from. The other one proves
    relations between sizes, for an hour of a graph of so many pyramids of odd sizes.

    Parameters
    ----------
    module, example
        What is traced, and tensors that it takes.
    names
        Of inputs and outputs.
    network
        Of one input; its outputs are the placeholder's.
    sizes
        Axes of inputs that are height and width, of any number of pixels.
    """
    given, left = names
    file = io.BytesIO()
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # of constants that are folded, and of the exporter's age
        torch.onnx.export(
            module,
            tuple(example),
            file,  # type: ignore[arg-type]  # the tracing exporter takes one
            input_names=list(given),
            output_names=list(left),
            opset_version=OPSET,
            dynamo=False,
            custom_opsets={_DOMAIN: 1},
            dynamic_axes={
                name: {axis: f"{name} {axis}" for axis in sizes}
                for name, tensor in zip(given, example, strict=True)
                if tensor.ndim > 1
            },
        )
    model = onnx.load_model_from_string(file.getvalue())
    graph = model.graph
    _constants_apart(graph)
    _insert(graph, network.graph)
    _slices_for_splits(graph)
    _without_repeats(graph)
    _without_unused(graph)
    _short_names(graph)
    del graph.value_info[:]
    del model.opset_import[:]
    model.opset_import.append(helper.make_opsetid("", OPSET))
    return model


def _constants_apart(graph: onnx.GraphProto) -> None:
    """Constants as initializers, each value once."""
    nodes = list(graph.node)
    del graph.node[:]
    known: dict[tuple[object, ...], str] = {}
    instead: dict[str, str] = {}
    for node in nodes:
        if node.op_type != "Constant":
            node.input[:] = [instead.get(name, name) for name in node.input]
            graph.node.append(node)
            continue
        array = numpy_helper.to_array(node.attribute[0].t)
        key = (str(array.dtype), array.shape, array.tobytes())
        name = node.output[0]
        if key not in known:
            known[key] = name
            graph.initializer.append(numpy_helper.from_array(array, name))
        instead[name] = known[key]


def _insert(graph: onnx.GraphProto, network: onnx.GraphProto) -> None:
    """Put a network's nodes in the place of the node that stands for them."""
    nodes = list(graph.node)
    (at,) = (i for i, node in enumerate(nodes) if node.domain == _DOMAIN)
    place = nodes[at]
    names = {network.input[0].name: place.input[0]}
    names |= {value.name: name for value, name in zip(network.output, place.output, strict=True)}

    def renamed(name: str) -> str:
        return names.get(name, f"network {name}") if name else ""

    inside = []
    for node in network.node:
        copy = onnx.NodeProto()
        copy.CopyFrom(node)
        copy.input[:] = [renamed(name) for name in node.input]
        copy.output[:] = [renamed(name) for name in node.output]
        inside.append(copy)
    for tensor in network.initializer:
        copied = onnx.TensorProto()
        copied.CopyFrom(tensor)
        copied.name = renamed(tensor.name)
        graph.initializer.append(copied)
    del graph.node[:]
    graph.node.extend([*nodes[:at], *inside, *nodes[at + 1 :]])


def _slices_for_splits(graph: onnx.GraphProto) -> None:
    """Slices instead of Splits, and nothing of parts without planes.

    Parts of size 0 fail in browsers, and many outputs of one node are more buffers than WebGPU
    binds: it then computes NaN and says nothing.
    """
    values = {tensor.name: tensor for tensor in graph.initializer}
    nodes = list(graph.node)
    del graph.node[:]
    empty: set[str] = set()
    for node in nodes:
        if node.op_type == "Concat":
            node.input[:] = [name for name in node.input if name not in empty]
        if set(node.input) & empty and node.op_type != "Concat":
            empty.update(node.output)  # computed of nothing
            continue
        if node.op_type != "Split":
            graph.node.append(node)
            continue
        sizes = numpy_helper.to_array(values[node.input[1]])
        axis = next(part.i for part in node.attribute if part.name == "axis")
        ends = np.cumsum(sizes)
        for name, size, end in zip(node.output, sizes, ends, strict=True):
            if size == 0:
                empty.add(name)
                continue
            given = [
                _integer(graph, values, number) for number in (int(end - size), int(end), axis)
            ]
            graph.node.append(helper.make_node("Slice", [node.input[0], *given], [name]))


def _integer(graph: onnx.GraphProto, values: dict[str, onnx.TensorProto], number: int) -> str:
    name = f"integer {number}"
    if name not in values:
        values[name] = numpy_helper.from_array(np.array([number], np.int64), name)
        graph.initializer.append(values[name])
    return name


def _without_repeats(graph: onnx.GraphProto) -> None:
    """Each computation once: tracing repeats those of sizes wherever one is asked for."""
    kept = {value.name for value in graph.output}
    known: dict[tuple[object, ...], list[str]] = {}
    instead: dict[str, str] = {}
    nodes = list(graph.node)
    del graph.node[:]
    for node in nodes:
        node.input[:] = [instead.get(name, name) for name in node.input]
        attributes = sorted(part.SerializeToString(deterministic=True) for part in node.attribute)
        key = (node.op_type, tuple(node.input), tuple(attributes), len(node.output))
        if key in known and not kept & set(node.output):
            instead.update(zip(node.output, known[key], strict=True))
            continue
        known.setdefault(key, list(node.output))
        graph.node.append(node)


def _without_unused(graph: onnx.GraphProto) -> None:
    """Only what leads to outputs."""
    needed = {value.name for value in graph.output}
    nodes = []
    for node in reversed(graph.node):
        if needed & set(node.output):
            needed.update(node.input)
            nodes.append(node)
    del graph.node[:]
    graph.node.extend(reversed(nodes))
    tensors = [tensor for tensor in graph.initializer if tensor.name in needed]
    del graph.initializer[:]
    graph.initializer.extend(tensors)


def _short_names(graph: onnx.GraphProto) -> None:
    """Numbers for names, which are a third of the file; those of inputs and outputs stay."""
    names = {value.name: value.name for value in (*graph.input, *graph.output)}

    def short(name: str) -> str:
        return names.setdefault(name, f"v{len(names)}") if name else ""

    for tensor in graph.initializer:
        tensor.name = short(tensor.name)
    for node in graph.node:
        node.input[:] = [short(name) for name in node.input]
        node.output[:] = [short(name) for name in node.output]
        node.name = node.doc_string = ""
        del node.metadata_props[:]


def expanded(graph: onnx.GraphProto, name: str, shape: Sequence[int | str]) -> None:
    """Let an input of 1 in the place of sizes stand for one filled with its value.

    Parameters
    ----------
    graph
        Changed.
    name
        Of the input.
    shape
        Numbers, and for a size the name of the input that has it on the same axis.
    """
    source = next(part for part in shape if isinstance(part, str))
    fixed = [part for part in shape if not isinstance(part, str)]
    full, size, whole = (f"{name} {part}" for part in ("full", "size", "shape"))
    count = len(shape) - len(fixed)
    nodes = [helper.make_node("Shape", [source], [size], start=0, end=count)]
    if fixed:
        graph.initializer.append(numpy_helper.from_array(np.array(fixed, np.int64), f"{name} rest"))
        nodes.append(helper.make_node("Concat", [size, f"{name} rest"], [whole], axis=0))
    nodes.append(helper.make_node("Expand", [name, whole if fixed else size], [full]))
    for node in graph.node:
        node.input[:] = [full if part == name else part for part in node.input]
    rest = list(graph.node)
    del graph.node[:]
    graph.node.extend([*nodes, *rest])

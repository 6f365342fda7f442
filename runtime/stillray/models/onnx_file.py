"""A model's .onnx file, read strictly before ONNX Runtime sees it.

Whoever runs a model that somebody else made runs that person's data through a C++ library with
many operators: loops that never end, constants that fold to gigabytes, tensors kept in other files.
Here a file is taken apart by the protobuf wire format, without the onnx package, and refused unless
it holds no more than `stillray-export` writes: one graph of nodes and tensors that lie in the file
itself, float32 or, of a network of 8-bit integers, integers. What the nodes may be says
`stillray.models.network_graph`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Mapping
from dataclasses import dataclass
from functools import partial
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray.models.protobuf import MAX_VALUES, Field, Wire, WireError, field_of

#: Bytes of a file: forty times the largest that comes with stillray. Tensors lie within it.
MAX_BYTES = 100 * 2**20
MAX_NODES = 2000
_FLOAT, _UINT8, _INT64 = 1, 2, 7  # of TensorProto.DataType
_QUANTIZED: dict[int, np.dtype[Any]] = {
    _UINT8: np.dtype("u1"),
    3: np.dtype("i1"),
    6: np.dtype("<i4"),
}
_MOST_AXES = 8

_text = partial(Field, kind="text")
_several = partial(Field, repeated=True)
_GRAPH_OF_MODEL, _INITIALIZER, _INPUT = 7, 5, 11  # fields of the messages below
_MODEL = {
    1: Field("ir_version", "int"),
    2: _text("producer_name"),
    3: _text("producer_version"),
    4: _text("domain"),
    5: Field("model_version", "int"),
    6: _text("doc_string"),
    _GRAPH_OF_MODEL: Field("graph", "bytes"),
    8: _several("opset_import", "bytes"),
    14: _several("metadata_props", "bytes"),
}
_ENTRY = {1: _text("key"), 2: _text("value")}
_OPSET = {1: _text("domain"), 2: Field("version", "int")}
_GRAPH = {
    1: _several("node", "bytes"),
    2: _text("name"),
    _INITIALIZER: _several("initializer", "bytes"),
    10: _text("doc_string"),
    _INPUT: _several("input", "bytes"),
    12: _several("output", "bytes"),
    13: _several("value_info", "skip"),
    16: _several("metadata_props", "skip"),
}
_NODE = {
    1: _several("input", "text"),
    2: _several("output", "text"),
    3: _text("name"),
    4: _text("op_type"),
    5: _several("attribute", "bytes"),
    6: _text("doc_string"),
    7: _text("domain"),
    9: _several("metadata_props", "skip"),
}
_ATTRIBUTE = {
    1: _text("name"),
    2: Field("f", "float"),
    3: Field("i", "int"),
    4: _text("s"),
    7: _several("floats", "float"),
    8: _several("ints", "int"),
    13: _text("doc_string"),
    20: Field("type", "int"),
}
_TENSOR_ATTRIBUTE = {5: Field("t", "bytes")}
_ATTRIBUTE_TYPES = {1: "f", 2: "i", 3: "s", 6: "floats", 7: "ints"}
_TENSOR = {
    1: _several("dims", "int"),
    2: Field("data_type", "int"),
    4: _several("float_data", "float"),
    8: _text("name"),
    9: Field("raw_data", "bytes"),
    12: _text("doc_string"),
    16: _several("metadata_props", "skip"),
}
_VALUE = {
    1: _text("name"),
    2: Field("type", "bytes"),
    3: _text("doc_string"),
    4: _several("metadata_props", "skip"),
}
_TYPE = {1: Field("tensor", "bytes"), 6: _text("denotation")}
_TENSOR_TYPE = {1: Field("elements", "int"), 2: Field("shape", "bytes")}
_SHAPE = {1: _several("dimension", "bytes")}
_DIMENSION = {1: Field("value", "int"), 2: _text("symbol"), 3: _text("denotation")}


@dataclass(frozen=True, kw_only=True)
class Node:
    """One operation."""

    operator: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: Mapping[str, Any]  # float, int, str, or a tuple of floats or ints


@dataclass(frozen=True, kw_only=True)
class Source:
    """What a graph is given: the name, and each axis as a number, or None where that is free.

    Numbers are float32, or ``integers`` without a sign, of 8 bits.
    """

    name: str
    shape: tuple[int | None, ...]
    integers: bool = False


@dataclass(frozen=True, kw_only=True)
class Graph:
    """Nodes in the order in which they run, and the tensors that come with them."""

    nodes: tuple[Node, ...]
    # float32, finite; int64 of one number, which says where to cut, or of the four of a shape;
    # uint8, int8 and int32, which stand for other numbers
    tensors: Mapping[str, np.ndarray]
    inputs: tuple[Source, ...]
    outputs: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class OnnxFile:
    """A file's bytes, and what they hold."""

    data: bytes
    metadata: Mapping[str, str]
    graph: Graph


def read_bytes(path: Path) -> bytes:
    """The bytes of a model file.

    Raises
    ------
    InputError
        It is missing, cannot be read or is too large; the message begins with the path.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such model file")
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path}: not a usable ONNX model: it has more than {MAX_BYTES} bytes")
        with path.open("rb") as file:
            return file.read(MAX_BYTES)  # a file that grows meanwhile is cut, and refused for it
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def parse_onnx(data: bytes) -> OnnxFile:
    """Take a model apart.

    Raises
    ------
    WireError
        It is not ONNX, or holds what no export of stillray writes.
    """
    wire = Wire()
    model = wire.decode("model", memoryview(data), _MODEL)
    if "graph" not in model:
        raise WireError("it holds no graph")
    for opset in model["opset_import"]:
        if domain := wire.decode("operator set", opset, _OPSET).get("domain", ""):
            raise WireError(f"it needs operators of {domain}")
    metadata = _metadata(wire, model)
    return OnnxFile(data=data, metadata=metadata, graph=_graph(wire, model["graph"]))


def with_constants(data: bytes, names: Container[str], values: Mapping[str, np.ndarray]) -> bytes:
    """A model that `parse_onnx` takes, whose inputs of some names are none any more.

    Parameters
    ----------
    data
        Of the file.
    names
        Of inputs for which the file holds tensors: those are constants then.
    values
        Which to hold for some of them instead, float32.
    """
    wire = Wire()

    def source(chunk: memoryview) -> memoryview | None:
        return None if wire.decode("input", chunk, _VALUE).get("name") in names else chunk

    def tensor(chunk: memoryview) -> bytes | memoryview:
        name = wire.decode("tensor", chunk, _TENSOR).get("name", "")
        return _tensor_of(name, values[name]) if name in values else chunk

    def graph(chunk: memoryview) -> bytes:
        return wire.changed("graph", chunk, {_INPUT: source, _INITIALIZER: tensor})

    return wire.changed("model", memoryview(data), {_GRAPH_OF_MODEL: graph})


def metadata_of(data: bytes) -> dict[str, str]:
    """The metadata of a model alone, whatever its graph is.

    Raises
    ------
    WireError
        It is not ONNX.
    """
    wire = Wire()
    return _metadata(wire, wire.decode("model", memoryview(data), _MODEL))


def operators_of(data: bytes, most_nodes: int) -> Counter[str]:
    """How many nodes of each operator a larger graph than a network's has, of tensors of any type.

    Raises
    ------
    WireError
        It is not ONNX, needs other libraries or files, holds graphs in its nodes, or too many.
    """
    wire = Wire(MAX_VALUES * most_nodes // MAX_NODES)
    model = wire.decode("model", memoryview(data), _MODEL)
    if "graph" not in model:
        raise WireError("it holds no graph")
    graph = wire.decode("graph", model["graph"], _GRAPH)
    if len(graph["node"]) > most_nodes:
        raise WireError(f"it has {len(graph['node'])} nodes, more than {most_nodes}")
    for chunk in graph["initializer"]:
        wire.decode("tensor", chunk, _TENSOR)  # one in another file has fields that this lacks
    operators: Counter[str] = Counter()
    for chunk in graph["node"]:
        node = wire.decode("node", chunk, _NODE)
        if domain := node.get("domain", ""):
            raise WireError(f"it needs the operator {node.get('op_type', '')} of {domain}")
        for attribute in node["attribute"]:
            wire.decode("attribute", attribute, _ATTRIBUTE | _TENSOR_ATTRIBUTE)
        operators[node.get("op_type", "")] += 1
    return operators


def _metadata(wire: Wire, model: Mapping[str, Any]) -> dict[str, str]:
    metadata: dict[str, str] = {}
    for entry in model["metadata_props"]:
        pair = wire.decode("metadata", entry, _ENTRY)
        if pair.get("key", "") in metadata:
            raise WireError(f"its metadata hold {pair.get('key', '')} twice")
        metadata[pair.get("key", "")] = pair.get("value", "")
    return metadata


def _graph(wire: Wire, data: memoryview) -> Graph:
    graph = wire.decode("graph", data, _GRAPH)
    if len(graph["node"]) > MAX_NODES:
        raise WireError(f"it has {len(graph['node'])} nodes, more than {MAX_NODES}")
    tensors: dict[str, np.ndarray] = {}
    for chunk in graph["initializer"]:
        name, tensor = _tensor(wire, chunk)
        if name in tensors:
            raise WireError(f"two of its tensors are called {name}")
        tensors[name] = tensor
    return Graph(
        nodes=tuple(_node(wire, chunk) for chunk in graph["node"]),
        tensors=tensors,
        inputs=tuple(_source(wire, chunk) for chunk in graph["input"]),
        outputs=tuple(
            wire.decode("output", chunk, _VALUE).get("name", "") for chunk in graph["output"]
        ),
    )


def _tensor(wire: Wire, data: memoryview) -> tuple[str, np.ndarray]:
    tensor = wire.decode("tensor", data, _TENSOR)
    name, shape = tensor.get("name", ""), tensor["dims"]
    if tensor.get("data_type") == _INT64:
        return name, _places(name, tensor)
    if tensor.get("data_type") in _QUANTIZED:
        return name, _integers(name, tensor, _QUANTIZED[tensor["data_type"]])
    if tensor.get("data_type") != _FLOAT:
        raise WireError(f"its tensor {name} must hold float32, or integers of 8 or 32 bits")
    raw, listed = tensor.get("raw_data", memoryview(b"")), tensor["float_data"]
    size = len(raw) + 4 * len(listed)
    if len(shape) > _MOST_AXES or min(shape, default=1) < 1 or 4 * prod(shape) != size:
        raise WireError(f"its tensor {name} has not the size that it claims")
    if raw and listed:
        raise WireError(f"its tensor {name} holds its numbers in two ways")
    values = np.array(listed, np.float32) if listed else np.frombuffer(raw, "<f4")
    if not np.isfinite(values).all():
        raise WireError(f"its tensor {name} holds numbers that are not finite")
    return name, values.reshape(shape)


def _tensor_of(name: str, values: np.ndarray) -> bytes:
    """The message that `_tensor` reads."""
    return b"".join(
        [
            *(field_of(1, size) for size in values.shape),
            field_of(2, _FLOAT),
            field_of(8, name.encode()),
            field_of(9, values.astype("<f4").tobytes()),
        ]
    )


def _places(name: str, tensor: Mapping[str, Any]) -> np.ndarray:
    """A place along an axis, one int64, or the four of a shape."""
    raw = tensor.get("raw_data", memoryview(b""))
    if list(tensor["dims"]) not in ([1], [4]) or 8 * tensor["dims"][0] != len(raw):
        raise WireError(f"its tensor {name} of int64 must hold one number, or four")
    if tensor["float_data"]:
        raise WireError(f"its tensor {name} holds its numbers in two ways")
    return np.frombuffer(raw, "<i8")


def _integers(name: str, tensor: Mapping[str, Any], kind: np.dtype[Any]) -> np.ndarray:
    """Numbers in steps of a scale that a node has beside them."""
    raw, shape = tensor.get("raw_data", memoryview(b"")), tensor["dims"]
    whole = prod(shape) * kind.itemsize == len(raw)
    if len(shape) > _MOST_AXES or min(shape, default=1) < 1 or not whole or tensor["float_data"]:
        raise WireError(f"its tensor {name} has not the size that it claims")
    return np.frombuffer(raw, kind).reshape(shape)


def _node(wire: Wire, data: memoryview) -> Node:
    node = wire.decode("node", data, _NODE)
    operator = node.get("op_type", "")
    if domain := node.get("domain", ""):
        raise WireError(f"it needs the operator {operator} of {domain}")
    attributes: dict[str, Any] = {}
    for chunk in node["attribute"]:
        attribute = wire.decode(f"{operator} node's attribute", chunk, _ATTRIBUTE)
        name = attribute.get("name", "")
        kind = _ATTRIBUTE_TYPES.get(attribute.get("type", 0))
        if kind is None or kind not in attribute or name in attributes:
            raise WireError(f"its {operator} node's attribute {name} is of no known type")
        value = attribute[kind]
        attributes[name] = tuple(value) if isinstance(value, list) else value
    return Node(
        operator=operator,
        inputs=tuple(node["input"]),
        outputs=tuple(node["output"]),
        attributes=attributes,
    )


def _source(wire: Wire, data: memoryview) -> Source:
    value = wire.decode("input", data, _VALUE)
    name = value.get("name", "")
    kind = wire.decode(f"input {name}", value.get("type", memoryview(b"")), _TYPE)
    tensor = wire.decode(f"input {name}", kind.get("tensor", memoryview(b"")), _TENSOR_TYPE)
    if tensor.get("elements") not in (_FLOAT, _UINT8):
        raise WireError(f"its input {name} must be float32 or uint8")
    shape = wire.decode(f"input {name}", tensor.get("shape", memoryview(b"")), _SHAPE)
    axes = [wire.decode(f"input {name}", chunk, _DIMENSION) for chunk in shape["dimension"]]
    return Source(
        name=name,
        shape=tuple(axis.get("value") for axis in axes),
        integers=tensor["elements"] == _UINT8,
    )

"""What a frame graph's file says of its inputs and outputs; nothing of it is run.

A frame graph is one ONNX file for a whole frame, with all stages and the state, for engines that
embed ONNX Runtime themselves, and for `stillray.Denoiser` on a device; ``stillray-export NAME
--frame-graph`` makes it.
"""

from __future__ import annotations

import dataclasses
import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from stillray.errors import InputError
from stillray.models.network_graph import OPERATORS as NETWORK_OPERATORS
from stillray.models.onnx_file import metadata_of, operators_of, read_bytes
from stillray.models.protobuf import WireError

#: Metadata of the file that holds inputs and outputs as JSON.
PORTS_KEY = "stillray.ports"
#: Before ``.onnx`` in its name.
FRAME_SUFFIX = ".frame"
#: The same, of a graph that denoises each frame alone.
SPATIAL_SUFFIX = ".spatial"
#: What its nodes may be, beside a network's: arithmetic and moves of numbers, no control flow.
OPERATORS = frozenset(NETWORK_OPERATORS) | {
    "Abs", "And", "AveragePool", "Cast", "Ceil", "ConstantOfShape", "DepthToSpace", "Div",
    "Equal", "Exp", "Expand", "Flatten", "Floor", "Gather", "Greater", "GreaterOrEqual",
    "Identity", "Less", "LessOrEqual", "Log", "MatMul", "Max", "Min", "Mod", "Neg", "Or", "Pad",
    "Pow", "Range", "Reciprocal", "ReduceMax", "ReduceMean", "ReduceMin", "ReduceSum",
    "Reshape", "Round", "Shape", "Softmax", "Sqrt", "Squeeze", "Sub", "Transpose", "Unsqueeze",
    "Where",
}  # fmt: skip
_MAX_NODES = 10_000
_MAX_CHARACTERS = 2**18
_MAX_PORTS = 64


@dataclass(frozen=True, kw_only=True)
class Port:
    """One input or output of a frame graph, float32.

    Attributes
    ----------
    name
        In the graph.
    shape
        Of numbers and names of sizes, as text.
    unit, convention
        What its numbers mean.
    neutral
        Of an input that may be left out: the value that says so, in every element; a tensor with
        1 in the place of height and width does. Empty: it must be given.
    next
        Of a state: the output that is this input for the next frame.
    """

    name: str
    shape: str
    unit: str
    convention: str
    neutral: str = ""
    next: str = ""


@dataclass(frozen=True, kw_only=True)
class Ports:
    """All inputs and outputs of a frame graph, in order."""

    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]

    def to_json(self) -> str:
        """As a file's metadata hold them."""
        return json.dumps(dataclasses.asdict(self))


@dataclass(frozen=True, kw_only=True)
class FrameGraphFile:
    """What a frame graph's file tells.

    Attributes
    ----------
    ports
        What the graph takes and gives.
    metadata
        All that the file says of itself, by key.
    operators
        How many nodes it has of each operator, the most frequent first.
    size_bytes
        The file's.
    """

    ports: Ports
    metadata: Mapping[str, str]
    operators: Mapping[str, int]
    size_bytes: int


def find_frame_graph(name: str) -> Path:
    """The file of a frame graph, by its path or by its model's name in this folder.

    Raises
    ------
    InputError
        There is none: the message says how to make it.
    """
    path = Path(name)
    if path.suffix != ".onnx":
        path = Path(f"{name}{FRAME_SUFFIX}.onnx")
    if not path.is_file():
        model = path.name.removesuffix(".onnx").removesuffix(FRAME_SUFFIX)
        raise InputError(
            f"{path}: no such frame graph; stillray-export {model} --frame-graph makes it"
        )
    return path


def read_frame_graph(path: Path) -> FrameGraphFile:
    """What a frame graph's file tells; whether each operator may be in it is not looked at.

    Raises
    ------
    InputError
        The file cannot be read, is not ONNX, holds graphs in its nodes or needs other files, or
        tells of no inputs and outputs.
    """
    data = read_bytes(path)
    try:
        metadata = metadata_of(data)
    except WireError as error:
        raise InputError(f"{path}: not a usable ONNX model: {error}") from None
    if PORTS_KEY not in metadata:
        raise InputError(f"{path}: not a frame graph: no {PORTS_KEY} in its metadata")
    try:
        ports = _ports(metadata[PORTS_KEY])
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: its inputs and outputs cannot be read: {error}") from None
    return FrameGraphFile(
        ports=ports,
        metadata=metadata,
        operators=dict(_operators(data, path).most_common()),
        size_bytes=len(data),
    )


def describe_graph(operators: Mapping[str, int], size_bytes: int) -> str:
    """Size and nodes by operator of a graph, in a line."""
    listed = ", ".join(f"{count} {name}" for name, count in operators.items())
    return f"{size_bytes / 1e6:.2f} MB, {sum(operators.values())} nodes: {listed}"


def checked_bytes(path: Path) -> bytes:
    """The bytes of a frame graph that holds none but `OPERATORS`, and all of itself.

    How much work and memory it takes is not known from that.

    Raises
    ------
    InputError
        The file cannot be read, or holds what `stillray-export` does not write.
    """
    data = read_bytes(path)
    if others := _operators(data, path).keys() - OPERATORS:
        raise InputError(
            f"{path}: not a usable frame graph: it holds operators that no export writes: "
            f"{', '.join(sorted(others))}"
        )
    return data


def _operators(data: bytes, path: Path) -> Counter[str]:
    try:
        return operators_of(data, _MAX_NODES)
    except WireError as error:
        raise InputError(f"{path}: not a usable frame graph: {error}") from None


def _ports(text: str) -> Ports:
    if len(text) > _MAX_CHARACTERS:
        raise ValueError(f"they have more than {_MAX_CHARACTERS} characters")
    told = json.loads(text)
    if not isinstance(told, dict) or set(told) != {"inputs", "outputs"}:
        raise ValueError("they must be a table of inputs and outputs")
    return Ports(inputs=_listed(told["inputs"]), outputs=_listed(told["outputs"]))


def _listed(ports: object) -> tuple[Port, ...]:
    if not isinstance(ports, list) or len(ports) > _MAX_PORTS:
        raise ValueError(f"they must be lists of {_MAX_PORTS} at most")
    names = {field.name for field in dataclasses.fields(Port)}
    for port in ports:
        if not isinstance(port, dict) or set(port) != names:
            raise ValueError(f"each must have {', '.join(sorted(names))}")
        if not all(isinstance(text, str) and text.isprintable() for text in port.values()):
            raise ValueError("each must be told in printable text")
    return tuple(Port(**port) for port in ports)

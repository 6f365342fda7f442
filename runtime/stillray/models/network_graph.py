"""What a model's network may be made of, and what it gives: known before it is run.

`OPERATORS` are those that `stillray-export` writes, each with its rule. All of them keep to images
whose size is the frame's over a whole number, so that a walk through the graph says how many planes
come out at which resolution, and how much work a pixel is; both have a limit. A network of another
operator needs a rule here, and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stillray.models.onnx_file import Graph, Node
from stillray.models.small_sums import MOST, neighbours_sum
from stillray.models.steps import PixelLayout, Steps

#: Of one tensor.
MAX_PLANES = 1024
#: A pixel of the frame: the models that come with stillray take up to 0.1 million.
MAX_MULTIPLICATIONS = 4_000_000
_MAX_KERNEL = 31  # pixels
_MAX_REDUCTION = 256
_RANK = 4  # axes: frame, plane, row, column
_AS_PLANES = "planes, height, width"


class GraphError(ValueError):
    """A graph that cannot be run safely: the message says what is wrong."""


#: In what order the numbers of a tensor lie: planes; pixels, ``(1, h, w, c)``; rows of pixels,
#: ``(h, 1, w, c)``; those, each twice, ``(h, 2, w, c)``.
PLANES, PIXELS, ROWS, ROWS_TWICE = "planes", "pixels", "rows", "rows twice"


@dataclass(frozen=True)
class Planes:
    """A tensor of planes.

    Attributes
    ----------
    count
        Of the planes.
    reduction
        How many times the frame is as high as they are.
    across
        How many times it is as wide, where that is another number: pixels side by side may be
        taken for one.
    steps
        Of integers of 8 bits, what they stand for; None of numbers.
    order
        In which they lie.
    """

    count: int
    reduction: int
    across: int | None = None
    steps: Steps | None = None
    order: str = PLANES

    @property
    def columns(self) -> int:
        """How many times the frame is as wide."""
        return self.reduction if self.across is None else self.across

    def of_size(self, rows: int, columns: int) -> Planes:
        """As many planes of another size, by how many times the frame is as high and wide."""
        return replace(self, reduction=rows, across=None if columns == rows else columns)


@dataclass(frozen=True, kw_only=True)
class Interface:
    """What a network takes and gives.

    Attributes
    ----------
    features
        How many it takes.
    steps
        None where the input is planes, ``(1, features, h, w)`` float32; else it is pixels,
        ``(1, h, w, n)`` uint8, each plane in steps of its own: at least as many as features.
    layout
        Where features lie in those pixels; the graph alone does not say: see
        `stillray.models.session.checked`.
    outputs
        In the order in which they are given.
    multiplications
        Of one frame, a pixel.
    weights
        Names and shapes of those tensors of the file in whose place others may be given: what a
        model has learned since.
    """

    features: int
    outputs: tuple[Planes, ...]
    multiplications: float
    weights: tuple[tuple[str, tuple[int, ...]], ...] = ()
    steps: tuple[Steps, ...] | None = None
    layout: PixelLayout | None = None


def interface_of(graph: Graph) -> Interface:
    """Walk through a graph, and learn what it takes and gives.

    Raises
    ------
    GraphError
        It holds an operator, or a use of one, that no export of stillray writes, or is too large.
    """
    features, weights = _features(graph), _weights(graph)
    tensors = dict(graph.tensors)
    pixels = _Pixels(features) if graph.inputs[0].integers else None
    known = {} if pixels else {"features": Planes(features, 1)}
    work = 0.0
    for node in graph.nodes:
        rule = OPERATORS.get(node.operator)
        if rule is None:
            raise GraphError(
                f"operators must be among {', '.join(OPERATORS)}, got {node.operator or 'none'}"
            )
        names = known.keys() | tensors.keys() | (pixels.names() if pixels else set())
        if len(node.outputs) != 1 or node.outputs[0] in names or node.outputs[0] == "features":
            raise GraphError(f"{node.operator} must give one tensor with a name of its own")
        if pixels and pixels.takes(node):
            if found := pixels.take(node, tensors):
                known[node.outputs[0]] = found
            continue
        inputs = _Inputs(node, known, tensors)
        if node.operator == _DEQUANTIZE and node.inputs and node.inputs[0] in tensors:
            tensors[node.outputs[0]] = _dequantized(node, inputs)
            continue
        made, multiplications = rule(node, inputs)
        if made.count > MAX_PLANES:
            raise GraphError(f"{node.operator} gives {made.count} planes, more than {MAX_PLANES}")
        work += multiplications / (made.reduction * made.columns)
        if work > MAX_MULTIPLICATIONS:
            raise GraphError(f"more than {MAX_MULTIPLICATIONS} multiplications a pixel")
        known[node.outputs[0]] = made
    if not graph.outputs or not set(graph.outputs) <= known.keys() - {"features"}:
        raise GraphError("every output must be what a node gives")
    if any(known[name].across or known[name].order != PLANES for name in graph.outputs):
        raise GraphError("every output must be planes of whole pixels")
    if len(set(graph.outputs)) != len(graph.outputs):
        raise GraphError("outputs must have names of their own")
    return Interface(
        features=features,
        outputs=tuple(known[name] for name in graph.outputs),
        multiplications=work,
        weights=weights,
        steps=pixels.steps() if pixels else None,
    )


def _features(graph: Graph) -> int:
    others = [source.name for source in graph.inputs if source.name not in graph.tensors]
    first = [source.name for source in graph.inputs[:1]]
    if first != ["features"] or others != ["features"]:
        names = ", ".join(others[:8])
        raise GraphError(f"the one input must be features, got {names or 'none'}")
    shape = graph.inputs[0].shape
    axis, wanted = (3, "height, width, planes") if graph.inputs[0].integers else (1, _AS_PLANES)
    free = [place for place in (1, 2, 3) if place != axis]
    if len(shape) != _RANK or shape[0] != 1 or any(shape[place] is not None for place in free):
        raise GraphError(f"features must have shape (1, {wanted}), got {shape}")
    planes = shape[axis]
    if planes is None or not 1 <= planes <= MAX_PLANES:
        raise GraphError(f"features must have 1 to {MAX_PLANES} planes, got {planes}")
    return planes


class _Pixels:
    """Integers that stand for the input's planes, on their way to becoming numbers.

    Parameters
    ----------
    features
        Planes of the input.
    """

    def __init__(self, features: int) -> None:
        self._whole = range(features)
        # names that the input has, and the planes of the input that each plane is of
        self._given: dict[str, tuple[int, ...]] = {"features": tuple(self._whole)}
        self._parts: dict[str, tuple[int, ...]] = {}
        self._steps: dict[int, Steps] = {}

    def take(self, node: Node, tensors: Mapping[str, np.ndarray]) -> Planes | None:
        """What a node makes of integers: planes of numbers; None where they stay integers.

        Raises
        ------
        GraphError
            It is none that an export of stillray writes.
        """
        name, made = node.inputs[0], node.outputs[0]
        if node.operator == "Reshape" and name == "features":
            pairs = _Inputs(node, {}, tensors).shape(1)
            wanted = (0, 0, -1, 2 * len(self._whole))
            _require(node, pairs == wanted, f"must make pairs of pixels, {wanted}, got {pairs}")
            self._given[made] = (*self._whole, *self._whole)
            return None
        if node.operator == "Transpose" and name in self._given:
            _only(node, 1, {"perm": _TO_PLANES})
            _require(node, "perm" in node.attributes, f"must have perm {_TO_PLANES}")
            self._parts[made] = self._given[name]
            return None
        _require(node, name in self._parts, "must not take the input's integers")
        part = self._parts[name]
        across = 2 if len(part) > len(self._whole) else None  # of pairs of pixels each plane twice
        inputs = _Inputs(node, {name: Planes(len(part), 1, across)}, tensors)
        if node.operator == "Slice" and across is None:
            count = _part(node, inputs)[0].count
            start = inputs.number(1)
            self._parts[made] = part[start : start + count]
            return None
        _require(node, node.operator == _DEQUANTIZE, "must not take the input's integers")
        found = _steps(node, inputs)
        for plane in part:
            _require(node, self._steps.setdefault(plane, found) == found, "must agree on steps")
        return inputs.planes(0)

    def takes(self, node: Node) -> bool:
        return any(name in self._given or name in self._parts for name in node.inputs)

    def names(self) -> set[str]:
        return {*self._given, *self._parts}

    def steps(self) -> tuple[Steps, ...]:
        """Of all planes."""
        if len(self._steps) < len(self._whole):
            raise GraphError("every plane of integers must be made numbers")
        return tuple(self._steps[plane] for plane in self._whole)


def _weights(graph: Graph) -> tuple[tuple[str, tuple[int, ...]], ...]:
    """Tensors of the file that are inputs, too: their shapes must be those of the file."""
    for source in graph.inputs[1:]:
        if source.integers:
            raise GraphError(f"input {source.name} must be float32")
        shape = graph.tensors[source.name].shape
        if source.shape != shape:
            raise GraphError(f"input {source.name} must have shape {shape}, got {source.shape}")
    found = tuple((source.name, graph.tensors[source.name].shape) for source in graph.inputs[1:])
    if len(dict(found)) != len(found):
        raise GraphError("inputs must have names of their own")
    return found


class _Inputs:
    """A node's inputs by place: planes that are known by now, or tensors of the file."""

    def __init__(
        self, node: Node, known: Mapping[str, Planes], tensors: Mapping[str, np.ndarray]
    ) -> None:
        self._node, self._known, self._tensors = node, known, tensors

    def __len__(self) -> int:
        return len(self._node.inputs)

    def planes(self, place: int) -> Planes:
        """Planes of numbers."""
        found = self.given(place)
        numbers = found.order == PLANES and found.steps is None
        _require(self._node, numbers, f"must take {self._name(place)} as planes of numbers")
        return found

    def given(self, place: int) -> Planes:
        """Planes of numbers or integers, in any order."""
        name = self._name(place)
        if name not in self._known:
            raise GraphError(f"{self._node.operator} takes {name}, which nothing has given")
        return self._known[name]

    def tensor(self, place: int) -> np.ndarray:
        name = self._name(place)
        if name not in self._tensors:
            raise GraphError(f"{self._node.operator} must take {name} from the file")
        if self._tensors[name].dtype != np.float32:
            raise GraphError(f"{self._node.operator} must take {name} as float32")
        return self._tensors[name]

    def integers(self, place: int) -> np.ndarray:
        """A tensor of the file that holds integers of 8 or 32 bits."""
        name = self._name(place)
        found = self._tensors.get(name)
        if found is None or found.dtype not in (np.uint8, np.int8, np.int32):
            raise GraphError(f"{self._node.operator} must take {name} from the file, as integers")
        return found

    def number(self, place: int) -> int:
        """A tensor of the file that holds one whole number."""
        (found, *more) = self._whole_numbers(place)
        _require(self._node, not more, f"must take one whole number for {self._name(place)}")
        return found

    def shape(self, place: int) -> tuple[int, ...]:
        """A tensor of the file that holds the four numbers of a shape."""
        found = self._whole_numbers(place)
        _require(self._node, len(found) == _RANK, f"must take a shape for {self._name(place)}")
        return found

    def _whole_numbers(self, place: int) -> tuple[int, ...]:
        name = self._name(place)
        found = self._tensors.get(name)
        if found is None or found.dtype != np.int64:
            raise GraphError(f"{self._node.operator} must take a whole number for {name}")
        return tuple(int(number) for number in found)

    def is_left_out(self, place: int) -> bool:
        return self._name(place) == ""

    def _name(self, place: int) -> str:
        if place >= len(self._node.inputs):
            raise GraphError(f"{self._node.operator} has too few inputs")
        return self._node.inputs[place]


_Rule = Callable[[Node, _Inputs], tuple[Planes, float]]


def _require(node: Node, holds: bool, rule: str) -> None:
    if not holds:
        raise GraphError(f"{node.operator} {rule}")


def _only(node: Node, inputs: int | tuple[int, int], attributes: Mapping[str, Any]) -> None:
    """Refuse other counts of inputs, unknown attributes, and values other than None or these."""
    least, most = (inputs, inputs) if isinstance(inputs, int) else inputs
    _require(node, least <= len(node.inputs) <= most, f"must have {most} inputs")
    for name, value in node.attributes.items():
        _require(node, name in attributes, f"must not have {name}")
        wanted = attributes[name]
        _require(node, wanted is None or value == wanted, f"must have {name} {wanted}, got {value}")


def _convolution(node: Node, inputs: _Inputs) -> tuple[Planes, float]:
    free = {"kernel_shape": None, "strides": None, "pads": None}
    _only(node, (2, 3), {**free, "auto_pad": "NOTSET", "group": 1, "dilations": (1, 1)})
    taken, weights = inputs.planes(0), inputs.tensor(1)
    _require(node, weights.ndim == _RANK, "must have weights of four axes")
    count, wanted, *sizes = weights.shape
    _require(node, wanted == taken.count, f"must take {wanted} planes, got {taken.count}")
    _require(node, max(sizes) <= _MAX_KERNEL, f"must look at {_MAX_KERNEL} pixels at most")
    given = node.attributes.get("kernel_shape", tuple(sizes))
    _require(node, given == tuple(sizes), f"must have kernel_shape {tuple(sizes)}, got {given}")
    if len(inputs) > 2:
        bias = inputs.tensor(2).shape
        _require(node, bias == (count,), f"must have a bias of {count} numbers, got {bias}")
    strides = node.attributes.get("strides", (1, 1))
    # of pairs of pixels every one is taken, which makes pixels of every other again
    pairs = taken.columns == 2 * taken.reduction
    known = ((1, 1), (2, 1)) if pairs else ((1, 1), (2, 2))
    _require(node, strides in known, f"must have strides of 1 or 2, got {strides}")
    pads = node.attributes.get("pads", (0, 0, 0, 0))
    _require(node, len(pads) == _RANK and min(pads) >= 0, f"must have four pads, got {pads}")
    for size, before, after, step in zip(sizes, pads[:2], pads[2:], strides, strict=True):
        # exactly a ``step``-th of the pixels comes out, from any whole number of them
        fits = size - step <= before + after < size
        _require(node, fits, f"must keep the size of images, got pads {pads}")
    rows, columns = taken.reduction * strides[0], taken.columns * strides[1]
    fits = max(rows, columns) <= _MAX_REDUCTION
    _require(node, fits, f"must reduce {_MAX_REDUCTION} times at most")
    return Planes(count, 1).of_size(rows, columns), float(weights.size)


def _pointwise(node: Node, inputs: _Inputs) -> tuple[Planes, float]:
    _only(node, 1, {})
    return inputs.planes(0), 0.0


def _clip(node: Node, inputs: _Inputs) -> tuple[Planes, float]:
    _only(node, 3, {})
    for place in (1, 2):
        _require(node, inputs.tensor(place).shape == (), "must have one number for each bound")
    return inputs.planes(0), 0.0


def _add(node: Node, inputs: _Inputs) -> tuple[Planes, float]:
    _only(node, 2, {})
    first, second = inputs.planes(0), inputs.planes(1)
    _require(node, first == second, "must take tensors of one size")
    return first, 0.0


def _product(node: Node, inputs: _Inputs) -> tuple[Planes, float]:
    _only(node, 2, {})
    first, second = inputs.planes(0), inputs.planes(1)
    _require(node, first == second, "must take tensors of one size")
    return first, float(first.count)


def _part(node: Node, inputs: _Inputs) -> tuple[Planes, float]:
    """Some of the planes of a tensor, one after the other."""
    _only(node, (4, 5), {})
    taken = inputs.planes(0)
    start, end, axis = (inputs.number(place) for place in (1, 2, 3))
    _require(node, axis == 1, f"must have axis 1, got {axis}")
    if len(inputs) > 4:
        step = inputs.number(4)
        _require(node, step == 1, f"must take every plane, got steps of {step}")
    end = min(end, taken.count)
    _require(node, 0 <= start < end, f"must take planes that there are, got {start} to {end}")
    return replace(taken, count=end - start), 0.0


def _concatenation(node: Node, inputs: _Inputs) -> tuple[Planes, float]:
    _only(node, (1, MAX_PLANES), {"axis": 1})
    _require(node, "axis" in node.attributes, "must have axis 1")
    if len(inputs) > 0 and inputs.given(0).order == ROWS:
        twice = len(set(node.inputs)) == 1 and len(node.inputs) == 2
        _require(node, twice, "must take rows of pixels twice")
        return replace(inputs.given(0), order=ROWS_TWICE), 0.0
    parts = [inputs.planes(place) for place in range(len(inputs))]
    sizes = {(part.reduction, part.columns) for part in parts}
    _require(node, len(sizes) == 1, "must take images of one size")
    return replace(parts[0], count=sum(part.count for part in parts)), 0.0


def _pooling(node: Node, inputs: _Inputs) -> tuple[Planes, float]:
    """Maxima of 2x2 pixels: as cheap as any operator, and no other window or stride is taken."""
    fixed = {"auto_pad": "NOTSET", "ceil_mode": 0, "dilations": (1, 1), "storage_order": 0}
    of_two = {"kernel_shape": (2, 2), "strides": (2, 2), "pads": (0, 0, 0, 0)}
    _only(node, 1, {**fixed, **of_two})
    for name in ("kernel_shape", "strides"):
        _require(node, name in node.attributes, f"must have {name} (2, 2)")
    taken = inputs.planes(0)
    _require(node, taken.across is None, "must take whole pixels")
    reduction = taken.reduction * 2
    _require(node, reduction <= _MAX_REDUCTION, f"must reduce {_MAX_REDUCTION} times at most")
    return Planes(taken.count, reduction), 0.0


def _doubling(node: Node, inputs: _Inputs) -> tuple[Planes, float]:
    free = ("coordinate_transformation_mode", "cubic_coeff_a", "extrapolation_value", "mode",
            "nearest_mode")  # fmt: skip
    fixed = {"antialias": 0, "exclude_outside": 0, "keep_aspect_ratio_policy": "stretch"}
    _only(node, 3, {**dict.fromkeys(free), **fixed})
    taken, scales = inputs.planes(0), inputs.tensor(2)
    _require(node, inputs.is_left_out(1), "must resize whole images")
    doubles = scales.shape == (_RANK,) and scales.tolist() == [1, 1, 2, 2]
    doubles = doubles and taken.across is None
    _require(node, doubles and taken.reduction > 1, "must double what was reduced")
    return Planes(taken.count, taken.reduction // 2), 0.0


def _steps(node: Node, inputs: _Inputs) -> Steps:
    """What integers of 8 bits stand for: one scale and one zero for all planes."""
    _only(node, 3, {"axis": None})
    scale, zero = inputs.tensor(1), inputs.integers(2)
    _require(node, scale.shape == () == zero.shape, "must have one scale for an image")
    _require(node, float(scale) > 0, f"must have a scale above 0, got {float(scale)}")
    _require(node, zero.dtype == np.uint8, "must make integers of 8 bits without a sign")
    return Steps(float(scale), int(zero))


def _made_integers(node: Node, inputs: _Inputs) -> tuple[Planes, float]:
    return replace(inputs.planes(0), steps=_steps(node, inputs)), 0.0


def _made_numbers(node: Node, inputs: _Inputs) -> tuple[Planes, float]:
    taken, steps = inputs.given(0), _steps(node, inputs)
    fits = taken.order == PLANES and taken.steps == steps
    _require(node, fits, "must take planes that were made integers in the same steps")
    return replace(taken, steps=None), 0.0


def _dequantized(node: Node, inputs: _Inputs) -> np.ndarray:
    """Weights of a file as the numbers that their integers stand for: a scale for each output."""
    _only(node, 3, {"axis": None})
    given, scale, zero = inputs.integers(0), inputs.tensor(1), inputs.integers(2)
    fits = scale.shape in ((), given.shape[:1]) and zero.shape == scale.shape
    _require(
        node, fits and zero.dtype == given.dtype, "must have a scale and a zero for each output"
    )
    _require(node, node.attributes.get("axis", 0) == 0, "must have axis 0")
    if given.dtype == np.int8 and given.ndim == _RANK:
        fits = bool((neighbours_sum(given) <= MOST).all())
        # what a file made before lacks
        how = "make the file anew with stillray_export.quantize"
        rule = f"no two neighbours of one sign add up to more than {MOST}"
        _require(node, fits, f"must have weights of which {rule}: {how}")
    along = (-1, *[1] * (given.ndim - 1)) if scale.shape else ()
    with np.errstate(over="ignore", invalid="ignore"):
        steps = given.astype(np.float32) - zero.astype(np.float32).reshape(along)
        numbers = steps * scale.reshape(along)
    _require(node, bool(np.isfinite(numbers).all()), "must give finite numbers")
    return np.asarray(numbers, np.float32)


def _turned(node: Node, inputs: _Inputs) -> tuple[Planes, float]:
    """Integers in another order."""
    _only(node, 1, {"perm": None})
    taken, perm = inputs.given(0), node.attributes.get("perm", ())
    _require(node, taken.steps is not None, "must take integers")
    order = _TURNED.get((taken.order, perm))
    if order is None:
        raise GraphError(f"Transpose must turn {taken.order} in a known way, got perm {perm}")
    return replace(taken, order=order), 0.0


def _regrouped(node: Node, inputs: _Inputs) -> tuple[Planes, float]:
    """Integers whose pixels, or rows, are counted otherwise; none of them moves."""
    _only(node, 2, {"allowzero": 0})
    taken, shape = inputs.given(0), inputs.shape(1)
    _require(node, taken.steps is not None, "must take integers")
    count = shape[3]
    if taken.order == PIXELS and shape[:3] == (0, 0, -1) and 2 * count == taken.count:
        _require(node, taken.columns % 2 == 0, "must take pixels apart that are pairs")
        made = taken.of_size(taken.reduction, taken.columns // 2)
        return replace(made, count=count), 0.0
    rows = taken.order in (PIXELS, ROWS_TWICE) and shape == (-1, 1, 0, taken.count)
    _require(node, rows, f"must make pixels of pairs, or rows, got {shape} of {taken.order}")
    if taken.order == PIXELS:
        return replace(taken, order=ROWS), 0.0
    _require(node, taken.reduction % 2 == 0, "must double what was reduced")
    return replace(taken.of_size(taken.reduction // 2, taken.columns), order=ROWS), 0.0


_TO_PLANES = (0, 3, 1, 2)
_TURNED = {
    (PLANES, (0, 2, 3, 1)): PIXELS,
    (PIXELS, _TO_PLANES): PLANES,
    (ROWS, (1, 3, 0, 2)): PLANES,
}
_DEQUANTIZE = "DequantizeLinear"
OPERATORS: dict[str, _Rule] = {
    "Add": _add,
    "Clip": _clip,
    "Concat": _concatenation,
    "Conv": _convolution,
    _DEQUANTIZE: _made_numbers,
    "MaxPool": _pooling,
    "Mul": _product,
    "QuantizeLinear": _made_integers,
    "Relu": _pointwise,
    "Reshape": _regrouped,
    "Resize": _doubling,
    "Sigmoid": _pointwise,
    "Slice": _part,
    "Transpose": _turned,
}

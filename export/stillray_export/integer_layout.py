"""The same network of 8-bit integers, its planes arranged as processors take them faster.

Three changes of what ONNX Runtime's quantisation makes, each to the same integers bit by bit.

- A level is doubled by copies of memory. ONNX Runtime keeps integers pixel by pixel, where its own
  operator looks up every number by itself; the convolution before gives each pixel's planes twice
  instead, which beside each other are two pixels, and a row is copied as a whole.
- Where there are few planes, two pixels side by side may be taken for one of twice the planes. With
  AVX-512 a matrix product of few columns is slow: one of twice the columns, half of whose weights
  are 0, takes three quarters of its time; with AVX2 up to a half more. In memory the two are the
  same.
- Logits stay integers: who looks them up needs a table of 256 weights, no exponential.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import onnx
from onnx import TensorProto

from stillray.errors import InputError
from stillray_export.integer_graph import IntegerGraph, attribute

#: Fewer planes than this are taken by pairs of pixels.
ENOUGH_PLANES = 32
_PIXELS, _PLANES, _ROWS_TO_PLANES = (0, 2, 3, 1), (0, 3, 1, 2), (1, 3, 0, 2)


def arrange(graph: onnx.GraphProto, *, integers_out: bool, pairs: bool) -> bool:
    """Rearrange a network of integers.

    Parameters
    ----------
    graph
        Of ONNX Runtime's quantisation, its input taken by pixels
        (`stillray_export.quantize.take_pixels`). Changed.
    integers_out
        Whether what it gives stays integers.
    pairs
        Whether pairs of pixels are taken, where the network has few planes.

    Returns
    -------
    bool
        Whether they are.
    """
    network = IntegerGraph(graph)
    of_size = _of_the_frame(network)
    pairs = pairs and _may_be_paired(network, of_size)
    doublings = [
        (node, pairs and _reduction(network, node.output[0]) == 1)
        for node in graph.node
        if node.op_type == "Resize"
    ]
    for node, of_pairs in doublings:
        _double_by_copies(network, node, pairs=of_pairs)
    if pairs:
        _pair_pixels(network, of_size)
    if integers_out:
        _give_integers(network)
    network.finish()
    return pairs


def _doubled(network: IntegerGraph, resize: onnx.NodeProto) -> list[onnx.NodeProto] | None:
    """What leads to a doubling, and what follows, where a convolution gives to it alone.

    The convolution, what makes its integers, what makes numbers of these, and of the doubled
    numbers integers again; None of something else, which ONNX Runtime doubles as before.
    """
    numbers = network.maker(resize.input[0])
    made = None if numbers is None else network.maker(numbers.input[0])
    convolution = None if made is None else network.maker(made.input[0])
    (again,) = network.takers(resize.output[0])
    if numbers is None or made is None or convolution is None:
        return None
    if convolution.op_type != "Conv" or again.op_type != "QuantizeLinear":
        return None
    if len(network.takers(made.output[0])) > 1 or len(network.takers(numbers.output[0])) > 1:
        return None
    return [convolution, made, numbers, again]


def _double_by_copies(network: IntegerGraph, resize: onnx.NodeProto, *, pairs: bool) -> None:
    """Put copies in the place of a doubling; doubled pixels stay pairs, or are taken apart."""
    found = _doubled(network, resize)
    if found is None:
        return
    convolution, made, numbers, again = found
    weights, _ = network.weights(convolution)
    planes = len(network.array(weights.input[0]))
    _give_twice(network, convolution)
    name, doubled = resize.name, again.output[0]
    for node in (resize, numbers, again):
        network.graph.node.remove(node)
    pixels = network.add("Transpose", [made.output[0]], f"{name} pixels", perm=_PIXELS)
    if pairs:
        planes *= 2
    else:
        beside = network.shape(0, 0, -1, planes)
        pixels = network.add("Reshape", [pixels, beside], f"{name} beside")
    rows = network.add("Reshape", [pixels, network.shape(-1, 1, 0, planes)], f"{name} rows")
    twice = network.add("Concat", [rows, rows], f"{name} twice", axis=1)
    below = network.add("Reshape", [twice, network.shape(-1, 1, 0, planes)], f"{name} below")
    network.add("Transpose", [below], doubled, perm=_ROWS_TO_PLANES)


def _give_twice(network: IntegerGraph, convolution: onnx.NodeProto) -> None:
    """Let a convolution give all its planes a second time, after the first."""
    weights, bias = network.weights(convolution)
    for name in (*weights.input, *bias.input):
        array = network.array(name)
        if array.ndim:
            network.put(name, np.concatenate([array, array]))


def _may_be_paired(network: IntegerGraph, of_size: Sequence[onnx.NodeProto]) -> bool:
    """Whether all that has the frame's size is convolved, added and little."""
    doublings = [node for node in network.graph.node if node.op_type == "Resize"]
    if any(_doubled(network, node) is None for node in doublings):
        return False  # what it gives would stay pixels beside pairs
    kinds = {node.op_type for node in of_size}
    known = {"Conv", "Add", "QuantizeLinear", "DequantizeLinear", "Transpose"}
    counts = [
        len(network.array(network.weights(node)[0].input[0]))
        for node in of_size
        if node.op_type == "Conv" and list(attribute(node, "strides")) == [1, 1]
    ]
    return kinds <= known and 0 < max(counts, default=0) < ENOUGH_PLANES


def _of_the_frame(network: IntegerGraph) -> list[onnx.NodeProto]:
    """Nodes that take planes of the frame's size."""
    found: list[onnx.NodeProto] = []
    doublings = [node for node in network.graph.node if node.op_type == "Resize"]
    names = {node.output[0] for node in doublings if _reduction(network, node.output[0]) == 1}
    names.add("features")
    for node in network.in_order():
        if names.isdisjoint(node.input):
            continue
        found.append(node)
        strides = attribute(node, "strides") if node.op_type == "Conv" else [1, 1]
        if list(strides) == [1, 1]:
            names.update(node.output)
    return found


def _reduction(network: IntegerGraph, name: str) -> int:
    """By how much a tensor is smaller than the frame, before anything is doubled by copies."""
    node = network.maker(name)
    if node is None:
        return 1
    if node.op_type == "Conv":
        return _reduction(network, node.input[0]) * int(attribute(node, "strides")[0])
    if node.op_type == "Resize":
        return _reduction(network, node.input[0]) // 2
    return _reduction(network, node.input[0])


def _pair_pixels(network: IntegerGraph, of_size: Sequence[onnx.NodeProto]) -> None:
    """Take pixels side by side for one, wherever planes have the frame's size."""
    for node in of_size:
        if node.op_type == "Conv":
            _convolve_pairs(network, node)
    (turned,) = [node for node in of_size if node.op_type == "Transpose"]
    (features,) = [source for source in network.graph.input if source.name == "features"]
    planes = features.type.tensor_type.shape.dim[3].dim_value
    turned.input[0] = network.add(
        "Reshape", ["features", network.shape(0, 0, -1, 2 * planes)], "pairs of pixels"
    )
    ends = {output.name for output in network.graph.output}
    for node in of_size:
        if ends & set(node.output):
            _take_apart(network, node)


def _take_apart(network: IntegerGraph, numbers: onnx.NodeProto) -> None:
    """Make pixels of pairs before what makes numbers of them."""
    name = numbers.input[0]
    made = network.maker(name)
    assert made is not None
    convolution = network.maker(made.input[0])
    assert convolution is not None
    planes = len(network.array(network.weights(convolution)[0].input[0])) // 2
    pairs = network.add("Transpose", [name], f"{name} pairs", perm=_PIXELS)
    pixels = network.add("Reshape", [pairs, network.shape(0, 0, -1, planes)], f"{name} pixels")
    numbers.input[0] = network.add("Transpose", [pixels], f"{name} planes", perm=_PLANES)


def _convolve_pairs(network: IntegerGraph, convolution: onnx.NodeProto) -> None:
    """Let a convolution take pairs; what it gives are pairs, too, unless it takes every other."""
    weights, _ = network.weights(convolution)
    step = int(attribute(convolution, "strides")[0])
    pads = list(attribute(convolution, "pads"))
    if step == 1:
        _give_twice(network, convolution)
    of_pairs, before, after = paired(
        network.array(weights.input[0]), step, (int(pads[1]), int(pads[3]))
    )
    network.put(weights.input[0], of_pairs)
    for told in convolution.attribute:
        if told.name == "kernel_shape":
            told.ints[:] = of_pairs.shape[2:]
        elif told.name == "strides":
            told.ints[:] = [step, 1]
        elif told.name == "pads":
            told.ints[:] = [pads[0], before, pads[2], after]


def paired(weights: np.ndarray, step: int, pads: tuple[int, int]) -> tuple[np.ndarray, int, int]:
    """Weights of a convolution for pairs of pixels side by side.

    Parameters
    ----------
    weights : (outputs, inputs, h, w)
        For pixels; for a step of 1 the outputs are those of the left pixel, then of the right.
    step
        From one pixel that is given to the next: 1 or 2.
    pads
        Columns beyond the left and the right border that it looks at.

    Returns
    -------
    weights : (outputs, 2 inputs, h, w of pairs)
    before, after
        Columns of pairs beyond the left and the right border.
    """
    outputs, inputs, height, width = weights.shape
    firsts = [0, 1] if step == 1 else [0]  # pixels of a pair that are given
    places = [first - pads[0] + column for first in firsts for column in range(width)]
    before, after = -(min(places) // 2), max(places) // 2
    made = np.zeros((outputs, 2 * inputs, height, before + 1 + after), weights.dtype)
    part = outputs // len(firsts)
    for index, first in enumerate(firsts):
        own = slice(index * part, (index + 1) * part)
        for column in range(width):
            pair, side = divmod(first - pads[0] + column, 2)
            made[own, side * inputs : (side + 1) * inputs, :, before + pair] = weights[
                own, :, :, column
            ]
    return made, before, after


def _give_integers(network: IntegerGraph) -> None:
    """Leave out what makes numbers of the outputs."""
    for output in network.graph.output:
        numbers = network.maker(output.name)
        if numbers is None or numbers.op_type != "DequantizeLinear":
            raise InputError(f"{output.name} must be made of integers")
        integers = network.maker(numbers.input[0])
        if integers is None or len(network.takers(numbers.input[0])) > 1:
            raise InputError(f"{output.name} must be made of integers of its own")
        network.graph.node.remove(numbers)
        integers.output[0] = output.name
        output.type.tensor_type.elem_type = TensorProto.UINT8

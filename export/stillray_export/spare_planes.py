"""Planes that say nothing, where a network in integers is faster with them.

ONNX Runtime has a quick convolution of 8-bit integers for inputs of a multiple of four planes and
outputs of a multiple of eight (of four with AVX-512), and one that first copies each pixel's
neighbours for all others: of kpyr-5-still, whose first convolution takes 13 planes and whose last
gives 26, those two took 45 % of the network's time. A spare input is an integer more of a pixel,
which no weight counts (`stillray.models.steps.PixelLayout`); spare outputs are left away again.

``python -m stillray_export.spare_planes NAME`` gives a model's files that have none what
`stillray_export.quantize` gives new ones. What comes out stays the same bit by bit.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
import onnx
import typer
from onnx import helper

from stillray.cli import program
from stillray.io.atomic import atomic_path
from stillray.models.precision import int8_path, made_of, pairs_path
from stillray.models.registry import find_model, require_fit
from stillray.models.session import checked
from stillray_export.integer_graph import IntegerGraph, attribute

_INPUTS = 4  # ONNX Runtime's quick convolution takes a multiple of so many
_OUTPUTS, _OUTPUTS_OF_PAIRS = 8, 4  # and gives a multiple of so many; those of pairs run on AVX-512
_LEAST_OUTPUTS = 16  # of fewer it is not used


def add_spare_planes(graph: onnx.GraphProto, *, pairs: bool) -> bool:
    """Add planes where convolutions are quicker with them.

    Parameters
    ----------
    graph
        Of a network in integers that takes pixels, arranged as it will run. Changed.
    pairs
        Whether it takes pixels by twos where it has few planes.

    Returns
    -------
    bool
        Whether any was added.
    """
    network = IntegerGraph(graph)
    multiple = _OUTPUTS_OF_PAIRS if pairs else _OUTPUTS
    convolutions = [node for node in graph.node if node.op_type == "Conv"]
    added = [_spare_inputs(network)]
    added += [_spare_outputs(network, convolution, multiple) for convolution in convolutions]
    network.finish()
    return any(added)


def _spare_inputs(network: IntegerGraph) -> bool:
    """Let the convolution that takes all features take some more that no weight counts."""
    (features,) = [source for source in network.graph.input if source.name == "features"]
    found, regrouped = network.takers("features"), None
    while len(found) == 1 and found[0].op_type in ("Reshape", "Transpose", "DequantizeLinear"):
        regrouped = found[0] if found[0].op_type == "Reshape" else regrouped
        found = network.takers(found[0].output[0])
    if len(found) != 1 or found[0].op_type != "Conv":
        return False  # parts of the features go ways of their own
    weights, _ = network.weights(found[0])
    array = network.array(weights.input[0])
    size = features.type.tensor_type.shape.dim[3].dim_value
    pixels = array.shape[1] // size  # that are taken for one
    spare = -size % (_INPUTS // pixels)
    if not spare:
        return False
    outputs, _, *kernel = array.shape
    of_pixels = array.reshape(outputs, pixels, size, *kernel)
    wider = np.pad(of_pixels, ((0, 0), (0, 0), (0, spare), (0, 0), (0, 0)))
    network.put(weights.input[0], wider.reshape(outputs, -1, *kernel))
    features.type.tensor_type.shape.dim[3].dim_value = size + spare
    if regrouped is not None:
        regrouped.input[1] = network.shape(0, 0, -1, pixels * (size + spare))
    return True


def _spare_outputs(network: IntegerGraph, convolution: onnx.NodeProto, multiple: int) -> bool:
    """Let a convolution give planes more, and leave those away once they are integers."""
    weights, bias = network.weights(convolution)
    integers = network.array(weights.input[0])
    count = len(integers)
    spare = -count % multiple
    # of a single pixel there are no neighbours to copy
    if not spare or count < _LEAST_OUTPUTS or max(attribute(convolution, "kernel_shape")) == 1:
        return False
    (made,) = network.takers(convolution.output[0])
    if made.op_type != "QuantizeLinear":
        return False
    network.put(weights.input[0], np.pad(integers, ((0, spare), *[(0, 0)] * 3)))
    for name in (*weights.input[1:], *bias.input):
        if (array := network.array(name)).ndim:
            network.put(name, np.pad(array, (0, spare), mode="edge"))
    _leave_away(network, made, count)
    return True


def _leave_away(network: IntegerGraph, made: onnx.NodeProto, count: int) -> None:
    """Keep the first planes of what makes integers of a convolution's numbers."""
    whole = made.output[0]
    made.output[0] = f"{whole} and spare"
    steps = made.input[1:]
    bounds = [network.put(f"number {at}", np.array([at], np.int64)) for at in (0, count, 1)]
    numbers = network.add("DequantizeLinear", [made.output[0], *steps], f"{whole} as numbers")
    # starts, ends, axes, steps
    kept = network.add("Slice", [numbers, *bounds, bounds[2]], f"{whole} without spare")
    again = helper.make_node("QuantizeLinear", [kept, *steps], [whole], name=f"{whole} again")
    network.graph.node.append(again)


def main(model: Annotated[str, typer.Argument(help="A model's name or file.")]) -> None:
    """Give a model's networks in integers spare planes where that makes them faster."""
    info = find_model(model)
    pixels, pairs = int8_path(info.path), pairs_path(info.path)
    for path, source in ((pixels, info.path), (pairs, pixels)):
        if not path.is_file():
            continue
        network = onnx.load(path)
        added = add_spare_planes(network.graph, pairs=path == pairs)
        told = {entry.key: entry.value for entry in network.metadata_props}
        helper.set_model_props(network, told | made_of(source.read_bytes()))
        made = network.SerializeToString()
        require_fit(checked(made, path)[1], info.spec, path)
        with atomic_path(path) as temporary:
            temporary.write_bytes(made)
        print(f"{path}: {'spare planes added' if added else 'needs none'}")


if __name__ == "__main__":
    program.run(main)

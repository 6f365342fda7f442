"""How much a network computes, from its graph."""

from __future__ import annotations

from math import prod
from pathlib import Path

import onnx


def multiply_adds(path: Path, height: int, width: int) -> int:
    """Multiply-adds of a network's convolutions for one frame.

    Parameters
    ----------
    path
        The .onnx file of a network alone.
    height, width
        Of its input, pixels.
    """
    model = onnx.load(path)
    sizes = model.graph.input[0].type.tensor_type.shape.dim
    for axis, size in ((0, 1), (2, height), (3, width)):
        sizes[axis].dim_value = size
    for output in model.graph.output:  # their sizes follow from the input's
        del output.type.tensor_type.shape.dim[2:]
        for _ in range(2):
            output.type.tensor_type.shape.dim.add()
    del model.graph.value_info[:]
    inferred = onnx.shape_inference.infer_shapes(model, strict_mode=True, data_prop=True)
    shapes = {
        value.name: [size.dim_value for size in value.type.tensor_type.shape.dim]
        for value in (*inferred.graph.value_info, *inferred.graph.output)
    }
    weights = {tensor.name: list(tensor.dims) for tensor in model.graph.initializer}
    return sum(
        # every output element is a sum over input channels and the kernel's window
        prod(shapes[node.output[0]]) * prod(weights[node.input[1]][1:])
        for node in model.graph.node
        if node.op_type == "Conv"
    )

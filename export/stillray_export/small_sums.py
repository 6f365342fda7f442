"""Weights of a network in integers, in scales at which no processor's sums overflow.

ONNX Runtime's answer to processors without VNNI (`stillray.models.small_sums`) are weights of 7
bits. But only two weights side by side, both near the greatest and of one sign, can overflow: those
outputs alone are given a coarser scale, by a tenth in the middle, by two at most.
"""

from __future__ import annotations

import numpy as np
import onnx
from onnx import numpy_helper

from stillray.models.small_sums import MOST, neighbours_sum


def bound_sums(integers: onnx.GraphProto, floats: onnx.GraphProto) -> None:
    """Make the weights of a network's convolutions anew, in scales that keep sums small.

    Parameters
    ----------
    integers
        Of ONNX Runtime's quantisation, weights a scale for each output. Changed.
    floats
        What it was made of.
    """
    tensors = {tensor.name: tensor for tensor in integers.initializer}
    known = {tensor.name: tensor for tensor in floats.initializer}
    makers = {node.output[0]: node for node in integers.node}
    for node in integers.node:
        if node.op_type != "Conv":
            continue
        planes, weights, bias = (makers[name] for name in node.input)
        # the names that ONNX Runtime's quantisation gives
        name = weights.input[0].removesuffix("_quantized")
        values = numpy_helper.to_array(known[name]).astype(np.float64)
        scale = scales_of_outputs(values).astype(np.float32)
        of_sums = numpy_helper.to_array(tensors[planes.input[1]]) * scale
        told = numpy_helper.to_array(known[bias.input[0].removesuffix("_quantized")])
        made = np.rint(values / scale[:, None, None, None].astype(np.float64))
        for target, array in (
            (weights.input[0], made.astype(np.int8)),
            (weights.input[1], scale),
            (bias.input[0], np.rint(told / of_sums.astype(np.float64)).astype(np.int32)),
            (bias.input[1], of_sums),
        ):
            tensors[target].CopyFrom(numpy_helper.from_array(array, target))


def scales_of_outputs(weights: np.ndarray) -> np.ndarray:
    """The finest scale of each output at which no sum of two products overflows.

    Parameters
    ----------
    weights : (outputs, inputs, h, w)
        Of a convolution.

    Returns
    -------
    (outputs,)
        What one step of its integers is worth; of an output without weights, 1.
    """
    # of an odd number of inputs, which two are neighbours depends on where a row begins, and
    # `stillray_export.integer_layout` moves that
    firsts = (0,) if weights.shape[1] % 2 == 0 else (0, 1)
    sums = [neighbours_sum(weights, first) for first in firsts]
    # rounding makes each of two greater by half a step at most
    scale = np.max(sums, axis=0) / (MOST - 1)
    return np.where(scale > 0.0, scale, 1.0)

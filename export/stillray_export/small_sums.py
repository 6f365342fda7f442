"""Weights of a network in integers, in scales at which no processor's sums overflow.

ONNX Runtime's answer to processors without VNNI (`stillray.models.small_sums`) are weights of 7
bits. But only two weights side by side, both near the greatest and of one sign, can overflow: those
outputs alone are given a coarser scale, by a tenth in the middle, by two at most.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import onnx
from onnx import numpy_helper

from stillray.models.small_sums import MOST, neighbours_sum


def weight_scales(floats: onnx.GraphProto) -> dict[str, list[dict[str, Any]]]:
    """Scales of the weights of convolutions, as ONNX Runtime's quantisation takes them.

    Parameters
    ----------
    floats
        The network.
    """
    tensors = {tensor.name: tensor for tensor in floats.initializer}
    return {
        node.input[1]: [
            {"axis": 0, "scale": scale, "zero_point": np.int8(0)}
            for scale in scales_of_outputs(numpy_helper.to_array(tensors[node.input[1]]))
        ]
        for node in floats.node
        if node.op_type == "Conv"
    }


def scales_of_outputs(weights: np.ndarray) -> np.ndarray:
    """The finest scale of each output at which no sum of two products overflows.

    Parameters
    ----------
    weights : (outputs, inputs, h, w)
        Of a convolution.

    Returns
    -------
    (outputs,) float32
        What one step of its integers is worth; of an output without weights, 1.
    """
    # of an odd number of inputs, which two are neighbours depends on where a row begins, and
    # `stillray_export.integer_layout` moves that
    firsts = (0,) if weights.shape[1] % 2 == 0 else (0, 1)
    sums = [neighbours_sum(weights, first) for first in firsts]
    # rounding makes each of two greater by half a step at most
    scale = np.max(sums, axis=0) / (MOST - 1)
    return np.where(scale > 0.0, scale, 1.0).astype(np.float32)

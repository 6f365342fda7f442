"""Biases of a network in integers that take back what rounding its weights has shifted.

Rounded weights shift what a convolution gives, by as much for all pixels that are given alike:
three quarters of a network's error may be such shifts, and they grow from layer to layer. What they
are over some frames is taken off the biases, layer by layer (Nagel et al. 2019, section 4.2, with
frames in place of what normalisation tells): the median of what single frames say, since one of
sixty whose greatest values are beyond the scales once cost a network .8 dB of all others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import onnx
import onnxruntime as ort
from onnx import TensorProto, helper, numpy_helper

# What ONNX Runtime's quantisation puts after names.
_DEQUANTIZED, _QUANTIZED = "_DequantizeLinear_Output", "_quantized"


def correct_biases(
    floats: onnx.ModelProto, integers: onnx.ModelProto, features: Sequence[np.ndarray]
) -> None:
    """Take off biases what convolutions in integers give more than those in floats.

    Parameters
    ----------
    floats
        The network.
    integers
        As ONNX Runtime's quantisation has made it, with the same input. Its biases are changed.
    features : (1, features, h, w) float32 each
        What both are given.
    """
    given = _convolutions(floats.graph)
    wanted = _means(floats, features, [node.output[0] for node in given.values()])
    means = dict(zip(given, wanted, strict=True))
    tensors = {each.name: each for each in integers.graph.initializer}
    # in their order: what one of them is given has been put right before
    for weight, node in _convolutions(integers.graph).items():
        name = f"{node.input[2]}{_QUANTIZED}" if len(node.input) > 2 else ""
        if name not in tensors:
            continue
        (found,) = _means(integers, features, [node.output[0]])
        shift = np.median(found - means[weight], axis=0)
        steps = shift / numpy_helper.to_array(tensors[f"{name}_scale"])
        bias = numpy_helper.to_array(tensors[name]).astype(np.float64)
        bounds = np.iinfo(np.int32)
        moved = np.clip(np.rint(bias - steps), bounds.min, bounds.max).astype(np.int32)
        tensors[name].CopyFrom(numpy_helper.from_array(moved, name))


def _convolutions(graph: onnx.GraphProto) -> dict[str, onnx.NodeProto]:
    """Convolutions in their order, by the names of their weights."""
    return {
        node.input[1].removesuffix(_DEQUANTIZED): node
        for node in graph.node
        if node.op_type == "Conv"
    }


def _means(
    model: onnx.ModelProto, features: Sequence[np.ndarray], outputs: Sequence[str]
) -> list[np.ndarray]:
    """Means of the planes of what nodes give, ``(frames, planes)`` each."""
    opened = onnx.ModelProto()
    opened.CopyFrom(model)
    del opened.graph.output[:]
    opened.graph.output.extend(
        helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in outputs
    )
    # what comes after them would be run, too
    last = max(i for i, node in enumerate(model.graph.node) if node.output[0] in outputs)
    del opened.graph.node[last + 1 :]
    options = ort.SessionOptions()
    # nodes as the file has them
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.log_severity_level = 4
    session = ort.InferenceSession(opened.SerializeToString(), options)
    found = [
        [each.mean((0, 2, 3), dtype=np.float64) for each in session.run(None, {"features": planes})]
        for planes in features
    ]
    return [np.stack(of_output) for of_output in zip(*found, strict=True)]

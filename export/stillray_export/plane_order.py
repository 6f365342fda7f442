"""The order of a network's features in which few large weights of one sign are neighbours.

Of what a network is given, much is alike (red and green light, the albedo's colours), and so are
its weights: side by side they would need coarser scales (`stillray_export.small_sums`), most of all
places. Where one convolution takes the features, their order is free.
"""

from __future__ import annotations

import numpy as np
import onnx
from onnx import numpy_helper

from stillray_export.small_sums import scales_of_outputs

_STARTS, _SWAPS = 8, 400


def order_features(floats: onnx.GraphProto) -> list[int]:
    """Put the features of a network into an order that keeps its integers' scales fine.

    Parameters
    ----------
    floats
        A network of floats. Changed: it takes its features in that order.

    Returns
    -------
    list of int
        The place of each feature.
    """
    takers = [node for node in floats.node if "features" in node.input]
    (features,) = [source for source in floats.input if source.name == "features"]
    count = features.type.tensor_type.shape.dim[1].dim_value
    if len(takers) > 1 or takers[0].op_type != "Conv":
        return list(range(count))
    name = takers[0].input[1]
    (tensor,) = [tensor for tensor in floats.initializer if tensor.name == name]
    weights = numpy_helper.to_array(tensor)
    order = best_order(weights)
    tensor.CopyFrom(numpy_helper.from_array(np.ascontiguousarray(weights[:, order]), name))
    return np.argsort(order).tolist()


def best_order(weights: np.ndarray) -> np.ndarray:
    """An order of a convolution's inputs that has fine scales, found by swapping two at a time.

    Parameters
    ----------
    weights : (outputs, inputs, h, w)

    Returns
    -------
    (inputs,) int
        Which input comes first, second, and so on.
    """
    largest = np.abs(weights).max(axis=(1, 2, 3))
    weights = weights[largest > 0.0] / largest[largest > 0.0, None, None, None]

    def noise(order: np.ndarray) -> float:
        """What rounding costs, in the mean of the outputs."""
        return float(np.square(scales_of_outputs(weights[:, order])).sum())

    rng = np.random.default_rng(0)
    inputs = weights.shape[1]
    found = []
    for start in range(_STARTS):
        order = rng.permutation(inputs) if start else np.arange(inputs)
        least = noise(order)
        for _ in range(_SWAPS):
            swapped = order.copy()
            first, second = rng.integers(0, inputs, 2)
            swapped[[first, second]] = swapped[[second, first]]
            if (now := noise(swapped)) < least:
                order, least = swapped, now
        found.append((least, order))
    return min(found, key=lambda pair: pair[0])[1]

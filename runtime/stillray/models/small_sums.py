"""Weights of 8 bits whose sums of two products fit into 16.

Processors with AVX2 alone multiply bytes by twos: the product of an unsigned and a signed byte
is added to its neighbour's, and what leaves 16 bits is cut off there (``vpmaddubsw``: Intel's
Intrinsics Guide, ``_mm256_maddubs_epi16``). Where no two neighbours of one sign add up to more than
`MOST`, nothing is, and a network's integers are the same on every processor.
"""

from __future__ import annotations

import numpy as np

#: What two neighbours of one sign may add up to: times 255, the greatest of a plane, it is 32640.
MOST = 128


def neighbours_sum(weights: np.ndarray, first: int = 0) -> np.ndarray:
    """What two neighbours of one sign add up to at most, for each output of a convolution.

    Parameters
    ----------
    weights : (outputs, inputs, h, w)
        Inputs of a place lie side by side, place after place, in ONNX Runtime's sums, which take
        two at a time.
    first
        Where the first two begin: 0 or 1.

    Returns
    -------
    (outputs,) float64
    """
    in_order = np.moveaxis(weights, 1, -1).reshape(len(weights), -1)[:, first:].astype(np.float64)
    if not in_order.size:
        return np.zeros(len(weights))
    starts = np.arange(0, in_order.shape[1], 2)
    sums = [
        np.add.reduceat(np.maximum(signed, 0.0), starts, axis=1).max(axis=1)
        for signed in (in_order, -in_order)
    ]
    return np.maximum(*sums)

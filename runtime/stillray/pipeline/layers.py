"""Other layers of a frame: what may be given."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stillray.errors import InputError
from stillray.frame import Frame


def validated(layers: Mapping[str, np.ndarray], frame: Frame) -> dict[str, np.ndarray]:
    """Layers as float32.

    Raises
    ------
    InputError
        A layer has a wrong shape or type.
    """
    arrays = {}
    for name, layer in layers.items():
        array = np.asarray(layer)
        if array.shape != frame.color.shape:
            raise InputError(
                f"layer {name} must have shape {frame.color.shape} like color, got {array.shape}"
            )
        if array.dtype.kind != "f":
            raise InputError(f"layer {name} must be floating point, got {array.dtype}")
        arrays[name] = np.ascontiguousarray(array, np.float32)
    return arrays

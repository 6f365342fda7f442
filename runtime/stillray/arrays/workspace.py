"""Arrays that calls use again: new memory costs as much as the work that fills it."""

from __future__ import annotations

import math

import numpy as np


class Workspace:
    """Arrays by name, for one thread at a time.

    An array holds what was last written to it under its name, and is
    valid until the next call with that name.
    """

    def __init__(self) -> None:
        self._arrays: dict[str, np.ndarray] = {}

    def array(self, name: str, shape: tuple[int, ...], dtype: type = np.float32) -> np.ndarray:
        """An uninitialised C-order array.

        Parameters
        ----------
        name
            What it is for; always asked for with the same ``dtype``.
        shape
            Of any size: a smaller array is a part of a larger one.

        Raises
        ------
        ValueError
            The name was used with another type.
        """
        size = math.prod(shape)
        array = self._arrays.get(name)
        if array is not None and array.dtype != dtype:
            raise ValueError(
                f"dtype of workspace array {name!r} must be {array.dtype}, got {np.dtype(dtype)}"
            )
        if array is None or array.size < size:
            array = self._arrays[name] = np.empty(size, dtype)
        return array[:size].reshape(shape)

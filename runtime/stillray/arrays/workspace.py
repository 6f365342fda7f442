"""Arrays that are kept between calls: fresh memory costs as much as the work that fills it."""

from __future__ import annotations

import math

import numpy as np


class Scratch:
    """Arrays by name, for one thread at a time.

    An array holds what was last written to it under its name; it is lent until the next call
    with that name.
    """

    def __init__(self) -> None:
        self._kept: dict[str, np.ndarray] = {}

    def array(self, name: str, shape: tuple[int, ...], dtype: type = np.float32) -> np.ndarray:
        """An uninitialised C-order array.

        Parameters
        ----------
        name
            What it is for; always asked for with the same ``dtype``.
        shape
            Of any size: a smaller array is a part of a larger one.
        """
        size = math.prod(shape)
        kept = self._kept.get(name)
        if kept is None or kept.size < size:
            kept = self._kept[name] = np.empty(size, dtype)
        return kept[:size].reshape(shape)

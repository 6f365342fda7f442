"""Weights of a network that learns while it denoises, by name and as one vector."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from stillray.model_spec.network_weights import Shapes


def join(tensors: Mapping[str, np.ndarray], shapes: Shapes) -> np.ndarray:
    """Tensors by name as one vector ``(n,)`` float32."""
    return np.concatenate([tensors[name].ravel() for name, _ in shapes])


def split(weights: np.ndarray, shapes: Shapes) -> dict[str, np.ndarray]:
    """`join` undone."""
    ends = np.cumsum([math.prod(shape) for _, shape in shapes])
    parts = np.split(weights, ends[:-1])
    return {name: part.reshape(shape) for part, (name, shape) in zip(parts, shapes, strict=True)}

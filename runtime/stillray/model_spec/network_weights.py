"""Weights of networks that learn while they denoise: a file holds those that they begin with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from stillray.model_spec.loader import ModelSpec
from stillray.model_spec.networks import FilterNetwork

#: Names and shapes.
Shapes = list[tuple[str, tuple[int, ...]]]
#: What sets the filter: bands of both estimates, albedo, normals and place; the share of a frame.
PARAMETERS = 6


def network_weights(spec: ModelSpec) -> Shapes:
    """Weights that may be given in place of the file's, in the order of one vector; others: none.

    As the inputs of the graph are, after its features.
    """
    learned = _LEARNED.get(spec.family)
    return learned(spec.network) if learned else []


def _filter_network(network: FilterNetwork) -> Shapes:
    return weight_shapes(len(network.features), network.widths, PARAMETERS)


_LEARNED: dict[str, Callable[[Any], Shapes]] = {"cross-regression": _filter_network}


def weight_shapes(features: int, widths: Sequence[int], parameters: int) -> Shapes:
    """Names and shapes of all weights, in the order in which they lie in one vector.

    Two convolutions of 3x3 a level on the way down and on the way up, which takes what came down
    beside it, and one of 1x1 (Choi et al. 2024, section 4.4).

    Parameters
    ----------
    features
        Planes of the input.
    widths
        Filters of each level, finest first.
    parameters
        Planes of the output.
    """
    found: Shapes = []

    def convolution(name: str, taken: int, given: int, size: int = 3) -> None:
        found.append((f"{name}.weight", (given, taken, size, size)))
        found.append((f"{name}.bias", (given,)))

    taken = features
    for level, width in enumerate(widths):
        convolution(f"down_{level}_0", taken, width)
        convolution(f"down_{level}_1", width, width)
        taken = width
    for level in reversed(range(len(widths) - 1)):
        width = widths[level]
        convolution(f"up_{level}_0", taken + width, width)
        convolution(f"up_{level}_1", width, width)
        taken = width
    convolution("out", taken, parameters, 1)
    return found

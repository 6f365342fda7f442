"""A Mitsuba plugin with its parameters, and the effect that asked for it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

BASE = "base"  # asks for what every scene has


@dataclass(frozen=True, kw_only=True, eq=False)
class Node:
    """One plugin. Parameters hold numbers, arrays, other nodes.

    An ``(h, w)`` or ``(h, w, 3)`` array under ``"bitmap"`` is a picture, a ``(4, 4)`` one a
    transform.
    """

    plugin: str
    asked_by: str = BASE
    params: Mapping[str, Any] = field(default_factory=dict)

    def walk(self) -> Iterator[Node]:
        """This node and all below it."""
        yield self
        for value in self.params.values():
            if isinstance(value, Node):
                yield from value.walk()


def rgb(value: tuple[float, ...]) -> dict[str, Any]:
    """A colour parameter: no plugin of its own in the tables."""
    return {"type": "rgb", "value": [float(v) for v in value]}


def to_mitsuba(mi: Any, node: Node) -> dict[str, Any]:
    """The node as a dictionary for ``mi.load_dict``."""
    result: dict[str, Any] = {"type": node.plugin}
    for name, value in node.params.items():
        if isinstance(value, Node):
            value = to_mitsuba(mi, value)
        elif isinstance(value, np.ndarray):
            if name == "bitmap":
                value = mi.Bitmap(np.ascontiguousarray(np.atleast_3d(value), np.float32))
            else:
                value = mi.ScalarTransform4f(value.tolist())
        result[name] = value
    return result

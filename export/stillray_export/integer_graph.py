"""A network in 8-bit integers as ONNX Runtime's quantisation writes it, looked up and changed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import onnx
from onnx import helper, numpy_helper

from stillray.errors import InputError


class IntegerGraph:
    """A graph whose nodes and tensors are looked up by name."""

    def __init__(self, graph: onnx.GraphProto) -> None:
        self.graph = graph
        self._tensors = {tensor.name: tensor for tensor in graph.initializer}

    def maker(self, name: str) -> onnx.NodeProto | None:
        """The node that gives a tensor, if one does."""
        return next((node for node in self.graph.node if name in node.output), None)

    def takers(self, name: str) -> list[onnx.NodeProto]:
        """The nodes that take a tensor."""
        return [node for node in self.graph.node if name in node.input]

    def array(self, name: str) -> np.ndarray:
        """The numbers of a tensor of the file."""
        return np.asarray(numpy_helper.to_array(self._tensors[name]))

    def put(self, name: str, array: np.ndarray) -> str:
        """Set a tensor of the file, new or not; its name."""
        tensor = numpy_helper.from_array(np.ascontiguousarray(array), name)
        if name in self._tensors:
            self._tensors[name].CopyFrom(tensor)
        else:
            self.graph.initializer.append(tensor)
            self._tensors[name] = self.graph.initializer[-1]
        return name

    def shape(self, *sizes: int) -> str:
        """A tensor of the file that says a shape."""
        return self.put("shape " + " ".join(map(str, sizes)), np.array(sizes, np.int64))

    def weights(self, convolution: onnx.NodeProto) -> tuple[onnx.NodeProto, onnx.NodeProto]:
        """What makes numbers of a convolution's integers: of its weights, and of its bias."""
        made = [self.maker(name) for name in convolution.input[1:]]
        found = [node for node in made if node is not None]
        if len(found) != 2:
            raise InputError(f"{convolution.name} must have weights and a bias, in integers")
        return found[0], found[1]

    def add(self, operator: str, inputs: Sequence[str], output: str, **attributes: Any) -> str:
        """A node more, with one output; its name."""
        made = helper.make_node(operator, list(inputs), [output], name=output, **attributes)
        self.graph.node.append(made)
        return output

    def in_order(self) -> list[onnx.NodeProto]:
        """The nodes, each after those that give what it takes."""
        left = list(self.graph.node)
        known = {source.name for source in self.graph.input} | set(self._tensors) | {""}
        ordered: list[onnx.NodeProto] = []
        while left:
            ready = [node for node in left if known.issuperset(node.input)]
            if not ready:
                raise InputError("the network must not go in circles")
            ordered += ready
            known.update(name for node in ready for name in node.output)
            left = [node for node in left if not known.issuperset(node.output)]
        return ordered

    def finish(self) -> None:
        """Put the nodes in order, and drop tensors that none takes."""
        ordered = self.in_order()
        taken = {name for node in ordered for name in node.input}
        tensors = [tensor for tensor in self._tensors.values() if tensor.name in taken]
        del self.graph.node[:], self.graph.initializer[:]
        self.graph.node.extend(ordered)
        self.graph.initializer.extend(tensors)


def attribute(node: onnx.NodeProto, name: str) -> Sequence[int]:
    """The whole numbers of a node's attribute."""
    found = next(each for each in node.attribute if each.name == name)
    return list(found.ints)

"""A network as an ONNX graph that carries its specification.

The export writes it to a file for users; a training whose model looks at its last output runs it
on the way.
"""

from __future__ import annotations

import json
from typing import Any

import onnx
import torch
import torch._dynamo.config as tracing
from torch import Tensor, nn

from stillray.families.feature_filters import FeatureFiltersModel
from stillray.families.registry import kernels_of
from stillray.model_spec import ModelSpec
from stillray.models.registry import PROVENANCE_KEY, SPEC_KEY
from stillray_training.families import RECURRENT

OPSET = 18
EXAMPLE = (32, 48)  # height and width of the example inputs, pixels: multiples for any family


class BoundedLogits(nn.Module):
    """A network whose logits are clipped as its decoder would clip them.

    ONNX Runtime does it within the last convolution, for nothing; the runtime's decoders find that
    it is done and leave it out.
    """

    def __init__(self, network: nn.Module, bound: float) -> None:
        super().__init__()
        self.network = network
        self.bound = bound

    def forward(self, features: Tensor) -> Tensor | tuple[Tensor, ...]:
        """``(n, features, h, w)`` to logits, one map or one a level."""
        outputs = self.network(features)
        if isinstance(outputs, Tensor):
            return outputs.clamp(-self.bound, self.bound)
        return tuple(level.clamp(-self.bound, self.bound) for level in outputs)


def network_graph(fused: nn.Module, spec: ModelSpec, provenance: dict[str, Any]) -> onnx.ModelProto:
    """The graph of a fused network alone, which `stillray.Denoiser` runs."""
    with torch.no_grad():
        given = fused(example_features(spec))
    names = ["logits"] if isinstance(given, Tensor) else [f"logits_{i}" for i in range(len(given))]
    bound: float | None = getattr(spec.decoder, "logit_bound", None)
    return to_model(
        fused if bound is None else BoundedLogits(fused, bound).eval(),
        (example_features(spec),),
        ["features"],
        names,
        (axes_of(spec),),
        metadata_of(spec, {"parameters": 0, **provenance}),
    )


def example_features(spec: ModelSpec) -> Tensor:
    """Features of a small frame, to trace a network with."""
    return torch.zeros(1, len(spec.network.features), *EXAMPLE)


def axes_of(spec: ModelSpec) -> dict[int, Any]:
    """Height and width of a graph's inputs, free but for what they must be multiples of."""
    recurrent = spec.family in RECURRENT
    multiple = (
        FeatureFiltersModel(spec).alignment if recurrent else kernels_of(spec).looks.alignment
    )
    height, width = (torch.export.Dim(name, min=1) for name in ("height", "width"))
    # sizes are whole pixels of the coarsest level
    return {2: height, 3: width} if multiple == 1 else {2: multiple * height, 3: multiple * width}


def metadata_of(spec: ModelSpec, provenance: dict[str, Any]) -> dict[str, str]:
    """What a file carries beside its graph."""
    return {SPEC_KEY: spec.to_json(), PROVENANCE_KEY: json.dumps(provenance, sort_keys=True)}


def to_model(
    module: nn.Module,
    example: tuple[Tensor, ...],
    inputs: list[str],
    outputs: list[str],
    axes: tuple[Any, ...],
    metadata: dict[str, str],
) -> onnx.ModelProto:
    """Export with dynamic height and width, check, and attach metadata."""
    # Tracing looks up every operator by the sizes that it was given; of sizes that are formulas, a
    # look-up costs more than computing anew: a third of the time, for the same file.
    with torch.no_grad(), tracing.patch(fake_tensor_cache_enabled=False):
        program = torch.onnx.export(
            module,
            example,
            input_names=inputs,
            output_names=outputs,
            opset_version=OPSET,
            dynamo=True,
            dynamic_shapes=axes,
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    del model.metadata_props[:]
    for node in model.graph.node:  # the exporter notes paths of this machine in every node
        del node.metadata_props[:]
        node.doc_string = ""
    onnx.helper.set_model_props(model, metadata)
    model.producer_name = "stillray"
    onnx.checker.check_model(model, full_check=True)
    return model

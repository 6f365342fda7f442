"""``stillray-export runs/wskp-3``: a trained network becomes two ONNX files.

``NAME.onnx`` is the network alone, which the runtime pairs with its own reconstruction;
``NAME.whole.onnx`` takes features and accumulated irradiance to the filtered image in one graph,
for engines that embed ONNX Runtime themselves. Both carry the whole spec and the provenance, and
neither is written unless `stillray_export.parity` finds that all forms agree.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Annotated, Any

import onnx
import torch
import typer
from torch import Tensor, nn

from stillray.cli import program
from stillray.errors import InputError
from stillray.families.feature_filters import alignment
from stillray.families.registry import kernels_of
from stillray.io.exr.read_write import atomic_path
from stillray.model_spec import ModelSpec, from_json
from stillray.model_spec.loader import FeatureFilters
from stillray.models.registry import PROVENANCE_KEY, SPEC_KEY, WHOLE_SUFFIX, find_model, require_fit
from stillray.models.session import checked
from stillray_export import parity
from stillray_export.fuse import fuse
from stillray_training.decoders.boxes import pooled_box_mean
from stillray_training.evaluate.cases import find_cases
from stillray_training.evaluate.scores import evaluate_cases, mean_scores
from stillray_training.families import FAMILIES
from stillray_training.provenance import collect
from stillray_training.train import CHECKPOINT, load_network

OPSET = 18
_EXAMPLE = (32, 48)  # height and width of the example inputs, pixels: multiples for any family


class WholeDenoise(nn.Module):
    """Network and reconstruction in one graph."""

    def __init__(self, network: nn.Module, spec: ModelSpec) -> None:
        super().__init__()
        self.network = network
        self.spec = spec

    def forward(self, features: Tensor, *arrays: Tensor) -> Tensor:
        """``(n, features, h, w)`` and the family's inputs, ``(n, c, h, w)``, to an image."""
        family = FAMILIES[self.spec.family]
        batch = dict(zip(family.inputs, arrays, strict=True))
        return family.decode(self.network(features), batch, self.spec, pooled_box_mean)


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


def export(network: nn.Module, spec: ModelSpec, provenance: dict[str, Any], out: Path) -> Path:
    """Write both graphs of a model, after checking that they compute what was trained.

    Parameters
    ----------
    network
        The trained network; not changed.
    spec
        Its specification, embedded in the files.
    provenance
        Data, steps, date and scores, embedded in the files.
    out
        Folder for the files.

    Returns
    -------
    Path
        The file of the network alone.

    Raises
    ------
    stillray_export.parity.ParityError
        Two forms of the network differ by more than rounding: nothing is written.
    InputError
        The network is not what its specification describes, or is made of operators that the
        runtime does not take (`stillray.models.network_graph`): nothing is written.
    """
    if isinstance(spec.decoder, FeatureFilters):
        # its decoder takes and gives a past, and is checked otherwise
        from stillray_export.feature_filters import export as export_upscaling

        return export_upscaling(network, spec, provenance, out)
    fused = fuse(network)
    provenance = {
        **provenance,
        "parameters": sum(parameter.numel() for parameter in fused.parameters()),
    }
    alone = network_graph(fused, spec, provenance)
    family = FAMILIES[spec.family]
    arrays = [torch.ones(1, parity.CHANNELS[name], *_EXAMPLE) for name in family.inputs]
    axes = axes_of(spec)
    whole = to_model(
        WholeDenoise(fused, spec).eval(),
        (example_features(spec), *arrays),
        ["features", *family.inputs],
        ["denoised"],
        (axes, tuple(axes for _ in arrays)),
        metadata_of(spec, provenance),
    )
    # what the runtime would refuse is found here, not by who runs the model
    require_fit(checked(alone.SerializeToString(), spec.name)[1], spec, spec.name)
    parity.check(network, fused, alone.SerializeToString(), whole.SerializeToString(), spec)
    path = out / f"{spec.name}.onnx"
    for model, target in ((alone, path), (whole, out / f"{spec.name}{WHOLE_SUFFIX}.onnx")):
        with atomic_path(target) as temporary:
            temporary.write_bytes(model.SerializeToString())
    return path


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
    return torch.zeros(1, len(spec.network.features), *_EXAMPLE)


def axes_of(spec: ModelSpec) -> dict[int, Any]:
    """Height and width of a graph's inputs, free but for what they must be multiples of."""
    upscales = isinstance(spec.decoder, FeatureFilters)
    multiple = alignment(spec) if upscales else kernels_of(spec).looks.alignment
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
    with torch.no_grad():
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


def main(
    run: Annotated[
        Path,
        typer.Argument(help="Folder of a training run; with --frame-graph a model, as --model."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the .onnx files: that of the models, or with --frame-graph this one."
        ),
    ] = None,
    validation: Annotated[
        Path | None, typer.Option(help="Sequences with references: scores go into the files.")
    ] = None,
    frame_graph: Annotated[
        bool, typer.Option("--frame-graph", help="Write NAME.frame.onnx of a model that is there.")
    ] = False,
) -> None:
    """Export a trained run, or all stages of a model as one graph a frame."""
    if frame_graph:
        from stillray_export.frame_graph.export import write

        print(write(find_model(str(run)), out or Path()))
        return
    out = out or Path("runtime/stillray/models")
    from safetensors import safe_open

    checkpoint = run / CHECKPOINT
    if not checkpoint.is_file():
        raise InputError(f"run must be a training folder with {CHECKPOINT}, got {run}")
    with safe_open(checkpoint, framework="pt") as file:
        spec = from_json(file.metadata()["spec"])
    network, step = load_network(spec, checkpoint)
    about = {**collect(run, spec, step), "scores": {}}
    if validation is not None:
        with tempfile.TemporaryDirectory() as folder:
            unscored = str(export(network, spec, about, Path(folder)))
            sequences = find_cases(validation, kinds=["sequences"])
            (scores,) = evaluate_cases(sequences, {"model": unscored}, peers=()).values()
        about["scores"] = {
            name: round(value, 4) for name, value in mean_scores(scores)["model"].items()
        }
    print(export(network, spec, about, out))


if __name__ == "__main__":
    program.run(main)

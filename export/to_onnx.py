"""``python -m stillray.export.to_onnx runs/wskp-3``: a trained network becomes two ONNX files.

``NAME.onnx`` is the network alone, which the runtime pairs with its own reconstruction;
``NAME.whole.onnx`` takes accumulated irradiance and features to filtered irradiance in one graph,
for engines that embed ONNX Runtime themselves. Both carry the whole spec and the provenance, and
neither is written unless `stillray.export.parity` finds that all forms agree.
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
from stillray.export import parity
from stillray.export.fuse import fuse
from stillray.exr import atomic_path
from stillray.models_spec import ModelSpec, from_json
from stillray.models_spec.loader import Decoder
from stillray.registry import PROVENANCE_KEY, SPEC_KEY, WHOLE_SUFFIX
from stillray.training.decoders import fused_kernels, pooled_box_mean
from stillray.training.evaluate import evaluate_folder, mean_scores
from stillray.training.networks.importance import ImportanceNet
from stillray.training.provenance import collect
from stillray.training.train import CHECKPOINT, load_network

OPSET = 18


class WholeDenoise(nn.Module):
    """Network and reconstruction in one graph."""

    def __init__(self, network: nn.Module, decoder: Decoder) -> None:
        super().__init__()
        self.network = network
        self.decoder = decoder

    def forward(self, features: Tensor, irradiance: Tensor, samples: Tensor) -> Tensor:
        """``(n, features, h, w)``, ``(n, 3, h, w)``, ``(n, 1, h, w)`` to ``(n, 3, h, w)``."""
        logits = self.network(features)
        return fused_kernels(irradiance, samples, logits, self.decoder, box=pooled_box_mean)


def export(network: ImportanceNet, spec: ModelSpec, provenance: dict[str, Any], out: Path) -> Path:
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
    stillray.export.parity.ParityError
        Two forms of the network differ by more than rounding: nothing is written.
    """
    fused = fuse(network)
    features = torch.zeros(1, len(spec.network.features), 32, 48)
    color, samples = torch.zeros(1, 3, 32, 48), torch.ones(1, 1, 32, 48)
    axes = {2: torch.export.Dim("height", min=1), 3: torch.export.Dim("width", min=1)}
    provenance = {
        **provenance,
        "parameters": sum(parameter.numel() for parameter in fused.parameters()),
    }
    metadata = {SPEC_KEY: spec.to_json(), PROVENANCE_KEY: json.dumps(provenance, sort_keys=True)}
    alone = to_model(fused, (features,), ["features"], ["logits"], axes, metadata)
    whole = to_model(
        WholeDenoise(fused, spec.decoder).eval(),
        (features, color, samples),
        ["features", "irradiance", "samples"],
        ["denoised"],
        axes,
        metadata,
    )
    parity.check(network, fused, alone.SerializeToString(), whole.SerializeToString(), spec)
    path = out / f"{spec.name}.onnx"
    for model, target in ((alone, path), (whole, out / f"{spec.name}{WHOLE_SUFFIX}.onnx")):
        with atomic_path(target) as temporary:
            temporary.write_bytes(model.SerializeToString())
    return path


def to_model(
    module: nn.Module,
    example: tuple[Tensor, ...],
    inputs: list[str],
    outputs: list[str],
    axes: dict[int, Any],
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
            dynamic_shapes=tuple(axes for _ in example),
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
    run: Annotated[Path, typer.Argument(help="Folder of a training run.")],
    out: Annotated[Path, typer.Option(help="Folder for the .onnx files.")] = Path("runtime/models"),
    validation: Annotated[
        Path | None, typer.Option(help="Sequences with references: scores go into the files.")
    ] = None,
) -> None:
    """Export a trained run."""
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
            scores = evaluate_folder(validation, {"model": unscored}, peers=())
        about["scores"] = {
            name: round(value, 4) for name, value in mean_scores(scores)["model"].items()
        }
    print(export(network, spec, about, out))


if __name__ == "__main__":
    program.run(main)

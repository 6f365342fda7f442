"""``stillray-export runs/wskp-3``: a trained network becomes two ONNX files.

``NAME.onnx`` is the network alone, which the runtime pairs with its own reconstruction;
``NAME.whole.onnx`` takes features and accumulated irradiance to the filtered image in one graph,
for engines that embed ONNX Runtime themselves. Both carry the whole spec and the provenance, and
neither is written unless `stillray_export.parity` finds that all forms agree.
"""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path
from typing import Annotated, Any

import torch
import typer
from onnx import ModelProto
from safetensors import safe_open
from torch import Tensor, nn

from stillray.cli import program
from stillray.errors import InputError
from stillray.io.atomic import atomic_path
from stillray.model_spec import ModelSpec, from_json, load
from stillray.model_spec.rules import SpecError
from stillray.models.precision import int8_path, pairs_path
from stillray.models.registry import WHOLE_SUFFIX, find_model, require_fit
from stillray.models.session import checked
from stillray_export import feature_filters, parity
from stillray_export.frame_graph.color_curve import ColorCurve
from stillray_export.frame_graph.export import write_checked, write_spatial
from stillray_training.checkpoint import CHECKPOINT, load_network
from stillray_training.decoders.boxes import pooled_box_mean
from stillray_training.evaluate.cases import find_cases
from stillray_training.evaluate.scores import evaluate_cases, mean_scores
from stillray_training.families import FAMILIES, RECURRENT
from stillray_training.networks.fuse import fuse
from stillray_training.onnx_graph import (
    EXAMPLE,
    axes_of,
    example_features,
    metadata_of,
    network_graph,
    to_model,
)
from stillray_training.provenance import collect


class WholeDenoise(nn.Module):
    """Network and reconstruction in one graph."""

    def __init__(self, network: nn.Module, spec: ModelSpec) -> None:
        super().__init__()
        self.network = network
        self.spec = spec

    def forward(self, features: Tensor, *arrays: Tensor) -> Tensor:
        """``(n, features, h, w)`` and the family's inputs to an image, see `parity.shape_of`."""
        family = FAMILIES[self.spec.family]
        batch = dict(zip(family.inputs, arrays, strict=True))
        return family.decode(self.network(features), batch, self.spec, pooled_box_mean)


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
        The file of the network alone. One in integers of 8 bits that lay beside it is gone.

    Raises
    ------
    stillray_export.parity.ParityError
        Two forms of the network differ by more than rounding: nothing is written.
    InputError
        The network is not what its specification describes, or is made of operators that the
        runtime does not take (`stillray.models.network_graph`): nothing is written.
    """
    if spec.family in RECURRENT:
        # its decoder takes and gives a past, and is checked otherwise
        return feature_filters.export(network, spec, provenance, out)
    fused = fuse(network)
    provenance = {
        **provenance,
        "parameters": sum(parameter.numel() for parameter in fused.parameters()),
    }
    alone = network_graph(fused, spec, provenance)
    whole = whole_graph(fused, spec, provenance)
    # what the runtime would refuse is found here, not by who runs the model
    require_fit(checked(alone.SerializeToString(), spec.name)[1], spec, spec.name)
    parity.check(network, fused, alone.SerializeToString(), whole.SerializeToString(), spec)
    path = out / f"{spec.name}.onnx"
    for model, target in ((alone, path), (whole, out / f"{spec.name}{WHOLE_SUFFIX}.onnx")):
        with atomic_path(target) as temporary:
            temporary.write_bytes(model.SerializeToString())
    for integers in (int8_path(path), pairs_path(path)):
        integers.unlink(missing_ok=True)  # they were of the weights before
    return path


def whole_graph(fused: nn.Module, spec: ModelSpec, provenance: dict[str, Any]) -> ModelProto:
    """Network and reconstruction of a model as one graph."""
    family = FAMILIES[spec.family]
    arrays = [torch.ones(parity.shape_of(name, *EXAMPLE)) for name in family.inputs]
    axes = axes_of(spec)
    return to_model(
        WholeDenoise(fused, spec).eval(),
        (example_features(spec), *arrays),
        ["features", *family.inputs],
        ["denoised"],
        (axes, tuple({} if name in parity.SCALARS else axes for name in family.inputs)),
        metadata_of(spec, provenance),
    )


def main(
    run: Annotated[
        Path,
        typer.Argument(
            help="Folder of a training run; with --frame-graph or --spatial a model, as --model."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the .onnx files: that of the models; this one for graphs of frames."
        ),
    ] = None,
    validation: Annotated[
        Path | None, typer.Option(help="Sequences with references: scores go into the files.")
    ] = None,
    frame_graph: Annotated[
        bool, typer.Option("--frame-graph", help="Write NAME.frame.onnx of a model that is there.")
    ] = False,
    spatial: Annotated[
        ColorCurve | None,
        typer.Option(
            help="Write NAME.spatial.onnx of a model that is there, for frames without a past, as "
            "Unreal's NNE Denoiser has them; color through this curve."
        ),
    ] = None,
) -> None:
    """Export a trained run, or all stages of a model as one graph a frame."""
    if frame_graph:
        print(write_checked(find_model(str(run)), out or Path()))
    if spatial is not None:
        print(write_spatial(find_model(str(run)), out or Path(), spatial))
    if frame_graph or spatial is not None:
        return
    out = out or Path("runtime/stillray/models")
    checkpoint = run / CHECKPOINT
    if not checkpoint.is_file():
        raise InputError(f"run must be a training folder with {CHECKPOINT}, got {run}")
    with safe_open(checkpoint, framework="pt") as file:
        spec = as_specified_now(from_json(file.metadata()["spec"]))
    network, step = load_network(spec, checkpoint)
    about = {**collect(run, spec, step), "scores": {}}
    if validation is not None:
        with tempfile.TemporaryDirectory() as folder:
            about["scores"] = scores_of(export(network, spec, about, Path(folder)), validation)
    print(export(network, spec, about, out))


def scores_of(model: Path, validation: Path) -> dict[str, float]:
    """Mean scores of a model's file over the sequences of a folder."""
    sequences = find_cases(validation, kinds=["sequences"])
    (scores,) = evaluate_cases(sequences, {"model": str(model)}, peers=()).values()
    return {name: round(value, 4) for name, value in mean_scores(scores)["model"].items()}


def as_specified_now(trained: ModelSpec) -> ModelSpec:
    """What a model's file says of it: the rules and prose of today, the recipe that it followed.

    A run's own specification where there is none of its name today, or one of another network.
    """
    try:
        now = load(trained.name)
    except SpecError:
        return trained
    if now.family != trained.family or now.network != trained.network:
        return trained
    # rules as well: no output of the network is there for them
    names = (
        "filter_tone", "resolve_tone", "recall_power", "recall_noise",
        "albedo_filters", "sharp_recall", "learning_rate",
    )  # fmt: skip
    rules = {name: value for name, value in vars(trained.decoder).items() if name in names}
    if dataclasses.replace(now.decoder, **rules) != trained.decoder:
        return trained
    return dataclasses.replace(now, training=trained.training)


if __name__ == "__main__":
    program.run(main)

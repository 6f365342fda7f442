"""``stillray models``: what there is to choose from, and how good it is."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from stillray.models.registry import ModelInfo

_WORK_SIZE = 1280, 720  # pixels
_NOTE = """
Scores: of sequences of 1 sample a pixel, with the weights as they were exported; bias in %.
Found by name, too: {unlisted}.
Names that end in -still are what qualities are of frames that have no past, those that end in
-color of such frames with neither albedo nor normals."""


def models(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    verbose: Annotated[
        bool,
        typer.Option(
            "-v",
            "--verbose",
            help="Also what each network computes, and how it differs from the paper it follows.",
        ),
    ] = False,
) -> None:
    """List the models: inputs, size and validation scores."""
    from stillray.models.registry import list_models, unlisted_models

    found = list_models()
    if as_json:
        print(json.dumps([_as_dict(model) for model in found], indent=2))
    else:
        _print_table(found)
        print(_NOTE.format(unlisted=", ".join(unlisted_models())))
        if verbose:
            _print_differences(found)


def _as_dict(model: ModelInfo) -> dict[str, Any]:
    from stillray.models.registry import differences

    return {
        "name": model.name,
        "family": model.family,
        "quality": list(model.aliases),
        "summary": model.summary,
        "inputs": list(model.inputs),
        "optional_inputs": list(model.optional_inputs),
        "parameters": model.parameters,
        "size_bytes": model.size_bytes,
        "scores": dict(model.scores),
        "differs": list(differences(model)),
        "path": str(model.path),
    }


def _print_table(found: list[ModelInfo]) -> None:
    from rich.table import Table

    from stillray.cli.output import console

    scores = list(dict.fromkeys(score for model in found for score in model.scores))
    table = Table(box=None, pad_edge=False)
    for heading in ("name", "family", "quality", "inputs (optional)"):
        table.add_column(heading)
    for heading in ("parameters", "kB", *scores):
        table.add_column(heading, justify="right")
    for model in found:
        optional = f" ({', '.join(model.optional_inputs)})" if model.optional_inputs else ""
        table.add_row(
            model.name,
            model.family,
            ", ".join(model.aliases),
            ", ".join(model.inputs) + optional,
            f"{model.parameters:,}",
            f"{model.size_bytes / 1000:.1f}",
            *(f"{model.scores[s]:.4g}" if s in model.scores else "-" for s in scores),
        )
    console().print(table)


def _print_differences(found: list[ModelInfo]) -> None:
    from stillray.models.registry import differences

    for model in found:
        print(f"\n{model.name}: {model.summary}{_network_work(model)}")
        print("What the paper says, and what it does here:")
        for difference in differences(model):
            print(f"- {difference}")


def _network_work(model: ModelInfo) -> str:
    """What a model's network computes for a frame, in a sentence; empty if nothing is known."""
    import numpy as np

    from stillray.frame import Frame
    from stillray.profiling.cost import stage_costs

    width, height = _WORK_SIZE
    frame = Frame(color=np.zeros((height, width, 3), np.float32))
    network = stage_costs(model, frame).get("network")
    if network is None:
        return ""
    return f"\nIts network: {network.operations / 1e9:.1f} GFLOP for {width}x{height} pixels."

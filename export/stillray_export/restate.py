"""``python -m stillray_export.restate NAME``: rules and prose of today, weights as they are.

What a specification says of stages around the network, of its past and of the papers, may change
without a step of training; what is in a model's files then says what was.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import onnx
import typer

from stillray.cli import program
from stillray.errors import InputError
from stillray.io.atomic import atomic_path
from stillray.model_spec import ModelSpec
from stillray.models.precision import int8_path, made_of, pairs_path
from stillray.models.registry import WHOLE_SUFFIX, ModelInfo, find_model
from stillray_export import feature_filters, parity
from stillray_export.to_onnx import as_specified_now, scores_of, whole_graph
from stillray_training.families import RECURRENT, network_of
from stillray_training.networks.fuse import fuse
from stillray_training.onnx_graph import metadata_of
from stillray_training.start import read_start


def restate(path: Path, validation: Path | None = None) -> list[Path]:
    """Write a model's files anew with today's specification of its name.

    Parameters
    ----------
    path
        ``NAME.onnx``; its whole graph and its networks in integers lie beside it, if any.
    validation
        Sequences with references, whose scores take the place of those before; None for none: the
        scores stay.

    Returns
    -------
    list of Path
        What was written. The whole graph is exported anew where rules of the reconstruction are
        other ones: they are part of it.

    Raises
    ------
    stillray_export.parity.ParityError
        The whole graph would differ from the runtime by more than rounding.
    InputError
        There is no such model, there is nothing to tell (it says all of it already, and no scores
        are asked for), or today's specification is of another network.
    """
    info = find_model(path)
    spec = as_specified_now(info.spec)
    if validation is None and spec.to_json() == info.spec.to_json():
        raise InputError(f"model must say something else than its specification today, got {path}")
    whole = path.with_name(f"{path.stem}{WHOLE_SUFFIX}.onnx")
    files = [file for file in (path, whole, int8_path(path), pairs_path(path)) if file.is_file()]
    if whole.is_file() and spec.decoder != info.spec.decoder:
        _reconstruct_anew(info, whole, spec)
    _tell(files, metadata_of(spec, info.provenance))
    if validation is not None:
        told = {**info.provenance, "scores": scores_of(path, validation)}
        _tell(files, metadata_of(spec, told))
    return files


def _reconstruct_anew(info: ModelInfo, whole: Path, spec: ModelSpec) -> None:
    """Write the graph that reconstructs, too, which does it by the rules before."""
    network = network_of(spec)
    network.load_state_dict(dict(read_start(info.path).weights))
    fused = fuse(network.eval())
    alone, provenance = info.path.read_bytes(), info.provenance
    if spec.family in RECURRENT:
        graph = feature_filters.whole_graph(fused, spec, provenance)
        feature_filters.check(network, fused, alone, graph, spec)
    else:
        graph = whole_graph(fused, spec, provenance).SerializeToString()
        parity.check(network, fused, alone, graph, spec)
    with atomic_path(whole) as temporary:
        temporary.write_bytes(graph)


def _tell(files: list[Path], metadata: dict[str, str]) -> None:
    """Write metadata into a model's files, each after that which it was made of."""
    floats = files[0]
    sources = {int8_path(floats): floats, pairs_path(floats): int8_path(floats)}
    for file in files:
        model = onnx.load(file)
        told = {entry.key: entry.value for entry in model.metadata_props} | metadata
        if file in sources:
            told |= made_of(sources[file].read_bytes())
        del model.metadata_props[:]
        onnx.helper.set_model_props(model, told)
        with atomic_path(file) as temporary:
            temporary.write_bytes(model.SerializeToString())


def main(
    model: Annotated[str, typer.Argument(help="A model's name or file.")],
    validation: Annotated[
        Path | None, typer.Option(help="Sequences with references, for its scores.")
    ] = None,
) -> None:
    """Give a model's files the specification of today."""
    for path in restate(find_model(model).path, validation):
        print(path)


if __name__ == "__main__":
    program.run(main)

"""``stillray-export kpyr-5 --frame-graph``: a model file becomes one graph a frame.

``--spatial oidn`` makes one of a frame alone.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import onnx
import torch
from onnx import TensorProto, helper
from torch import Tensor

from stillray.io.atomic import atomic_path
from stillray.model_spec.network_outputs import network_outputs
from stillray.models.frame_graph import FRAME_SUFFIX, PORTS_KEY, SPATIAL_SUFFIX, Ports
from stillray.models.registry import PROVENANCE_KEY, SPEC_KEY, ModelInfo
from stillray_export.frame_graph import parity
from stillray_export.frame_graph.color_curve import ColorCurve
from stillray_export.frame_graph.frame import NUMBERS, FrameGraph, beginning
from stillray_export.frame_graph.graph import Placeholder, expanded, traced
from stillray_export.frame_graph.ports import ports, spatial_ports
from stillray_export.frame_graph.spatial import PLANES, SpatialGraph

_EXAMPLE = (37, 58)  # pixels; odd, and no multiple of what networks take


def write_checked(info: ModelInfo, out: Path) -> Path:
    """`write`, once `parity.check` has found that the graph's pictures are the runtime's.

    Raises
    ------
    InputError
        The model is of a family that has no frame graph.
    stillray_export.parity.ParityError
        The graph's pictures are others: nothing is written.
    """
    with tempfile.TemporaryDirectory() as folder:
        made = write(info, Path(folder))
        parity.check(made, info)
        with atomic_path(out / made.name) as temporary:
            temporary.write_bytes(made.read_bytes())
    return out / made.name


def write(info: ModelInfo, out: Path) -> Path:
    """Write ``NAME.frame.onnx`` of a model into a folder.

    Raises
    ------
    InputError
        The model is of a family that has no frame graph.
    """
    return _written(frame_graph(info), out / f"{info.name}{FRAME_SUFFIX}.onnx")


def write_spatial(info: ModelInfo, out: Path, curve: ColorCurve) -> Path:
    """Write ``NAME.spatial.onnx`` of a model into a folder; see `SpatialGraph` for what it is.

    Raises
    ------
    InputError
        The model is of a family that has no frame graph.
    """
    return _written(spatial_graph(info, curve), out / f"{info.name}{SPATIAL_SUFFIX}.onnx")


def _written(model: onnx.ModelProto, path: Path) -> Path:
    with atomic_path(path) as temporary:
        temporary.write_bytes(model.SerializeToString())
    return path


def frame_graph(info: ModelInfo) -> onnx.ModelProto:
    """The graph of a whole frame of a model; see `ports` for what it takes and gives."""
    spec = info.spec
    network = onnx.load_model(str(info.path))
    module = FrameGraph(Placeholder(network_outputs(spec)), spec).eval()
    told = ports(spec)
    names = [port.name for port in told.inputs], [port.name for port in told.outputs]
    model = traced(module, _example(module), names, network)
    _typed(model.graph)
    return _told(model, info, told)


def spatial_graph(info: ModelInfo, curve: ColorCurve) -> onnx.ModelProto:
    """The graph of a frame alone: ``(1, PLANES, h, w)`` to ``(1, 3, h, w)``."""
    spec = info.spec
    network = onnx.load_model(str(info.path))
    module = SpatialGraph(Placeholder(network_outputs(spec)), spec, curve).eval()
    told = spatial_ports(curve)
    names = [port.name for port in told.inputs], [port.name for port in told.outputs]
    example = torch.rand(1, PLANES, *_EXAMPLE, generator=torch.Generator().manual_seed(0))
    model = traced(module, [example], names, network, sizes=(2, 3))
    for value, planes in ((model.graph.input[0], PLANES), (model.graph.output[0], 3)):
        shape: list[int | str] = [1, planes, "height", "width"]
        value.CopyFrom(helper.make_tensor_value_info(value.name, TensorProto.FLOAT, shape))
    return _told(model, info, told)


def _told(model: onnx.ModelProto, info: ModelInfo, told: Ports) -> onnx.ModelProto:
    """A graph with what there is to know of it, checked."""
    metadata = {
        SPEC_KEY: info.spec.to_json(),
        PROVENANCE_KEY: json.dumps(info.provenance, sort_keys=True),
        PORTS_KEY: told.to_json(),
    }
    helper.set_model_props(model, metadata)
    model.producer_name, model.producer_version = "stillray", ""
    onnx.checker.check_model(model)
    return model


def _example(module: FrameGraph) -> list[Tensor]:
    generator = torch.Generator().manual_seed(0)
    height, width = _EXAMPLE

    def image(*channels: int) -> Tensor:
        return torch.rand(height, width, *channels, generator=generator)

    past = beginning(height, width, module.spec)
    state = [past.mean, past.guides, past.output, past.noise, past.numbers]
    if past.albedo is not None:
        state.append(past.albedo)
    told = [image()] if module.spec.knows_filter else []
    return [image(3), image(3), image(3), image(), image(2), image(), *told, *state]


def _typed(graph: onnx.GraphProto) -> None:
    """Name the sizes of inputs and outputs; inputs that may be left out get sizes of their own."""
    for value in (*graph.input, *graph.output):
        name = value.name
        rank = [part.dim_value or None for part in value.type.tensor_type.shape.dim]
        channels = rank[2:]
        own = name not in ("color", "denoised") and not name.startswith("next_")
        if name.endswith("_numbers"):
            shape: list[int | str] = [NUMBERS]
        elif name.endswith("_noise"):
            prefix = f"{name} " if own else ""
            shape = [f"{prefix}rows", f"{prefix}columns"]
        else:
            prefix = f"{name} " if own else ""
            shape = [f"{prefix}height", f"{prefix}width", *_channels(name, channels)]
            if own:
                expanded(graph, name, ["color", "color", *_channels(name, channels)])
        typed = helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
        value.CopyFrom(typed)


def _channels(name: str, found: list[int | None]) -> list[int]:
    """The channels of an image; the tracer does not tell those of every output."""
    known = {"denoised": 3, "next_mean": 4, "next_guides": 4, "next_output": 3, "next_albedo": 3}
    return [known[name]] if name in known else [part for part in found if part]

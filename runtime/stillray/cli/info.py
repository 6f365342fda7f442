"""``stillray info``: what a file holds, what is made of it, and which stages will run."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stillray.errors import InputError, printable

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    import numpy as np

    from stillray.frame import Frame
    from stillray.io.channels.motion_detection import Detection
    from stillray.io.channels.roles import LayerMatch
    from stillray.io.exr.file import ExrFile
    from stillray.io.exr.pixel_filter import FilterSource
    from stillray.io.exr.samples import SampleSource
    from stillray.model_spec import ModelSpec


def info(
    file: Annotated[
        str,
        typer.Argument(
            help="An EXR or PFM file, or a sequence: its first frame; or a frame graph."
        ),
    ],
    model: Annotated[
        str, typer.Option("--model", "-m", help="Quality, model name or .onnx file.")
    ] = "high",
    layer: Annotated[
        list[str] | None,
        typer.Option("--layer", help="ROLE=NAME: take this layer, or channels, for a role."),
    ] = None,
    view: Annotated[
        str | None,
        typer.Option(
            help="Of files with several views: the one to look at; the first unless given."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    graph: Annotated[
        bool,
        typer.Option("--graph", help="FILE is a frame graph, or its model's name."),
    ] = False,
) -> None:
    """Show the channels found, their roles, and the stages that will run.

    Where a file cannot be denoised, it shows what there is in it before it says why. Of a frame
    graph, NAME.frame.onnx, it shows all inputs and outputs.
    """
    if graph or file.endswith(".onnx"):
        _show(_graph(file), as_json, _print_graph)
        return
    from stillray.io.channels.roles import parse_overrides
    from stillray.io.exr.file import ExrFile
    from stillray.io.exr.views import VIEW
    from stillray.io.file_sequence import expand
    from stillray.io.image_file import is_float_map

    chosen = parse_overrides(layer or []) | ({} if view is None else {VIEW: view})
    paths = [numbered.path for numbered in expand(file)]
    if is_float_map(paths[0]):
        _show(_of_float_map(paths[0], model), as_json, _print_facts)
        return
    opened = ExrFile.open(paths[0])
    if len(opened.views) > 1:
        chosen = {VIEW: opened.views[0], **chosen}
    try:
        facts = _collect(paths, model, chosen)
    except InputError:
        _show({"file": printable(str(paths[0])), **_stored(opened)}, as_json, _print_stored)
        raise
    _show(facts, as_json, _print_facts)


def _graph(name: str) -> dict[str, Any]:
    from stillray.models.frame_graph import find_frame_graph, read_frame_graph

    path = find_frame_graph(name)
    file = read_frame_graph(path)
    return {
        "file": printable(str(path)),
        "size_bytes": file.size_bytes,
        "operators": {printable(name): count for name, count in file.operators.items()},
        **asdict(file.ports),
    }


def _print_graph(facts: dict[str, Any]) -> None:
    from rich.table import Table

    from stillray.cli.output import console
    from stillray.models.frame_graph import describe_graph

    out = console()
    out.print(f"{facts['file']}: float32 tensors, no batch axis")
    out.print(describe_graph(facts["operators"], facts["size_bytes"]))
    for kind in ("inputs", "outputs"):
        columns = ("name", "shape", "unit", "convention")
        more = ("neutral", "next") if kind == "inputs" else ()
        table = Table(*columns, *more, box=None, pad_edge=False)
        for port in facts[kind]:
            table.add_row(*(port[column] for column in (*columns, *more)))
        out.print(f"\n{kind}:")
        out.print(table)
    out.print(
        "\nAn input with a neutral value may be left out: a tensor with 1 in the place of height "
        "and width that holds it. A state's next is its input for the next frame."
    )


def _show(
    facts: dict[str, Any], as_json: bool, print_facts: Callable[[dict[str, Any]], None]
) -> None:
    if as_json:
        print(json.dumps(facts, indent=2))
    else:
        print_facts(facts)


def _stored(opened: ExrFile) -> dict[str, Any]:
    """What a file holds, whatever is made of it."""
    return {
        "parts": [
            {
                "name": part.name,
                "compression": part.compression,
                "tile": list(part.tile) if part.tile else None,
                "channels": {channel.name: channel.kind for channel in part.channels},
            }
            for part in opened.container.parts
        ],
        "channels": list(opened.channels),
        "views": list(opened.views),
    }


def _print_stored(facts: dict[str, Any]) -> None:
    print(facts["file"])
    print(printable(_describe(facts["parts"])))
    print(printable(f"channels: {', '.join(facts['channels'])}"), flush=True)


def _collect(paths: Sequence[Path], model: str, chosen: dict[str, str]) -> dict[str, Any]:
    from stillray.io.channels.motion_detection import detect_in_sequence
    from stillray.io.channels.roles import JITTER, find_layers
    from stillray.io.exr.file import ExrFile
    from stillray.io.exr.layers import require_color
    from stillray.io.exr.pixel_filter import find_filter
    from stillray.io.exr.read import read_exr
    from stillray.io.exr.samples import find_samples
    from stillray.io.exr.views import VIEW

    path = paths[0]
    opened = ExrFile.of_layers(path, chosen)
    matches = require_color(path, find_layers(opened.channels, chosen), opened.channels)
    detection = detect_in_sequence(paths, layers=chosen)
    if detection is not None and len(paths) > 1:
        matches = [_with_proof(match, detection) for match in matches]
    convention = detection.convention if detection else None
    frame = read_exr(path, layers={**chosen, JITTER: "none"}, convention=convention)
    jitter, wrong = _find_jitter(opened, chosen)
    frame = replace(frame, jitter=jitter)
    part = opened.container.parts[opened.channels[matches[0].channels[0]][0]]
    if len(paths) == 1 or not any(m.role == "motion" and m.used for m in matches):
        model = _of_single_frames(model, frame)
    spec, stages = _stages(frame, model)
    if wrong and spec.knows_jitter:
        raise InputError(wrong)
    return {
        "file": str(path),
        "height": frame.shape[0],
        "width": frame.shape[1],
        "view": chosen.get(VIEW),
        "data_window": list(part.data),
        "display_window": list(part.display),
        **_stored(opened),
        "layers": [
            {
                "role": match.role,
                "channels": list(match.channels),
                "signs": list(match.signs),
                "naming": match.renderer,
                "used": match.used,
                "note": match.note,
            }
            for match in matches
        ],
        "samples": _samples(frame, find_samples(opened, matches, chosen))
        | {"told": spec.knows_samples},
        "pixel_filter": _filter(find_filter(opened, matches[0].channels[0]))
        | {"told": spec.knows_filter},
        "jitter": _jitter(jitter) | {"note": wrong, "told": spec.knows_jitter},
        "color_pixels": _count_pixels(frame.color),
        "warnings": _warnings(frame.normal),
        **stages,
    }


def _of_float_map(path: Path, model: str) -> dict[str, Any]:
    from stillray.io.exr.pixel_filter import FilterSource
    from stillray.io.exr.samples import SampleSource
    from stillray.io.frame_file import read_frame
    from stillray.io.image_file import kind_of_map, read_image

    frame = read_frame(path, {})
    channels = ["R", "G", "B"] if read_image(path, "color").shape[2] == 3 else ["Y"]
    kind = kind_of_map(path)
    spec, stages = _stages(frame, _of_single_frames(model, frame))
    window = [0, 0, frame.shape[1], frame.shape[0]]
    return {
        "file": str(path),
        "height": frame.shape[0],
        "width": frame.shape[1],
        "view": None,
        "data_window": window,
        "display_window": window,
        "parts": [
            {
                "name": "",
                "compression": "none",
                "tile": None,
                "channels": dict.fromkeys(channels, kind),
            }
        ],
        "channels": channels,
        "views": [],
        "layers": [
            {
                "role": "color",
                "channels": channels,
                "signs": [1.0] * len(channels),
                "naming": "float map",
                "used": True,
                "note": "",
            }
        ],
        "samples": _samples(frame, SampleSource()) | {"told": spec.knows_samples},
        "pixel_filter": _filter(FilterSource()) | {"told": spec.knows_filter},
        "jitter": _jitter(None) | {"note": "", "told": spec.knows_jitter},
        "color_pixels": _count_pixels(frame.color),
        "warnings": [],
        **stages,
    }


def _of_single_frames(model: str, frame: Frame) -> str:
    """What a quality is for frames like this one, which have no past."""
    from stillray.models.registry import for_single_frames

    return for_single_frames(model, guided=frame.guided)


def _stages(frame: Frame, model: str) -> tuple[ModelSpec, dict[str, Any]]:
    """The model's specification; its name, and its stages for a first frame."""
    from stillray.pipeline.denoiser import Denoiser

    with Denoiser(model) as denoiser:
        stages = [
            {"name": stage.name, "runs": stage.runs, "reason": stage.reason}
            for stage in denoiser.stages(frame)
        ]
        return denoiser.model.spec, {"model": denoiser.model.name, "stages": stages}


def _with_proof(match: LayerMatch, detection: Detection) -> LayerMatch:
    if match.role != "motion":
        return match
    if detection.convention is None:
        return replace(match, note=f"not proven, not used: {detection.reason}")
    return replace(match.proven(detection.convention), note=f"proven: {detection.reason}")


def _samples(frame: Frame, source: SampleSource) -> dict[str, Any]:
    import numpy as np

    facts: dict[str, Any] = {"from": source.name or None, "note": source.note}
    if frame.samples is None:
        return {"least": None, "mean": None, "most": None, **facts}
    sampled = np.asarray(frame.samples)
    sampled = sampled[~np.isnan(sampled)]
    if not sampled.size:
        return {"least": None, "mean": None, "most": None, **facts}
    least, mean, most = (float(value) for value in (sampled.min(), sampled.mean(), sampled.max()))
    return {"least": least, "mean": mean, "most": most, **facts}


def _say_samples(samples: dict[str, Any]) -> str:
    note = f" ({samples['note']})" if samples["note"] else ""
    if samples["mean"] is None:
        return f"samples: not known{note}"
    count = f"{samples['most']:g} a pixel"
    if samples["least"] < samples["most"]:
        count = f"{samples['least']:g} to {count}, {samples['mean']:.4g} in the mean"
    network = "" if samples["told"] else "; the network is not told, it did not learn with them"
    return f"samples: {count}, from {samples['from']}{note}{network}"


def _filter(source: FilterSource) -> dict[str, Any]:
    return {"spread": source.spread, "from": source.name or None, "note": source.note}


def _say_filter(found: dict[str, Any]) -> str:
    note = f" ({found['note']})" if found["note"] else ""
    if found["spread"] is None:
        hint = "; --pixel-filter says it" if found["told"] else ""
        return f"pixel filter: not known{note}{hint}"
    network = "" if found["told"] else "; the network is not told, it did not learn with it"
    return (
        f"pixel filter: {found['spread']:.2f} pixels of standard deviation, from {found['from']}"
        f"{note}{network}"
    )


def _find_jitter(opened: ExrFile, chosen: dict[str, str]) -> tuple[np.ndarray | None, str]:
    """A file's jitter; or why it says none that can be used, which few models mind."""
    from stillray.io.exr.jitter import find_jitter

    try:
        return find_jitter(opened, chosen), ""
    except InputError as error:
        return None, str(error)


def _jitter(jitter: np.ndarray | None) -> dict[str, float | None]:
    x, y = (None, None) if jitter is None else (float(value) for value in jitter)
    return {"x": x, "y": y}


def _say_jitter(found: dict[str, Any]) -> str:
    from stillray.io.exr.jitter import JITTER_ATTRIBUTE

    note = f" ({found['note']})" if found["note"] else ""
    if found["x"] is None:
        hint = f"; {JITTER_ATTRIBUTE} says it" if found["told"] else ""
        return f"jitter: not known{note}{hint}"
    network = "" if found["told"] else "; the model does not look at it"
    return (
        f"jitter: samples lie ({found['x']:.4g}, {found['y']:.4g}) pixels from the centres of "
        f"their pixels, x right and y down, from {JITTER_ATTRIBUTE}{network}"
    )


def _count_pixels(color: np.ndarray) -> dict[str, int]:
    import numpy as np

    return {
        "total": color.shape[0] * color.shape[1],
        "nan": int(np.isnan(color).any(axis=-1).sum()),
        "infinite": int(np.isinf(color).any(axis=-1).sum()),
        "negative": int((color < 0).any(axis=-1).sum()),
    }


def _warnings(normal: np.ndarray | None) -> list[str]:
    import numpy as np

    if normal is None or not np.any(normal > 0) or np.any(normal < 0):
        return []
    return ["normal has no negative component: it may be encoded as 0..1, which is not decoded"]


def _describe(parts: list[dict[str, Any]]) -> str:
    def several(key: str) -> str:
        return ", ".join(dict.fromkeys(str(part[key]) for part in parts))

    kinds = dict.fromkeys(kind for part in parts for kind in part["channels"].values())
    count = "1 part" if len(parts) == 1 else f"{len(parts)} parts"
    tiles = [f"{part['tile'][0]} x {part['tile'][1]}" for part in parts if part["tile"]]
    stored = f"tiles of {tiles[0]}" if tiles else "scan lines"
    return f"{count} of {stored}, {', '.join(kinds)}, compression {several('compression')}"


def _print_facts(facts: dict[str, Any]) -> None:
    from rich.table import Table

    from stillray.cli.output import console

    out = console()
    pixels = facts["color_pixels"]
    out.print(f"{printable(facts['file'])}: {facts['width']} x {facts['height']} pixels")
    out.print(_describe(facts["parts"]))
    if len(facts["views"]) > 1:
        out.print(
            f"views: {', '.join(facts['views'])}; this is {facts['view']}; all are denoised, each "
            "with a history of its own, unless --view names one"
        )
    for name in ("data_window", "display_window"):
        x, y, width, height = facts[name]
        out.print(f"{name.replace('_', ' ')}: {width} x {height} at ({x}, {y})")
    counts = ", ".join(f"{pixels[kind]} {kind}" for kind in ("nan", "infinite", "negative"))
    out.print(f"color pixels: {counts}, of {pixels['total']}")
    out.print(_say_samples(facts["samples"]))
    out.print(_say_filter(facts["pixel_filter"]))
    out.print(printable(_say_jitter(facts["jitter"])))
    for warning in facts["warnings"]:
        out.print(f"warning: {warning}")
    out.print()

    layers = Table("role", "channels", "naming", "used", "note", box=None, pad_edge=False)
    for layer in facts["layers"]:
        signed = [
            f"-{name}" if sign < 0 else name
            for name, sign in zip(layer["channels"], layer["signs"], strict=True)
        ]
        used = "yes" if layer["used"] else "no"
        channels, note = printable(", ".join(signed)), printable(layer["note"])
        layers.add_row(layer["role"], channels, layer["naming"], used, note)
    out.print(layers)
    taken = {name for layer in facts["layers"] for name in layer["channels"]}
    rest = [name for name in facts["channels"] if name not in taken]
    out.print(f"channels without a role: {printable(', '.join(rest)) or 'none'}")
    out.print()

    stages = Table("stage", "runs", "why", box=None, pad_edge=False)
    for stage in facts["stages"]:
        stages.add_row(stage["name"], "yes" if stage["runs"] else "no", stage["reason"])
    out.print(f"stages with {facts['model']}, for a first frame:")
    out.print(stages)

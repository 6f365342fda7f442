"""``python -m stillray_training.cycles_sequences RENDERED OUT``: Cycles' renders as sequences.

Reads what ``stillray_training.blender.sequences`` wrote, which runs in Blender's own Python, and
writes what training reads, target included.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import track

from stillray.batch.file_layout import Layout
from stillray.cli import program
from stillray.errors import InputError
from stillray.frame import Frame
from stillray.io.atomic import atomic_path
from stillray.pixel_filter import cycles_spread
from stillray_training.blender.record import RECORD as RENDERED
from stillray_training.blender.record import TAKEN
from stillray_training.own_renders import layers_of
from stillray_training.simulate.sequence import RECORD, is_complete, write
from stillray_training.targets import make_targets

_BRIGHTNESS = 0.03  # by which a target may be off its reference: more, and it teaches that, too


def take(rendered: Path, out: Path, assets: Path | None = None) -> float | None:
    """One scene's files as a sequence, with its target.

    A scene is left out if it has no light (a room of a seed may have no window and its only lamp
    inside of a thing), or if filtering changed the brightness of its reference by more than 3 %.

    Parameters
    ----------
    rendered
        Folder of a scene that is finished.
    out
        Folder for the sequence, made if missing.
    assets
        Folder of the objects that stand in it, for their credits.

    Returns
    -------
    float
        Mean brightness of the target over the reference's, minus 1, tone-mapped; None if the
        sequence is there already, or the scene has no light.

    Raises
    ------
    InputError
        A file cannot be read, or an asset has no credit.
    """
    if is_complete(out):
        return None
    given = json.loads((rendered / RENDERED).read_text(encoding="utf-8"))
    before: Path | None = None
    paths = sorted(rendered.glob("frame_*.exr"))
    layout = Layout.of(paths)
    (reference,) = sorted(rendered.glob("ref_*.exr"))
    clean = layers_of(_read(layout, reference, None))
    if not clean["color"].any():
        return None
    out.mkdir(parents=True, exist_ok=True)
    for path in paths:
        write(out / path.name, layers_of(_read(layout, path, before)))
        before = path
    for path in sorted(rendered.glob("block_*.exr")):
        write(out / path.name, layers_of(_read(layout, path, paths[-2])))
    write(out / reference.name, {name: clean[name] for name in ("color", "albedo", "normal")})
    record = {
        "scene": given["scene"],
        "seed": given["seed"],
        "options": {
            **{name: given[name] for name in ("frames", "height", "width", "spp", "blocks")},
            "reference_spp": given["reference_spp"],
            "reference_features": given["reference_spp"],
            "references": 1,
        },
        "assets": [_credit(assets, name) for name in given["used"]],
        "filter_spread": _filter_spread(given),
        "renderer": f"Cycles, Blender {given['blender']}",
    }
    bias = make_targets(out)
    if abs(bias) > _BRIGHTNESS:
        shutil.rmtree(out)
        return bias
    # last: a sequence that has it is complete
    with atomic_path(out / RECORD) as temporary:
        temporary.write_text(json.dumps(record, indent=1))
    return bias


def _filter_spread(given: dict[str, Any]) -> float | None:
    """Of the pixel filter that a scene was rendered with; None of records that lack its width."""
    kind = given.get("filter")
    width = given.get("filter_width", 1.0 if kind == "BOX" else None)  # a box is of any width
    return None if kind is None or width is None else cycles_spread(kind, width)


def _read(layout: Layout, path: Path, before: Path | None) -> Frame:
    (view,) = layout.read(path, {}, before)
    return view.frame


def _credit(assets: Path | None, name: str) -> dict[str, Any]:
    path = None if assets is None else assets / name / "asset.json"
    if path is None or not path.is_file():
        raise InputError(f"assets must hold {name}, which stands in the scene, got {assets}")
    found = json.loads(path.read_text(encoding="utf-8"))
    return {key: found[key] for key in ("name", "title", "author", "licence", "source")}


def main(
    rendered: Annotated[Path, typer.Argument(help="Folder of rendered scenes.")],
    out: Annotated[Path, typer.Argument(help="Folder for the sequences.")],
    assets: Annotated[Path | None, typer.Option(help="Folder of the objects in them.")] = None,
    remove: Annotated[bool, typer.Option("--remove", help="Delete renders once taken.")] = False,
) -> None:
    """Make sequences of all finished scenes that are not yet among them."""
    done = sorted(path.parent for path in rendered.glob(f"*/{RENDERED}"))
    biases = []
    for folder in track(done, "scenes", console=Console(stderr=True)):
        scene = json.loads((folder / RENDERED).read_text(encoding="utf-8"))["scene"]
        bias = take(folder, out / f"{scene}-{folder.name}-0", assets)
        if bias is not None:
            biases.append(bias)
        if remove:
            shutil.rmtree(folder)
            folder.mkdir()
            (folder / TAKEN).touch()
    taken = [bias for bias in biases if abs(bias) <= _BRIGHTNESS]
    if taken:
        print(
            f"{len(taken)} sequences; brightness of targets against the references: "
            f"mean {np.mean(taken):+.4f}, from {np.min(taken):+.4f} to {np.max(taken):+.4f}"
        )
    if len(taken) < len(biases):
        print(f"{len(biases) - len(taken)} left out: brighter or darker by {_BRIGHTNESS:.0%}")


if __name__ == "__main__":
    program.run(main)

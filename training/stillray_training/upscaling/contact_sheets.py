"""``python -m stillray_training.upscaling.contact_sheets DATA --model munet-x2``: for the eye.

The crops of `stillray_training.contact_sheets`, of frames that were doubled: what came in, ours,
the flagship and Open Image Denoise enlarged by Lanczos, and the reference.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stillray.cli import program
from stillray.compare.display import display_exposure
from stillray.errors import InputError
from stillray_training.contact_sheets import CROPS, compose, read_sheets, save
from stillray_training.examples import find_sequences
from stillray_training.upscaling.compare import ENLARGED, compared, scene_of

_ENLARGED = ENLARGED.format("")  # what the name of a method that is enlarged ends in


def main(
    data: Annotated[Path, typer.Argument(help="Folder of rendered sequences.")],
    model: Annotated[str, typer.Option(help="The model, or the path of its .onnx file.")],
    flagship: Annotated[str, typer.Option(help="Whose pictures are enlarged beside it.")] = "high",
    out: Annotated[Path, typer.Option(help="Folder of the pictures.")] = Path("docs/contact"),
    crops: Annotated[Path, typer.Option(help="TOML that says where to look.")] = CROPS,
) -> None:
    """Write a contact sheet of every scene whose sequence is among the crops and the data."""
    side, enlargement, sheets = read_sheets(crops)
    scenes = {scene_of(path): path for path in find_sequences(data)}
    wanted = [sheet for sheet in sheets if sheet.set == "sequences" and sheet.case in scenes]
    if not wanted:
        raise InputError(f"data must hold scenes that {crops} has crops of, got {data}")
    out.mkdir(parents=True, exist_ok=True)
    for sheet in wanted:
        found = compared(scenes[sheet.case], model, flagship)
        reference = found.references[-1]
        rows = [
            ("noisy", found.noisy),
            # what fits beside a row
            *((method.removesuffix(_ENLARGED), last[-1]) for method, last in found.methods.items()),
            ("reference", reference),
        ]
        exposure = display_exposure(reference)
        page = compose(sheet, rows, exposure=exposure, side=side, enlargement=enlargement)
        save(out / f"{sheet.file}-x2.png", page)


if __name__ == "__main__":
    program.run(main)

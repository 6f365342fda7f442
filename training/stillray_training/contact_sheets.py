"""``python -m stillray_training.contact_sheets VALIDATION``: crops for the eye, a picture a scene.

Columns are places that go wrong, chosen by looking at the references; rows are what came in, ours,
Open Image Denoise and the reference.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import typer

from stillray.cli import program
from stillray.compare.display import display_exposure, tone_map
from stillray.errors import InputError
from stillray.io.atomic import atomic_path
from stillray.models.registry import find_model, for_single_frames
from stillray_training.evaluate.__main__ import find_all, withheld
from stillray_training.evaluate.cases import WITHOUT_PAST, Case
from stillray_training.evaluate.methods import NOISY, Methods
from stillray_training.peers import find_peer

CROPS = Path(__file__).with_name("contact_sheets.toml")
_PEER = "oidn-high"
LEFT, TOP, GAP = 92, 22, 4  # pixels for the labels of rows and columns, and between crops


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """One picture: a frame, and the places in it to look at.

    Attributes
    ----------
    file
        Name without suffix.
    set, case
        The frame, as `stillray_training.evaluate.cases` calls it.
    crops
        Title, and column and row of the upper left pixel, of each.
    """

    file: str
    set: str
    case: str
    crops: tuple[tuple[str, int, int], ...]


def read_sheets(path: Path) -> tuple[int, int, list[Sheet]]:
    """Side of a crop in pixels, its enlargement, and the sheets, from a TOML file."""
    given = tomllib.loads(path.read_text())
    sheets = [
        Sheet(
            file=entry["file"],
            set=entry["set"],
            case=entry["case"],
            crops=tuple((crop["what"], crop["x"], crop["y"]) for crop in entry["crops"]),
        )
        for entry in given["sheets"]
    ]
    return given["side"], given["enlargement"], sheets


def compose(
    sheet: Sheet,
    rows: Sequence[tuple[str, np.ndarray]],
    *,
    exposure: float,
    side: int,
    enlargement: int,
) -> np.ndarray:
    """The picture of a sheet.

    Parameters
    ----------
    sheet
        The places.
    rows
        Label and radiance ``(h, w, 3)`` of each row.
    exposure
        Of all of them.
    side, enlargement
        Pixels of a crop, and how many times as large it is shown.

    Returns
    -------
    (rows, columns, 3) uint8
        Tone-mapped red, green, blue.

    Raises
    ------
    InputError
        A crop does not lie within the frame.
    """
    step = side * enlargement + GAP
    shape = TOP + len(rows) * step, LEFT + len(sheet.crops) * step, 3
    page = np.full(shape, 255, np.uint8)
    for row, (label, image) in enumerate(rows):
        shown = np.rint(tone_map(image, exposure) * 255).astype(np.uint8)
        for column, (what, x, y) in enumerate(sheet.crops):
            crop = shown[y : y + side, x : x + side]
            if min(x, y) < 0 or crop.shape[:2] != (side, side):
                height, width = shown.shape[:2]
                raise InputError(
                    f"{sheet.file}: crop must lie within {width}x{height}, got {what} at {x}, {y}"
                )
            large = crop.repeat(enlargement, 0).repeat(enlargement, 1)
            top, left = TOP + row * step, LEFT + column * step
            page[top : top + len(large), left : left + len(large)] = large
            if row == 0:
                _write(page, what, (left, TOP - 7))
        _write(page, label, (2, TOP + row * step + step // 2))
    return page


def _write(page: np.ndarray, text: str, place: tuple[int, int]) -> None:
    cv2.putText(page, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)


def save(path: Path, page: np.ndarray) -> None:
    """Write a small PNG, and say so: enlarged pixels are worth the strongest compression."""
    coded = cv2.imencode(".png", page[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])[1]
    with atomic_path(path) as temporary:
        temporary.write_bytes(coded.tobytes())
    print(path)


def pictures(case: Case, model: str) -> tuple[list[tuple[str, np.ndarray]], float]:
    """Rows of a sheet, and the exposure of the reference: of the last frame of a case."""
    frames, references = case.read()
    alone = case.kind in WITHOUT_PAST
    name = for_single_frames(model, guided=frames[-1].guided) if alone else model
    name = find_model(name).name
    with Methods({name: model}, [_PEER]) as methods:
        found: dict[str, Any] = dict(methods.run(case, frames, len(references)))
    rows = [(label, found[label][-1]) for label in (NOISY, name, find_peer(_PEER).label)]
    return [*rows, ("reference", references[-1])], display_exposure(references[-1])


def main(
    folders: Annotated[
        list[str], typer.Argument(help="FOLDER or LABEL=FOLDER of frames with references.")
    ],
    out: Annotated[Path, typer.Option(help="Folder of the pictures.")] = Path("docs/contact"),
    model: Annotated[str, typer.Option(help="Model or .onnx.")] = "high",
    pixel_filter: Annotated[
        str | None, typer.Option(help="Of frames whose files do not say, as stillray-evaluate's.")
    ] = None,
    film: Annotated[float, typer.Option(help="As stillray-evaluate's.")] = 0.0,
    without: Annotated[str | None, typer.Option(help="As stillray-evaluate's.")] = None,
    crops: Annotated[Path, typer.Option(help="TOML that says where to look.")] = CROPS,
) -> None:
    """Write a contact sheet for every frame of the crops file that the folders have."""
    found = find_all(folders, pixel_filter=pixel_filter, film=film, without=withheld(without))
    cases = {(case.title, case.name): case for case in found}
    side, enlargement, sheets = read_sheets(crops)
    out.mkdir(parents=True, exist_ok=True)
    for sheet in sheets:
        case = cases.get((sheet.set, sheet.case))
        if case is None:
            print(f"{sheet.file}: no {sheet.case} among {sheet.set}")
            continue
        rows, exposure = pictures(case, model)
        page = compose(sheet, rows, exposure=exposure, side=side, enlargement=enlargement)
        save(out / f"{sheet.file}.png", page)


if __name__ == "__main__":
    program.run(main)

"""A report on a rendered set: a contact sheet and how effects, brightness and motion spread."""

from __future__ import annotations

import html
import json
from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import typer

from stillray.cli import program
from stillray.errors import InputError
from stillray.io.atomic import atomic_path
from stillray.io.exr.read import read_channels
from stillray_training.simulate.effects import EFFECTS
from stillray_training.simulate.sequence import RECORD, is_complete

CONTACT, PAGE = "contact.png", "report.html"
_TILE = 160  # pixels
_COLUMNS = 8
_MOST = 160  # tiles of a contact sheet


def main(folder: Annotated[Path, typer.Argument(help="A folder of sequences.")]) -> None:
    """Write contact.png and report.html into a folder of rendered sequences."""
    write_report(folder)


def write_report(folder: Path) -> None:
    """Write the report of a folder of sequences into that folder.

    Raises
    ------
    InputError
        The folder is missing or holds no finished sequence.
    """
    if not folder.is_dir():
        raise InputError(f"folder must be a folder of sequences, got {folder}")
    sequences = sorted(path for path in folder.iterdir() if is_complete(path))
    if not sequences:
        raise InputError(f"folder must hold finished sequences, {folder} has none")
    records = [json.loads((path / RECORD).read_text(encoding="utf-8")) for path in sequences]
    tiles, brightness, motion = [], [], []
    step = max(1, len(sequences) // _MOST)
    for index, path in enumerate(sequences):
        picture = _picture(path)
        brightness.append(float(np.median(picture.mean(axis=-1))))
        motion.append(_median_motion(path))
        if index % step == 0:
            tiles.append(_tile(picture))
    with atomic_path(folder / CONTACT) as temporary:
        done, data = cv2.imencode(".png", contact_sheet(tiles))
        assert done
        temporary.write_bytes(data.tobytes())
    with atomic_path(folder / PAGE) as temporary:
        temporary.write_text(_page(records, brightness, motion), encoding="utf-8")


def contact_sheet(tiles: list[np.ndarray]) -> np.ndarray:
    """Square ``(n, n, 3)`` tiles in rows; black where there are no more."""
    blank = np.zeros_like(tiles[0])
    columns = min(_COLUMNS, len(tiles))
    padded = tiles + [blank] * (-len(tiles) % columns)
    rows = [np.hstack(padded[i : i + columns]) for i in range(0, len(padded), columns)]
    return np.vstack(rows)


def _picture(sequence: Path) -> np.ndarray:
    """The last reference, or the last frame where there is none."""
    last = (sorted(sequence.glob("ref_*.exr")) or sorted(sequence.glob("frame_*.exr")))[-1]
    channels = read_channels(last)
    return np.stack([channels[name] for name in "RGB"], axis=-1)


def _median_motion(sequence: Path) -> float:
    channels = read_channels(sorted(sequence.glob("frame_*.exr"))[-1])
    return float(np.median(np.hypot(channels["motion.X"], channels["motion.Y"])))


def _tile(picture: np.ndarray) -> np.ndarray:
    exposure = 0.2 / max(float(np.median(picture.mean(axis=-1))), 1e-6)
    shown = np.clip(picture * exposure, 0, 1) ** (1 / 2.2)
    scale = _TILE / max(picture.shape[:2])
    size = (max(1, round(shown.shape[1] * scale)), max(1, round(shown.shape[0] * scale)))
    small = cv2.resize(shown, size, interpolation=cv2.INTER_AREA)
    tile = np.zeros((_TILE, _TILE, 3), np.uint8)
    tile[: small.shape[0], : small.shape[1]] = (255 * small[..., ::-1]).round()
    return tile


def _page(records: list[dict[str, Any]], brightness: list[float], motion: list[float]) -> str:
    effects: Counter[str] = Counter(name for r in records for name in r.get("effects", ()))
    scenes = Counter(str(record["scene"]) for record in records)
    moves = Counter(str(record.get("move", "unknown")) for record in records)
    stops = np.log2(np.maximum(brightness, 1e-6))
    light_edges = np.arange(np.floor(stops.min()), np.ceil(stops.max()) + 1.5)
    light = np.histogram(stops, light_edges)[0]
    motion_edges = [0.0, 0.05, 0.5, 1, 2, 4, 8, 16, np.inf]
    shift = np.histogram(motion, motion_edges)[0]
    parts = [
        f"<h1>{len(records)} sequences</h1>",
        _bars("effect", [(name, effects[name]) for name in EFFECTS]),
        _bars("scene", scenes.most_common()),
        _bars("camera move", moves.most_common()),
        _bars(
            "median radiance, 2^",
            [(f"{e:.0f}", int(n)) for e, n in zip(light_edges, light, strict=False)],
        ),
        _bars(
            "median motion, pixels a frame",
            [
                (f"{low:g} to {high:g}", int(n))
                for low, high, n in zip(motion_edges[:-1], motion_edges[1:], shift, strict=True)
            ],
        ),
        f'<p>Last reference of each, exposed for its median.</p><img src="{CONTACT}">',
    ]
    style = (
        "body{font:15px sans-serif;margin:2em}td{padding:0 .8em 0 0}"
        "hr{border:0;height:.7em;background:#579;margin:0}"
    )
    return (
        f"<!doctype html><meta charset=utf-8><title>sequences</title><style>{style}</style>"
        + "".join(parts)
    )


def _bars(title: str, rows: list[tuple[str, int]]) -> str:
    most = max((n for _, n in rows), default=1) or 1
    lines = "".join(
        f"<tr><td>{html.escape(name)}<td align=right>{n}<td><hr style='width:{300 * n // most}px'>"
        for name, n in rows
    )
    return f"<h2>{html.escape(title)}</h2><table>{lines}</table>"


if __name__ == "__main__":
    program.run(main)

"""One HTML page that holds everything: pixels, metrics, and the viewer that shows them."""

from __future__ import annotations

import base64
import html
import json
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import IO, Any

import numpy as np

from stillray.compare import MAX_MEGAPIXELS, metrics, scores, view_transform
from stillray.compare.carried import Carried, Region, layers_in, read_carried, size_of
from stillray.compare.display import display_exposure
from stillray.compare.pixels import box_average, pack_map, pack_radiance
from stillray.compare.sources import FrameFiles, Sources
from stillray.compare.view_transform import aces_view
from stillray.errors import InputError
from stillray.io.atomic import atomic_path

_SCRIPTS = ("decode.js", "shade.js", "stage.js", "tables.js", "viewer.js")
_PIXELS_HERE = "<!-- pixels -->"
_LARGEST_HALF = float(np.finfo(np.float16).max)


@dataclass(frozen=True, kw_only=True)
class _Page:
    """What is the same for all frames: the region, the images' size, and whose size that is."""

    region: Region
    size: tuple[int, int]
    first: Path


@dataclass(frozen=True, kw_only=True)
class Summary:
    """What was written: bytes, and the figures of the images, means where there are frames."""

    size_bytes: int
    values: Sequence[scores.Values]


def write_page(
    path: Path,
    sources: Sources,
    *,
    title: str | None = None,
    region: Region | None = None,
    max_megapixels: float = MAX_MEGAPIXELS,
    progress: Callable[[Sequence[FrameFiles]], Iterable[FrameFiles]] = iter,
) -> Summary:
    """Write the page, complete or not at all; one frame at a time is held in memory.

    Parameters
    ----------
    path
        Where to write.
    sources
        From `stillray.compare.sources.pair`.
    title
        Heading; the labels unless given.
    region
        What to carry of every image; all of it unless given.
    max_megapixels
        Limit of the pixels carried, all images and frames together, millions.
    progress
        Wraps the frames while they are gone through.

    Raises
    ------
    InputError
        A file cannot be read or differs in size, the region lies outside, there is too much to
        carry, or the packages of the metrics are not installed.
    """
    region = region or Region()
    if sources.reference_label is not None:
        metrics.require(scores.NAMES)
    first = sources.frames[0].images[0]
    size = size_of(first, region)
    _check(sources, size, region, max_megapixels)
    _check_layers(sources, region)
    page = _Page(region=region, size=size, first=first)
    head, tail = _template(title or " · ".join(sources.labels))
    frames: list[dict[str, Any]] = []
    measured: list[list[scores.Values]] = []
    with atomic_path(path) as temporary:
        with temporary.open("w", encoding="utf-8") as out:
            out.write(head)
            before: list[np.ndarray] = []  # images and reference of the frame before
            number: int | None = None
            for index, frame in enumerate(progress(sources.frames)):
                follows = number is not None and frame.number == number + 1
                facts, values, before = _write_frame(
                    out, index, frame, before if follows else [], page
                )
                frames.append(facts)
                measured.append(values)
                number = frame.number
            means = scores.means(measured)
            transform = aces_view()
            if transform is not None:
                _embed(out, "cube", transform.table)
            out.write(tail(_data(sources, frames, measured, means, size, region)))
        size_bytes = temporary.stat().st_size
    return Summary(size_bytes=size_bytes, values=means)


def _write_frame(
    out: IO[str], index: int, frame: FrameFiles, before: list[np.ndarray], page: _Page
) -> tuple[dict[str, Any], list[scores.Values], list[np.ndarray]]:
    """Write one frame's pixels; what the page should know of it, its figures, its colors."""
    paths = [*frame.images, *([frame.reference] if frame.reference else [])]
    carried = [_read(path, page) for path in paths]
    pictures = [one.color for one in carried]
    reference = pictures[-1] if frame.reference else None
    values: list[scores.Values] = [{} for _ in frame.images]
    has_flip = []
    for place, picture in enumerate(pictures):
        errors = None
        if reference is not None and place < len(frame.images):
            pair = (before[place], before[-1]) if len(before) == len(pictures) else None
            values[place], errors = scores.measure(picture, reference, pair)
        _embed_picture(out, f"{index}-{place}", carried[place], page.region)
        if errors is not None:
            _embed(out, f"flip-{index}-{place}", pack_map(_shrink(errors, page.region)))
        has_flip.append(errors is not None)
    facts = {
        "number": frame.number,
        "files": [path.name for path in paths],
        "not_finite": [int((~np.isfinite(p)).any(axis=-1).sum()) for p in pictures],
        "clamped": [_count_beyond_half(p) for p in pictures],
        "has_reference": reference is not None,
        "has_flip": has_flip,
        "has_alpha": [one.alpha is not None for one in carried],
        "layers": [[name in one.layers for name in page.region.layers] for one in carried],
        "exposure": math.log2(_exposure(pictures[-1] if reference is not None else pictures[0])),
    }
    return facts, values, pictures if reference is not None else []


def _embed_picture(out: IO[str], name: str, carried: Carried, region: Region) -> None:
    """Color as ``radiance-NAME``, the layers after it as ``radiance-NAME-1`` and so on, alpha."""
    _embed(out, f"radiance-{name}", pack_radiance(_shrink(carried.color, region)))
    for number, layer in enumerate(region.layers, 1):
        if layer in carried.layers:
            packed = pack_radiance(_shrink(carried.layers[layer], region))
            _embed(out, f"radiance-{name}-{number}", packed)
    if carried.alpha is not None:
        _embed(out, f"alpha-{name}", pack_map(_shrink(np.nan_to_num(carried.alpha), region)))


def _data(
    sources: Sources,
    frames: list[dict[str, Any]],
    measured: list[list[scores.Values]],
    means: Sequence[scores.Values],
    size: tuple[int, int],
    region: Region,
) -> dict[str, Any]:
    shown = scores.columns([row for rows in measured for row in rows])
    x, y, width, height = region.crop or (0, 0, size[1], size[0])

    def cells(rows: Sequence[scores.Values]) -> list[list[dict[str, Any]]]:
        return [
            [{"text": cell.text, "best": cell.is_best} for cell in row]
            for row in scores.table(rows, shown)
        ]

    for facts, rows in zip(frames, measured, strict=True):
        facts["rows"] = cells(rows)
    return {
        "labels": [
            *sources.labels,
            *([sources.reference_label] if sources.reference_label else []),
        ],
        "images": len(sources.labels),
        "width": math.ceil(width / region.downscale),
        "height": math.ceil(height / region.downscale),
        "origin": [x, y],
        "downscale": region.downscale,
        "full_size": [size[1], size[0]],
        "cropped": region.crop is not None,
        "metrics": [{"name": metric.name, "title": metric.title} for metric in shown],
        "means": cells(means),
        "layers": ["color", *region.layers],
        "transform": _transform_facts(),
        "frames": frames,
    }


def _template(title: str) -> tuple[str, Callable[[dict[str, Any]], str]]:
    """The page before its pixels, and a function that makes what comes after them."""
    from stillray.version import __version__

    folder = files("stillray.compare") / "template"
    text = (folder / "page.html").read_text(encoding="utf-8")
    head, tail = (Template(part) for part in text.split(_PIXELS_HERE))
    style = (folder / "page.css").read_text(encoding="utf-8")
    scripts = [(folder / name).read_text(encoding="utf-8") for name in _SCRIPTS]

    def finish(data: dict[str, Any]) -> str:
        # "<" could end the element that the data lie in
        text = json.dumps(data, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
        return tail.substitute(data=text, script="\n".join(scripts))

    return head.substitute(title=html.escape(title), style=style, version=__version__), finish


def _embed(out: IO[str], name: str, data: bytes) -> None:
    # an unknown type makes a script element mere text
    out.write(f'<script type="text/plain" id="{name}">{base64.b64encode(data).decode()}</script>\n')


def _transform_facts() -> dict[str, Any] | None:
    transform = aces_view()
    if transform is None:
        return None
    return {
        "name": transform.name,
        "nodes": view_transform.NODES,
        "steepness": view_transform.STEEPNESS,
        "stops": view_transform.STOPS,
    }


def _read(path: Path, page: _Page) -> Carried:
    carried, crop = read_carried(path, page.region), page.region.crop
    found = carried.color.shape[:2]
    if found != page.size:
        raise InputError(f"{path}: must have the size {page.size} of {page.first}, got {found}")
    if crop is None:
        return carried
    x, y, width, height = crop
    return carried.map(lambda image: np.ascontiguousarray(image[y : y + height, x : x + width]))


def _shrink(picture: np.ndarray, region: Region) -> np.ndarray:
    return picture if region.downscale == 1 else box_average(picture, region.downscale)


def _check(sources: Sources, size: tuple[int, int], region: Region, max_megapixels: float) -> None:
    if region.downscale < 1:
        raise InputError(f"--downscale must be 1 or more, got {region.downscale}")
    x, y, width, height = region.crop or (0, 0, size[1], size[0])
    if min(x, y) < 0 or min(width, height) < 1 or x + width > size[1] or y + height > size[0]:
        raise InputError(
            f"--crop must be X,Y,WIDTH,HEIGHT inside of {size[1]} x {size[0]} pixels, "
            f"got {x},{y},{width},{height}"
        )
    if sources.reference_label is not None and min(width, height) < scores.SMALLEST_SIDE:
        raise InputError(
            f"images must be {scores.SMALLEST_SIDE} x {scores.SMALLEST_SIDE} pixels or more "
            f"to be measured, got {width} x {height}"
        )
    images = sum(len(f.images) + (f.reference is not None) for f in sources.frames)
    pictures = images * (1 + len(region.layers))

    def megapixels(factor: int) -> float:
        return pictures * math.ceil(width / factor) * math.ceil(height / factor) / 1e6

    if megapixels(region.downscale) > max_megapixels:
        factor = region.downscale
        while megapixels(factor) > max_megapixels and factor < max(width, height):
            factor += 1
        raise InputError(
            f"the page may carry {max_megapixels:g} million pixels, got "
            f"{megapixels(region.downscale):.1f} in {pictures} pictures: --downscale {factor} "
            "fits, or take a --crop, fewer --frames or more --max-megapixels"
        )


def _check_layers(sources: Sources, region: Region) -> None:
    """Raise `InputError` where a layer is in no file of the first frame."""
    frame = sources.frames[0]
    there = frozenset[str]().union(*(layers_in(path, region) for path in frame.images))
    for name in region.layers:
        if name not in there:
            raise InputError(
                f"layer must be in one of the images, got {name}; stillray info lists what is in "
                f"{frame.images[0]}"
            )


def _exposure(picture: np.ndarray) -> float:
    finite = picture[np.isfinite(picture).all(axis=-1)]
    return display_exposure(finite) if finite.size else 1.0


def _count_beyond_half(picture: np.ndarray) -> int:
    beyond = np.isfinite(picture) & (np.abs(picture) > _LARGEST_HALF)
    return int(beyond.any(axis=-1).sum())

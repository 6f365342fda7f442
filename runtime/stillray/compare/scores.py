"""Figures of the compared images: per frame, their means, and which is best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stillray.compare import metrics
from stillray.compare.metrics import METRICS, Metric

#: What is measured; ColorVideoVDP is left out: it needs torch, and seconds a frame.
NAMES = ("psnr", "ssim", "smape", "relmse", "flip", "flicker")
#: SSIM's window, pixels: nothing smaller can be measured.
SMALLEST_SIDE = 7

Values = Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class Cell:
    """A figure as a table shows it; the best of its column are marked."""

    text: str
    is_best: bool


def measure(
    image: np.ndarray,
    reference: np.ndarray,
    before: tuple[np.ndarray, np.ndarray] | None = None,
) -> tuple[Values, np.ndarray | None]:
    """Metrics of one image, and its FLIP map.

    Parameters
    ----------
    image, reference : (h, w, 3) float32
        Scene-linear radiance.
    before : two of (h, w, 3) float32, optional
        Image and reference of the frame before, for flicker.

    Returns
    -------
    values
        By name, a part of `NAMES`; none where a pixel is NaN or infinite.
    map : (h, w) float32 or None
        FLIP error of each pixel.
    """
    if not (np.isfinite(image).all() and np.isfinite(reference).all()):
        return {}, None
    one_by_one = [name for name in NAMES if name not in ("flip", "flicker")]
    values = metrics.evaluate([image], [reference], names=one_by_one)
    errors, values["flip"] = metrics.flip(image, reference)
    if before is not None and all(np.isfinite(picture).all() for picture in before):
        values["flicker"] = metrics.flicker(before[0], image, before[1], reference)
    return values, errors


def means(frames: Sequence[Sequence[Values]]) -> Sequence[Values]:
    """Mean over frames, a row an image.

    An image that lacks a figure in a frame where another has it gets none: means over
    different frames do not compare.
    """
    count = len(frames[0])
    rows: list[dict[str, float]] = [{} for _ in range(count)]
    for name in NAMES:
        measured = [frame for frame in frames if any(name in row for row in frame)]
        for image in range(count):
            if measured and all(name in frame[image] for frame in measured):
                rows[image][name] = float(np.mean([frame[image][name] for frame in measured]))
    return rows


def columns(rows: Sequence[Values]) -> list[Metric]:
    """The metrics that at least one row has, in the order of the tables."""
    return [metric for metric in METRICS if any(metric.name in row for row in rows)]


def table(rows: Sequence[Values], shown: Sequence[Metric]) -> list[list[Cell]]:
    """A row an image, a cell a metric. One image alone is never the best."""
    best = {}
    for metric in shown:
        there = [row[metric.name] for row in rows if metric.name in row]
        if len(there) > 1:
            best[metric.name] = min(there, key=metric.loss)
    return [
        [
            Cell(
                text=_text(row[metric.name], metric) if metric.name in row else "–",
                is_best=metric.name in row and row[metric.name] == best.get(metric.name),
            )
            for metric in shown
        ]
        for row in rows
    ]


def _text(value: float, metric: Metric) -> str:
    return "∞" if np.isinf(value) else format(value, metric.format)

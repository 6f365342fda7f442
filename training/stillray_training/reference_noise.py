"""``python -m stillray_training.reference_noise VALIDATION --model kpyr-5``: what references add.

References are of finitely many samples, and noisy themselves. Whatever denoises, a difference
between two frames holds the noise of two references; the steadier a method, the larger a part of
its flicker that is. So sequences are measured against references as they were rendered and against
the same made smooth by Open Image Denoise; the detail that it loses counts against all alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table

from stillray.cli import program
from stillray.compare import metrics
from stillray_training.evaluate.cases import find_cases
from stillray_training.evaluate.methods import Methods
from stillray_training.peers.oidn import open_image_denoise

Pair = tuple[np.ndarray, np.ndarray]

_NAMES = ("psnr", "flicker")
_EQUAL = 120.0  # dB at most: pictures that are the same


@dataclass(frozen=True, kw_only=True)
class Figures:
    """PSNR in dB of the last of two frames, as displayed, and their flicker."""

    psnr: float
    flicker: float


def figures_of(images: Pair, references: Pair) -> Figures:
    """Those of two frames ``(h, w, 3)`` against two references, the last ones last."""
    found = metrics.evaluate(images, references, names=_NAMES)
    return Figures(psnr=min(found["psnr"], _EQUAL), flicker=found["flicker"])


def smooth(references: Pair) -> Pair:
    """References without their noise: by Open Image Denoise high, of their radiance alone."""
    before, last = (open_image_denoise(each, None, None, "high") for each in references)
    return before, last


def _rows(
    folder: Path, models: Sequence[str], peers: Sequence[str]
) -> dict[str, list[tuple[Figures, Figures]]]:
    rows: dict[str, list[tuple[Figures, Figures]]] = {}
    with Methods({model: model for model in models}, peers) as methods:
        for case in track(find_cases(folder, kinds=["sequences"]), console=Console(stderr=True)):
            frames, given = case.read()
            references = (given[-2], given[-1])
            clean = smooth(references)
            alone = (figures_of(clean, references), figures_of(clean, clean))
            rows.setdefault("references made smooth", []).append(alone)
            for method, images in methods.run(case, frames, 2):
                pair = (images[-2], images[-1])
                found = (figures_of(pair, references), figures_of(pair, clean))
                rows.setdefault(method, []).append(found)
    return rows


def main(
    folder: Annotated[Path, typer.Argument(help="Scenes with sequences, as stillray-evaluate's.")],
    model: Annotated[list[str] | None, typer.Option("--model", "-m", help="Repeatable.")] = None,
    peer: Annotated[list[str] | None, typer.Option(help="Repeatable; oidn-high if none.")] = None,
) -> None:
    """Print figures of sequences against references as rendered, and against smooth ones."""
    metrics.require(_NAMES)
    table = Table("method", "PSNR", "smooth", "flicker", "smooth")
    for method, found in _rows(folder, model or ["kpyr-5"], peer or ["oidn-high"]).items():
        psnr, flickers = (
            [np.mean([getattr(pair[side], name) for pair in found]) for side in (0, 1)]
            for name in _NAMES
        )
        cells = (*(f"{value:.2f}" for value in psnr), *(f"{value:.4f}" for value in flickers))
        table.add_row(method, *cells)
    Console().print(table)


if __name__ == "__main__":
    program.run(main)

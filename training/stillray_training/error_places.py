"""``python -m stillray_training.error_places VALIDATION --model kpyr-5``: where errors are.

Splits the squared error of stills, as displayed, into edges of surfaces, textures and the rest, and
into bands by size: what each of several blurs, ever wider, takes away, from noise and lost detail
to mottling and light that is off as a whole.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table

from stillray.cli import program
from stillray.compare.display import display_exposure, tone_map
from stillray.errors import InputError
from stillray.frame import Frame
from stillray_training.evaluate.cases import find_cases
from stillray_training.evaluate.methods import Methods

_EDGE = 0.5  # slope of albedo, normal and log depth together, a pixel, after a blur of one
_TEXTURE = 0.01  # of the display's range, against the mean over a few pixels
_NEAR = 2.0  # pixels
#: Wavelengths between bands, pixels: a blur lets half of the amplitude of one pass.
WAVES = (4, 8, 16, 32, 64)
_BLUR_OF_WAVE = math.sqrt(math.log(2) / 2) / math.pi  # its standard deviation, as a share


@dataclass(frozen=True, kw_only=True)
class ErrorPlaces:
    """Mean squared error of a picture as displayed, and the parts that add up to it.

    Attributes
    ----------
    edges, textures, rest
        By where pixels lie; the sum is that of all.
    bands
        By size: of waves shorter than the first of `WAVES`, of those between two, beyond the last.
    """

    edges: float
    textures: float
    rest: float
    bands: tuple[float, ...]

    @property
    def total(self) -> float:
        """Over all pixels."""
        return self.edges + self.textures + self.rest


def edges_of(frame: Frame) -> np.ndarray:
    """Pixels at edges of surfaces, ``(h, w)`` bool, by albedo, normal and depth.

    Raises
    ------
    InputError
        The frame lacks one of them.
    """
    missing = [name for name in ("albedo", "normal", "depth") if getattr(frame, name) is None]
    if missing:
        raise InputError(f"frames must have albedo, normal and depth, lack {', '.join(missing)}")
    assert frame.albedo is not None
    assert frame.normal is not None
    assert frame.depth is not None
    depth = 2 * np.log(np.maximum(frame.depth, np.float32(1e-3)))
    guides = np.dstack([frame.albedo, frame.normal, depth]).astype(np.float32)
    slope = np.zeros(frame.shape, np.float32)
    for plane in cv2.split(cv2.GaussianBlur(guides, (0, 0), 1.0)):
        slope += np.abs(cv2.Sobel(plane, -1, 1, 0)) + np.abs(cv2.Sobel(plane, -1, 0, 1))
    return np.asarray(cv2.dilate((slope > _EDGE).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)


def find_errors(image: np.ndarray, reference: np.ndarray, edges: np.ndarray) -> ErrorPlaces:
    """Where a picture differs from its reference.

    Parameters
    ----------
    image, reference : (h, w, 3)
        Radiance.
    edges : (h, w) bool
        Pixels at edges of surfaces, see `edges_of`.
    """
    exposure = display_exposure(reference)
    wanted = tone_map(reference, exposure)
    error = (tone_map(image, exposure) - wanted).astype(np.float32)
    gray = wanted.mean(axis=-1).astype(np.float32)
    textures = ~edges & (np.abs(gray - cv2.GaussianBlur(gray, (0, 0), _NEAR)) > _TEXTURE)
    squares = np.square(error).mean(axis=-1)
    left = [error, *(cv2.GaussianBlur(error, (0, 0), _BLUR_OF_WAVE * wave) for wave in WAVES)]
    bands = [*(near - far for near, far in pairwise(left)), left[-1]]
    return ErrorPlaces(
        edges=float((squares * edges).mean()),
        textures=float((squares * textures).mean()),
        rest=float((squares * ~(edges | textures)).mean()),
        bands=tuple(float(np.square(band).mean()) for band in bands),
    )


def _rows(
    folder: Path, models: Sequence[str], peers: Sequence[str]
) -> dict[tuple[str, str], list[ErrorPlaces]]:
    rows: dict[tuple[str, str], list[ErrorPlaces]] = {}
    with Methods({model: model for model in models}, peers) as methods:
        for case in track(find_cases(folder, kinds=["stills"]), console=Console(stderr=True)):
            frames, references = case.read()
            edges = edges_of(frames[-1])
            for method, images in methods.run(case, frames, 1):
                found = find_errors(images[-1], references[-1], edges)
                rows.setdefault((case.title, method), []).append(found)
    return rows


def main(
    folder: Annotated[Path, typer.Argument(help="Scenes with stills, as stillray-evaluate's.")],
    model: Annotated[list[str] | None, typer.Option("--model", "-m", help="Repeatable.")] = None,
    peer: Annotated[list[str] | None, typer.Option(help="Repeatable; oidn-high if none.")] = None,
) -> None:
    """Print 10,000 times the mean squared error of stills, by place and by wavelength in pixels."""
    sizes = (*(f"to {wave}" for wave in WAVES), "beyond")
    table = Table("set", "method", "all", "edges", "textures", "rest", *sizes)
    for (title, method), found in _rows(folder, model or ["kpyr-5"], peer or ["oidn-high"]).items():
        parts = [(one.total, one.edges, one.textures, one.rest, *one.bands) for one in found]
        means = 1e4 * np.mean(parts, axis=0)
        table.add_row(title, method, *(f"{mean:.2f}" for mean in means))
    Console().print(table)


if __name__ == "__main__":
    program.run(main)

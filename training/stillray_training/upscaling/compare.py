"""``python -m stillray_training.upscaling.compare DATA --model runs/munet-x2/munet-x2.onnx``.

A model that doubles against denoising first and doubling by Lanczos then, on sequences whose
references have twice the size. The last frame of each is measured; its temporal metrics see the
two last ones.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from stillray.cli import program
from stillray.compare import metrics
from stillray.compare.metrics import METRICS
from stillray.errors import InputError
from stillray.frame import Frame
from stillray.io.exr.read import read_exr
from stillray.pipeline.denoiser import Denoiser
from stillray_training.blocks import frames_of
from stillray_training.evaluate.scores import write_shown
from stillray_training.examples import find_sequences
from stillray_training.peers.oidn import open_image_denoise
from stillray_training.simulate.sequence import RECORD
from stillray_training.upscaling.enlarge import enlarge

ENLARGED, TRACED = "{} + Lanczos", "{}, all pixels traced"
OIDN = "oidn-high"
MEASURED = ("psnr", "ssim", "smape", "relmse", "flip", "flicker")
SEEN = (*MEASURED, "cvvdp")  # and what eyes would make of it, which takes a second a picture
PICTURES = 2


@dataclass(frozen=True, eq=False)
class Compared:
    """The last pictures of a sequence.

    Attributes
    ----------
    noisy : (h, w, 3) float32
        The last frame, its pixels as large as they have become.
    methods
        Name of each method to its last pictures.
    references
        Of those.
    """

    noisy: np.ndarray
    methods: Mapping[str, list[np.ndarray]]
    references: list[np.ndarray]


def compared(sequence: Path, model: str, flagship: str, full: Path | None = None) -> Compared:
    """What each method makes of a sequence.

    Parameters
    ----------
    sequence
        Its frames, and references of the model's size of the last two.
    model
        What doubles.
    flagship
        Whose pictures are enlarged.
    full
        Folder of the same scenes traced at the references' size, by name: what the flagship and
        Open Image Denoise make of all pixels is there, too.

    Raises
    ------
    InputError
        Its last frames have no references of the model's size, or ``full`` is of another size.
    """
    frames = frames_of(sequence)
    paths = sorted(sequence.glob("target_*.exr")) or sorted(sequence.glob("ref_*.exr"))
    references = [read_exr(path).color for path in paths[-PICTURES:]]
    scale, methods = enlarged(frames, model, flagship)
    size = tuple(side * scale for side in frames[-1].shape)
    if len(references) < PICTURES or references[-1].shape[:2] != size:
        raise InputError(f"{sequence}: the last {PICTURES} frames must have references {size}")
    if full is not None:
        traced = frames_of(full / scene_of(sequence))
        if not traced or traced[-1].shape != size:
            raise InputError(f"full must hold {sequence.name}'s scene of {size}, got {full}")
        title, _, images = denoised(flagship, traced)
        methods[TRACED.format(title)] = images
        methods[TRACED.format(OIDN)] = _oidn(traced)
    return Compared(larger_pixels(frames[-1].color, scale), methods, references)


def enlarged(
    frames: list[Frame], model: str, flagship: str
) -> tuple[int, dict[str, list[np.ndarray]]]:
    """A model's scale, and its last pictures by its name, beside those that Lanczos enlarges.

    Parameters
    ----------
    frames
        In order.
    model
        What enlarges.
    flagship
        Whose pictures Lanczos enlarges, and Open Image Denoise's.
    """
    (name, scale, ours), (title, _, first) = denoised(model, frames), denoised(flagship, frames)
    methods = {name: ours}
    for method, images in ((title, first), (OIDN, _oidn(frames))):
        methods[ENLARGED.format(method)] = [enlarge(image, scale) for image in images]
    return scale, methods


def larger_pixels(image: np.ndarray, times: int) -> np.ndarray:
    """An image ``(h, w, 3)`` at some times its size, each pixel as it is."""
    larger: np.ndarray = np.repeat(np.repeat(image, times, 0), times, 1)
    return larger


def scene_of(sequence: Path) -> str:
    """Name of the scene that a sequence was rendered of."""
    return str(json.loads((sequence / RECORD).read_text())["scene"])


def measure(
    sequence: Path,
    model: str,
    flagship: str,
    full: Path | None = None,
    pictures: Path | None = None,
) -> dict[str, dict[str, float]]:
    """Metrics by method of the last frame of a sequence, see `compared`.

    Parameters
    ----------
    pictures
        Folder for tone-mapped PNGs of the last frame.
    """
    found = compared(sequence, model, flagship, full)
    return scores(found, SEEN, pictures, sequence.name)


def scores(
    found: Compared, names: Sequence[str], pictures: Path | None, title: str
) -> dict[str, dict[str, float]]:
    """Metrics by method.

    Parameters
    ----------
    found
        As many pictures of each method as there are references.
    names
        Of the metrics.
    pictures
        Folder for tone-mapped PNGs of the last pictures; None for none.
    title
        What their names begin with.
    """
    if pictures is not None:
        last = {method: images[-1] for method, images in found.methods.items()}
        reference = found.references[-1]
        for name, image in {"noisy": found.noisy, **last, "reference": reference}.items():
            write_shown(pictures, f"{title}-{name}", image, reference)
    return {
        method: metrics.evaluate(images, found.references, names=names)
        for method, images in found.methods.items()
    }


def denoised(model: str, frames: list[Frame]) -> tuple[str, int, list[np.ndarray]]:
    """A model's name and scale, and its last pictures."""
    with Denoiser(model, threads=1) as denoiser:
        images = [denoiser.denoise(frame) for frame in frames]
        return denoiser.model.name, denoiser.scale, images[-PICTURES:]


def _oidn(frames: list[Frame]) -> list[np.ndarray]:
    """Open Image Denoise's last pictures."""
    return [
        open_image_denoise(frame.color, frame.albedo, frame.normal, "high")
        for frame in frames[-PICTURES:]
    ]


def mean(found: list[Mapping[str, Mapping[str, float]]]) -> dict[str, dict[str, float]]:
    """Means over sequences, by method and metric."""
    return {
        method: {
            name: float(np.mean([one[method][name] for one in found])) for name in found[0][method]
        }
        for method in found[0]
    }


def main(
    data: Annotated[Path, typer.Argument(help="Folder of rendered sequences.")],
    model: Annotated[str, typer.Option(help="The model, or the path of its .onnx file.")],
    flagship: Annotated[str, typer.Option(help="Whose pictures are enlarged beside it.")] = "high",
    full: Annotated[
        Path | None, typer.Option(help="Folder of the same scenes traced at full size, by name.")
    ] = None,
    only: Annotated[str, typer.Option(help="Pattern of the sequences' names.")] = "*",
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    pictures: Annotated[
        Path | None, typer.Option(help="Folder for PNGs of the last frames.")
    ] = None,
) -> None:
    """Measure a model that enlarges beside denoising and enlarging one after the other."""
    sequences = [path for path in find_sequences(data) if path.match(only)]
    if not sequences:
        raise InputError(f"data must hold finished sequences, got {data}")
    found = mean([measure(sequence, model, flagship, full, pictures) for sequence in sequences])
    if as_json:
        print(json.dumps(found, indent=1))
        return
    tell(found, f"{len(sequences)} sequences, means")


def tell(found: Mapping[str, Mapping[str, float]], title: str) -> None:
    """Print metrics by method."""
    shown = [metric for metric in METRICS if metric.name in next(iter(found.values()))]
    table = Table("method", *(metric.title for metric in shown), title=title)
    for method, values in found.items():
        table.add_row(method, *(format(values[metric.name], metric.format) for metric in shown))
    Console(width=120).print(table)


if __name__ == "__main__":
    program.run(main)

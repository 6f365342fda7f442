"""``python -m stillray_training.upscaling.halved VALIDATION --model munet-x2``: frames of any kind.

Frames that were not rendered to be doubled, of any renderer and sample count, at half their size:
means of 2x2 pixels, which are pixels of four times the samples. A model doubles them, beside
denoising them and doubling by Lanczos then; references have the frames' own size.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import typer

from stillray.cli import program
from stillray.errors import InputError
from stillray.frame import Frame
from stillray.models.registry import for_single_frames
from stillray_training.evaluate.__main__ import find_all
from stillray_training.evaluate.cases import WITHOUT_PAST, Case, titles
from stillray_training.upscaling.compare import (
    Compared,
    enlarged,
    larger_pixels,
    mean,
    scores,
    tell,
)

MEASURED = ("psnr", "ssim", "smape", "flip", "bias")
_TIMES = 2
#: Averaged over a pixel by renderers; of depth and motion a mean is of no surface.
_AVERAGED = ("color", "albedo", "normal", "roughness", "specular_albedo", "alpha")
_PICKED = ("depth", "motion")


def halved(frame: Frame) -> Frame:
    """A frame of half the size, of four times the samples a pixel; odd rows and columns go.

    Parameters
    ----------
    frame
        ``(h, w)`` pixels, 2 or more each way.
    """
    height, width = (side // _TIMES for side in frame.shape)
    if min(height, width) < 1:
        raise InputError(f"frame must have two pixels each way, got {frame.shape}")

    def smaller(name: str, how: int) -> np.ndarray:
        whole = getattr(frame, name)[: height * _TIMES, : width * _TIMES]
        return cv2.resize(whole, (width, height), interpolation=how)

    buffers: dict[str, Any] = {
        name: smaller(name, how)
        for names, how in ((_AVERAGED, cv2.INTER_AREA), (_PICKED, cv2.INTER_NEAREST))
        for name in names
        if name in frame.given
    }
    if "motion" in buffers:
        buffers["motion"] = buffers["motion"] / _TIMES
    if frame.samples is not None:
        buffers["samples"] = float(np.nanmean(frame.samples)) * _TIMES**2
    if frame.filter_spread is not None:
        # two pixels each way lie half a pixel from their middle
        buffers["filter_spread"] = float(np.sqrt(frame.filter_spread**2 + 0.25)) / _TIMES
    return Frame(**buffers)


def measure(
    case: Case, model: str, flagship: str, pictures: Path | None = None
) -> dict[str, dict[str, float]]:
    """Metrics by method of the last frame of a case.

    Parameters
    ----------
    case
        Frames, and references of their size.
    model
        What doubles.
    flagship
        Whose pictures are enlarged; for frames without a past its model for those.
    pictures
        Folder for tone-mapped PNGs of the last frame.

    Raises
    ------
    InputError
        The model does not double.
    """
    frames, references = case.read()
    frames = [halved(frame) for frame in frames]
    height, width = (side * _TIMES for side in frames[-1].shape)
    reference = references[-1][:height, :width]
    alone = case.kind in WITHOUT_PAST
    taken = for_single_frames(flagship) if alone else flagship
    scale, methods = enlarged(frames, model, taken)
    if scale != _TIMES:
        raise InputError(f"model must double what it is given, got {next(iter(methods))}")
    last = {name: images[-1:] for name, images in methods.items()}
    found = Compared(larger_pixels(frames[-1].color, _TIMES), last, [reference])
    title = f"{case.title}-{case.name}".replace(" ", "-").replace(",", "")
    return scores(found, MEASURED, pictures, title)


def main(
    folders: Annotated[
        list[str], typer.Argument(help="FOLDER or LABEL=FOLDER of frames with references.")
    ],
    model: Annotated[str, typer.Option(help="What doubles, or the path of its .onnx file.")],
    flagship: Annotated[str, typer.Option(help="Quality whose pictures are enlarged.")] = "high",
    pictures: Annotated[Path | None, typer.Option(help="Folder for tone-mapped PNGs.")] = None,
) -> None:
    """Measure a model that doubles on frames that were not rendered for it."""
    cases = find_all(folders)
    for title in titles(cases):
        of_set = [case for case in cases if case.title == title]
        tell(mean([measure(case, model, flagship, pictures) for case in of_set]), title)


if __name__ == "__main__":
    program.run(main)

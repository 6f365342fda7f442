"""Whether the model that learns while it denoises drifts, of a camera that stands still.

``python -m stillray_training.online.still_frames VALIDATION/staircase2/ref_0005.exr \\
VALIDATION/spp/staircase2/256/frame_0005.exr``

Every frame is the reference under new noise in either half, so that what is right is known exactly,
and whatever changes after the past has filled is the model's doing.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import typer

from stillray.cli import program
from stillray.compare.metrics import evaluate
from stillray.errors import InputError
from stillray.frame import Frame
from stillray.io.exr.read import read_exr
from stillray.pipeline.denoiser import Denoiser
from stillray_training.online.evaluate import METRICS, read_reference, without_learning

_UNLIT = 0.5  # share of the pixels whose one path found no light


def shrunk(frame: Frame, shape: tuple[int, int]) -> Frame:
    """Albedo, normals and depth in another size, and motion of 0; color stays behind."""
    if frame.albedo is None or frame.normal is None or frame.depth is None:
        raise InputError("features must hold albedo, normal and depth")
    size = shape[::-1]
    albedo, normal, depth = (
        cv2.resize(np.asarray(buffer), size, interpolation=cv2.INTER_AREA)
        for buffer in (frame.albedo, frame.normal, frame.depth)
    )
    empty = np.zeros((*shape, 3), np.float32)
    motion = np.zeros((*shape, 2), np.float32)
    return Frame(color=empty, albedo=albedo, normal=normal, depth=depth, motion=motion)


def noisy(clean: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A picture as one path a pixel may see it: half of them find no light, its mean is right."""
    found = rng.standard_exponential(clean.shape[:2], np.float32) / (1 - _UNLIT)
    found[rng.random(clean.shape[:2], np.float32) < _UNLIT] = 0
    seen: np.ndarray = clean * found[..., None]
    return seen


def run(
    clean: np.ndarray, features: Frame, frames: int, *, learns: bool = True, model: str = "online"
) -> Iterator[tuple[int, dict[str, float]]]:
    """Number, from 1, and scores of those frames that are looked at: 1, 2, 4, ... and the last.

    Parameters
    ----------
    clean : (h, w, 3) float32
        What every frame is of.
    features
        Its other buffers, of the same size.
    frames
        How many.
    learns
        Whether what was learned is kept from frame to frame.
    model
        Its name.
    """
    rng = np.random.default_rng(0)
    with Denoiser(model) as denoiser:
        for number in range(1, frames + 1):
            halves: dict[str, Any] = {name: noisy(clean, rng) for name in ("color", "color_b")}
            frame = dataclasses.replace(features, **halves)
            image = denoiser.denoise(frame) if learns else without_learning(denoiser, frame)
            if number & (number - 1) == 0 or number == frames:
                found = evaluate([image], [clean], names=METRICS)
                yield number, {metric: found[metric] for metric in METRICS}


def main(
    reference: Annotated[Path, typer.Argument(help="EXR of what is right.")],
    features: Annotated[Path, typer.Argument(help="EXR of albedo, normal and depth of the same.")],
    frames: Annotated[int, typer.Option(min=1)] = 1000,
    learns: Annotated[bool, typer.Option(help="Keep what was learned.")] = True,
    shrink: Annotated[int, typer.Option(min=1, help="Pixels of the EXR to one.")] = 5,
    model: Annotated[str, typer.Option(help="One that learns as it denoises.")] = "online",
) -> None:
    """Denoise a still view for long, and print errors at frames 1, 2, 4 and so on."""
    given = read_exr(features)
    small = shrunk(given, (given.shape[0] // shrink, given.shape[1] // shrink))
    clean = read_reference(reference, small.shape)
    print(f"{'frame':>8s}" + "".join(f"{name:>10s}" for name in METRICS))
    for number, found in run(clean, small, frames, learns=learns, model=model):
        print(f"{number:8d}" + "".join(f"{found[name]:10.4f}" for name in METRICS), flush=True)


if __name__ == "__main__":
    program.run(main)

"""``python -m stillray_training.upscaling.still_frames --model munet-x2``: what many frames give.

A wall that is known at every point slides, or stays, under noisy light of one sample a pixel, and
the jitter moves over it: waves, and bars as wide as half a pixel of the frame. How near doubled
pictures come to it, frame after frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from stillray.arrays.strips import available_threads
from stillray.cli import program
from stillray.errors import InputError
from stillray.frame import Frame
from stillray.pipeline.denoiser import Denoiser

SIZE = (45, 70)  # of a frame
SCALE = 2
_POINTS = 4  # along each axis, whose mean a pixel of the picture is
_BORDER = 8  # pixels of the picture that do not count
_TOLD = (1, 2, 4, 8, 12, 16, 24, 32, 48, 64, 80, 100)  # frames


def surface(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Albedo of the wall at positions in pixels of a frame, ``(..., 3)``."""
    waves = [np.sin(0.5 * x + phase) * np.cos(0.4 * y) for phase in (0.0, 1.0, 2.0)]
    bars = (np.floor(x + 0.3 * y) % 8 == 0)[..., None]
    return np.where(bars, 0.08, 0.5 + 0.3 * np.stack(waves, -1)).astype(np.float32)


def frame(number: int, *, speed: float = 0.0, noise: float = 1.0) -> Frame:
    """The wall under light of one noisy sample a pixel.

    Parameters
    ----------
    number
        Of the frame, 0 or more.
    speed
        Pixels that the wall slides by from frame to frame.
    noise
        1: light follows an exponential distribution, as of one path; 0: it is even.
    """
    rng = np.random.default_rng([7, number])
    # spread evenly over the pixel, as renderers do (Roberts 2018, R2)
    jitter = np.modf(number * np.array([0.7548776662, 0.5698402910]))[0] - 0.5
    y, x = np.indices(SIZE) + 0.5
    albedo = surface(x + jitter[0] + speed * number, y + jitter[1])
    flat = np.ones(SIZE, np.float32)
    light = 1 + noise * (rng.exponential(1.0, (*SIZE, 1)) - 1)
    return Frame(
        color=albedo * light,
        albedo=albedo,
        normal=np.stack([0 * flat, 0 * flat, flat], -1),
        depth=3 * flat,
        motion=np.stack([speed * flat, 0 * flat], -1),
        roughness=flat,
        specular_albedo=0 * albedo,
        jitter=jitter,
    )


def wanted(number: int, speed: float = 0.0) -> np.ndarray:
    """The wall at the pixels of the picture, ``(H, W, 3)``."""
    fine = SCALE * _POINTS
    steps = [(np.arange(fine * size) + 0.5) / fine for size in SIZE]
    y, x = np.meshgrid(*steps, indexing="ij")
    points = surface(x + speed * number, y)
    height, width = (SCALE * size for size in SIZE)
    mean: np.ndarray = points.reshape(height, _POINTS, width, _POINTS, 3).mean((1, 3))
    return mean


def psnr(image: np.ndarray, reference: np.ndarray) -> float:
    """Decibels of radiance, whose peak is 1, within the border."""
    inner = (slice(_BORDER, -_BORDER), slice(_BORDER, -_BORDER))
    return float(-10 * np.log10(np.square(image[inner] - reference[inner]).mean()))


def curve(denoiser: Denoiser, frames: int, speed: float = 0.0) -> Iterator[float]:
    """PSNR of each of a number of frames, the first without a past."""
    denoiser.reset()
    for number in range(frames):
        image = denoiser.denoise(frame(number, speed=speed))
        yield psnr(image, wanted(number, speed))


def main(
    model: Annotated[
        list[str], typer.Option("--model", "-m", help="One that doubles; repeatable.")
    ],
    frames: Annotated[int, typer.Option(min=1, help="How many.")] = 100,
    speed: Annotated[float, typer.Option(help="Pixels that the wall slides by.")] = 0.0,
) -> None:
    """Print PSNR of doubled pictures, mean over the frames up to each number."""
    found: list[list[float]] = []
    for name in model:
        with Denoiser(name, threads=available_threads()) as denoiser:
            if denoiser.scale != SCALE:
                raise InputError(f"model must double pictures, got {name}")
            found.append(list(curve(denoiser, frames, speed)))
    table = Table("frames", *model, title="PSNR dB, means of frames")
    first = 0
    for last in [*(number for number in _TOLD if number < frames), frames]:
        means = (f"{np.mean(values[first:last]):.2f}" for values in found)
        table.add_row(f"{first + 1} to {last}", *means)
        first = last
    Console(width=120).print(table)


if __name__ == "__main__":
    program.run(main)

"""``python -m stillray_training.benchmark_sequence``: what files cost beside the denoiser itself.

A shot at 1280x720 is denoised from memory, from files to files with reading and writing one after
the other, and as ``stillray denoise`` does it; in turn in one process, round after round. The
share is the time of the denoiser alone over that of the whole run.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from stillray.batch.file_layout import Layout
from stillray.batch.resume import Recipe
from stillray.batch.run import Handling, run_steps
from stillray.batch.shot import plan_shot, steps_to_run
from stillray.cli import program
from stillray.families.temporal_kernels import MEMORY_FRAMES
from stillray.frame import Frame
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.read import read_exr
from stillray.io.exr.write import write_exr
from stillray.pipeline.denoiser import Denoiser

SEQUENCE = Path("tests/data/room")
_CHANNELS = {"color": "RGB", "albedo": "RGB", "normal": "XYZ", "depth": "Z", "motion": "XY"}
_FLOAT = ("depth", "motion")  # as renderers write them; the others are half


def write_shot(folder: Path, sequence: Path, frames: int, height: int, width: int) -> None:
    """A sequence tiled to a size, as ``shot.####.exr``: real noise, edges and motion."""
    sources = sorted(sequence.glob("frame_*.exr"))
    for number in range(frames):
        frame = read_exr(sources[number % len(sources)])
        rows, columns = -(-height // frame.shape[0]), -(-width // frame.shape[1])
        channels: dict[str, np.ndarray] = {}
        formats: dict[str, str] = {}
        for role, names in _CHANNELS.items():
            tiled = cv2.repeat(getattr(frame, role), rows, columns)[:height, :width]
            planes = tiled.reshape(height, width, -1)
            for index, name in enumerate(names):
                key = name if role == "color" else f"{role}.{name}"
                channels[key] = planes[..., index]
                formats[key] = "float" if role in _FLOAT else "half"
        write_channels(folder / f"shot.{number:04d}.exr", channels, formats=formats)


def benchmark(
    folder: Path, model: str, threads: int | None, rounds: int
) -> dict[str, list[tuple[float, float]]]:
    """Seconds on the clock and of all processors, of each round of each way, by its name."""
    jobs = plan_shot([str(folder / "shot.####.exr")], str(folder / "clean.####.exr"))
    frames = [read_exr(job.source) for job in jobs]
    steps = steps_to_run(jobs, [False] * len(jobs), memory=MEMORY_FRAMES)
    recipe = Recipe(model=model, model_digest="benchmark")
    how = Handling(layout=Layout(), recipe=recipe, memory=MEMORY_FRAMES)
    with Denoiser(model, threads=threads) as denoiser:

        def alone() -> None:
            denoiser.reset()
            for frame in frames:
                denoiser.denoise(frame)

        def one_after_the_other() -> None:
            denoiser.reset()
            for job in jobs:
                assert job.output is not None
                frame: Frame = read_exr(job.source)
                write_exr(job.output, denoiser.denoise(frame), like=job.source)

        def overlapped() -> None:
            run_steps(denoiser, steps, how, lambda done: None)

        ways: dict[str, Callable[[], None]] = {
            "denoiser alone": alone,
            "files, one after the other": one_after_the_other,
            "stillray denoise": overlapped,
        }
        seconds: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
        alone()  # memory and caches are warm for all
        for _ in range(rounds):
            for name, way in ways.items():
                start = time.perf_counter(), time.process_time()
                way()
                seconds[name].append(
                    (time.perf_counter() - start[0], time.process_time() - start[1])
                )
    return seconds


def main(
    sequence: Annotated[Path, typer.Argument(help="Folder with frame_*.exr.")] = SEQUENCE,
    model: Annotated[str, typer.Option(help="Quality, model name or .onnx.")] = "high",
    frames: Annotated[int, typer.Option(help="Frames of the shot.")] = 12,
    rounds: Annotated[int, typer.Option(help="Rounds, the ways in turn.")] = 3,
    height: Annotated[int, typer.Option(help="Pixels.")] = 720,
    width: Annotated[int, typer.Option(help="Pixels.")] = 1280,
    threads: Annotated[int | None, typer.Option(help="Threads of the denoiser.")] = None,
) -> None:
    """Time a shot from files to files beside the denoiser alone."""
    with tempfile.TemporaryDirectory() as folder:
        write_shot(Path(folder), sequence, frames, height, width)
        seconds = benchmark(Path(folder), model, threads, rounds)
    own = seconds["denoiser alone"]
    print("milliseconds a frame: on the clock, of all processors; what share of it the denoiser is")
    for name, each in seconds.items():
        columns = []
        for kind in (0, 1):
            share = statistics.median(a[kind] / b[kind] for a, b in zip(own, each, strict=True))
            milliseconds = 1e3 * statistics.median(round_[kind] for round_ in each) / frames
            columns.append(f"{milliseconds:8.1f} {share:4.0%}")
        print(f"{name:28} {'   '.join(columns)}")


if __name__ == "__main__":
    program.run(main)

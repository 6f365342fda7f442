"""``python -m stillray.training.benchmark``: time and memory beside Open Image Denoise.

One process, one frame, the methods in turn, round after round; medians and ratios are printed.
Every stage counts, from the renderer's buffers to the picture, with history and moving pixels.
Peak memory is that of a process of its own for each method.
"""

from __future__ import annotations

import platform
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from rich.console import Console
from rich.progress import track

from stillray.denoiser import Denoiser
from stillray.exr import read_exr
from stillray.frame import Frame
from stillray.registry import list_models
from stillray.strips import available_threads
from stillray.training.peers import OIDN_QUALITIES, open_image_denoise

SEQUENCE = Path("tests/data/room")
NOTHING = "nothing"  # the buffers alone: what memory is compared with


def load_frames(folder: Path, height: int, width: int) -> list[Frame]:
    """Two consecutive frames of a sequence, tiled to a size: real noise, edges and motion."""
    frames = []
    for path in sorted(folder.glob("frame_*.exr"))[-2:]:
        small = read_exr(path)
        rows, columns = -(-height // small.shape[0]), -(-width // small.shape[1])

        def tile(image: np.ndarray | None, rows: int = rows, columns: int = columns) -> np.ndarray:
            assert image is not None
            tiled = cv2.repeat(image, rows, columns)
            return np.ascontiguousarray(tiled[:height, :width])

        frames.append(
            Frame(
                color=tile(small.color),
                albedo=tile(small.albedo),
                normal=tile(small.normal),
                depth=tile(small.depth),
                motion=tile(small.motion),
            )
        )
    return frames


def method(name: str, frames: list[Frame]) -> Callable[[int], object]:
    """A model or a peer by name, as a function of the round; only that one is loaded."""
    if name == NOTHING:
        return lambda turn: None
    if name.startswith("OIDN "):

        def peer(turn: int) -> object:
            frame = frames[turn % 2]
            return open_image_denoise(frame.color, frame.albedo, frame.normal, name.split()[1])

        return peer
    denoiser = Denoiser(name)
    return lambda turn: denoiser.denoise(frames[turn % 2])


def measure(frames: list[Frame], rounds: int) -> tuple[dict[str, list[float]], list[dict]]:
    """Milliseconds of each method in each round, and stage timings of our models."""
    names = [info.name for info in list_models()] + [f"OIDN {q}" for q in OIDN_QUALITIES]
    made = {name: method(name, frames) for name in names}
    for run in made.values():  # the first two calls allocate and choose kernels
        run(0)
        run(1)
    times: dict[str, list[float]] = {name: [] for name in made}
    for turn in track(range(rounds), "rounds", console=Console(stderr=True)):
        for name, run in made.items():
            start = time.perf_counter()
            run(turn)
            times[name].append(1e3 * (time.perf_counter() - start))
    stages = []
    for info in list_models():
        with Denoiser(info.name) as denoiser:
            collected: dict[str, list[float]] = {}
            for turn in range(rounds + 2):
                denoiser.denoise(frames[turn % 2])
                for stage, value in denoiser.last_timings.items():
                    collected.setdefault(stage, []).append(value)
        medians = {
            stage: float(np.median(values[2:] or values)) for stage, values in collected.items()
        }
        stages.append({"model": info.name, **medians})
    return times, stages


def peak_memory(method: str, height: int, width: int, sequence: Path) -> float:
    """Peak resident MiB of a process that runs one method three times."""
    result = subprocess.run(
        [
            sys.executable,
            "-m",
            "stillray.training.benchmark",
            "--only",
            method,
            "--height",
            str(height),
            "--width",
            str(width),
            "--sequence",
            str(sequence),
        ],
        check=True,
        capture_output=True,
        text=True,
    )
    return float(result.stdout)


def main(
    height: Annotated[int, typer.Option(min=1)] = 720,
    width: Annotated[int, typer.Option(min=1)] = 1280,
    rounds: Annotated[int, typer.Option(min=1)] = 11,
    sequence: Annotated[Path, typer.Option(help="Folder with frames to tile.")] = SEQUENCE,
    only: Annotated[str, typer.Option(hidden=True)] = "",
) -> None:
    """Print times, ratios, stages and memory."""
    frames = load_frames(sequence, height, width)
    if only:
        run = method(only, frames)
        for turn in range(3):
            run(turn)
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
        return
    times, stages = measure(frames, rounds)
    medians = {name: float(np.median(values)) for name, values in times.items()}
    print(
        f"{platform.processor() or platform.machine()}, {available_threads()} threads, "
        f"onnxruntime {version('onnxruntime')}, opencv {cv2.__version__}, "
        f"pyoidn {version('pyoidn')}; {width}x{height}, {rounds} rounds in turn\n"
    )
    base = peak_memory(NOTHING, height, width, sequence)
    print("| method | median ms | min | max | / OIDN fast | / OIDN high | peak MiB | net MiB |")
    print("|---|---|---|---|---|---|---|---|")
    for name, median in medians.items():
        peak = peak_memory(name, height, width, sequence)
        print(
            f"| {name} | {median:.0f} | {min(times[name]):.0f} | {max(times[name]):.0f} "
            f"| {median / medians['OIDN fast']:.2f} | {median / medians['OIDN high']:.2f} "
            f"| {peak:.0f} | {peak - base:.0f} |"
        )
    names = list(stages[0])[1:]
    print("\n| stage, median ms | " + " | ".join(names) + " |")
    print("|---" * (len(names) + 1) + "|")
    for row in stages:
        print(f"| {row['model']} | " + " | ".join(f"{row[name]:.1f}" for name in names) + " |")


if __name__ == "__main__":
    typer.run(main)

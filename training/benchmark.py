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
from typing import Annotated, Any

import cv2
import numpy as np
import typer
from rich.console import Console
from rich.progress import track

from stillray.cli import program
from stillray.denoiser import Denoiser
from stillray.exr import atomic_path, read_exr
from stillray.frame import Frame
from stillray.registry import find_model, list_models
from stillray.strips import available_threads
from stillray.training.operations import multiply_adds
from stillray.training.peers import OIDN_QUALITIES, open_image_denoise

SEQUENCE = Path("tests/data/room")
NOTHING = "nothing"  # the buffers alone: what memory is compared with
# Float32 planes that each stage reads or writes, each once: its work if memory were all that
# counts. What an earlier stage of the same pass has brought to the cache counts there only.
STAGE_PLANES = {
    "repair": 3 + 3 + 3 + 1 + 2,  # all buffers
    "demodulate": 3 + 1,  # divisor and luminance
    "expose": 1 + 1,
    "guides": 4 + 4,
    "warp": 4 + 2 + 4 + 4,  # guides for rough blocks; motion, history and its guides
    "accumulate": 3 + 3 + 2 + 4 + 1 + 2,
    "encode": 4 + 1 + 3 + 3 + 1 + 12,
    "reconstruct": 12 + 4 + 3,
    "modulate": 3,
}


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


def measure(
    frames: list[Frame], rounds: int
) -> tuple[dict[str, list[float]], list[dict[str, Any]]]:
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
            rows = []
            for turn in range(rounds + 2):
                denoiser.denoise(frames[turn % 2])
                rows.append(denoiser.last_timings)
        warm = rows[2:]
        medians = {stage: float(np.median([row[stage] for row in warm])) for stage in warm[0]}
        stages.append({"model": info.name, **medians})
    return times, stages


def peak_resident() -> float:
    """Peak resident MiB of this process."""
    status = Path("/proc/self/status")
    if status.is_file():  # getrusage counts the parent's memory at the fork too
        return float(status.read_text().split("VmHWM:")[1].split()[0]) / 1024
    unit = 1 << 20 if sys.platform == "darwin" else 1 << 10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


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


def machine_peaks() -> tuple[float, float]:
    """GFLOP/s of a float32 matrix product and GB/s of a copy, each the best of a few."""
    matrix = np.ones((2048, 2048), np.float32)
    big = np.ones(1 << 26, np.float32)  # 256 MiB: beyond every cache
    target = np.empty_like(big)
    products, copies = [], []
    for _ in range(5):
        start = time.perf_counter()
        matrix @ matrix
        products.append(time.perf_counter() - start)
        start = time.perf_counter()
        np.copyto(target, big)
        copies.append(time.perf_counter() - start)
    return 2e-9 * 2048**3 / min(products), 2e-9 * big.nbytes / min(copies)


def write_report(
    times: dict[str, list[float]],
    stages: list[dict[str, Any]],
    peaks: dict[str, float],
    size: tuple[int, int],
) -> str:
    """The figures as Markdown."""
    medians = {name: float(np.median(values)) for name, values in times.items()}

    def paired(name: str, peer: str) -> float:
        # round by round: a machine whose speed drifts slows both
        return float(np.median(np.array(times[name]) / np.array(times[peer])))

    height, width = size
    rounds = len(next(iter(times.values())))
    gflops, bandwidth = machine_peaks()
    lines = [
        "# Time and memory",
        "",
        "Written by `python -m stillray.training.benchmark --report docs/performance.md`.",
        "",
        f"{platform.machine()}, {available_threads()} threads, NumPy's matrix product "
        f"{gflops:.0f} GFLOP/s, copy {bandwidth:.0f} GB/s; onnxruntime {version('onnxruntime')}, "
        f"opencv {cv2.__version__}, pyoidn {version('pyoidn')}. {width}x{height}, "
        f"{rounds} rounds, the methods in turn in one process, all stages included; ratios are "
        "medians over the rounds. Peak memory is that of a process with this method alone; net is "
        "over the buffers and the libraries.",
        "",
        "| method | median ms | min | max | / OIDN fast | / OIDN high | peak MiB | net MiB |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, median in medians.items():
        lines.append(
            f"| {name} | {median:.0f} | {min(times[name]):.0f} | {max(times[name]):.0f} "
            f"| {paired(name, 'OIDN fast'):.2f} | {paired(name, 'OIDN high'):.2f} "
            f"| {peaks[name]:.0f} | {peaks[name] - peaks[NOTHING]:.0f} |"
        )
    # the most stages first, so that each stage comes in its place
    longest = sorted(stages, key=len, reverse=True)
    names = [name for name in dict.fromkeys(n for row in longest for n in row) if name != "model"]
    lines += ["", "Median milliseconds of each stage:", ""]
    lines += ["| model | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    for row in stages:
        cells = (f"{row[name]:.1f}" if name in row else "" for name in names)
        lines.append(f"| {row['model']} | " + " | ".join(cells) + " |")
    floors = [
        4e-6 * STAGE_PLANES[n] * height * width / bandwidth if n in STAGE_PLANES else 0.0
        for n in names
    ]
    lines.append(
        "| memory alone, six kernels | "
        + " | ".join(f"{f:.1f}" if f else "" for f in floors)
        + " |"
    )
    lines += [
        "",
        "Memory alone: what a stage has to read and write, over the copy's rate; "
        f"{sum(floors):.0f} ms in all. Stages that run in one pass share its time.",
    ]
    lines += ["", "The network against its floor, operations over the matrix product's rate:", ""]
    for row in stages:
        # two operations for every multiply and add
        work = 2e-9 * multiply_adds(find_model(row["model"]).path, height, width)
        floor = 1e3 * work / gflops
        lines.append(
            f"- {row['model']}: {work:.1f} GFLOP, floor {floor:.0f} ms, "
            f"taken {row['network']:.0f} ms ({row['network'] / floor:.2f} times the floor)"
        )
    return "\n".join(lines) + "\n"


def main(
    height: Annotated[int, typer.Option(min=1)] = 720,
    width: Annotated[int, typer.Option(min=1)] = 1280,
    rounds: Annotated[int, typer.Option(min=1)] = 11,
    sequence: Annotated[Path, typer.Option(help="Folder with frames to tile.")] = SEQUENCE,
    report: Annotated[Path | None, typer.Option(help="Write the figures as Markdown.")] = None,
    only: Annotated[str, typer.Option(hidden=True)] = "",
) -> None:
    """Print times, ratios, stages and memory."""
    frames = load_frames(sequence, height, width)
    if only:
        run = method(only, frames)
        for turn in range(3):
            run(turn)
        print(peak_resident())
        return
    times, stages = measure(frames, rounds)
    peaks = {name: peak_memory(name, height, width, sequence) for name in (NOTHING, *times)}
    text = write_report(times, stages, peaks, (height, width))
    print(text)
    if report is not None:
        with atomic_path(report) as temporary:
            temporary.write_text(text)


if __name__ == "__main__":
    program.run(main)

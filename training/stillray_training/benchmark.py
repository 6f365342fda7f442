"""``python -m stillray_training.benchmark``: time and memory beside Open Image Denoise.

One process, the same frames, the methods in turn, round after round; medians and ratios are
printed. Every stage counts, from the renderer's buffers to the picture, with history and moving
pixels. Peak memory is that of a process of its own for each method.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from stillray.arrays.strips import available_threads
from stillray.cli import program
from stillray.cli.output import status
from stillray.io.atomic import atomic_path
from stillray.model_spec.decoders import MOST_ENSEMBLE
from stillray.models.registry import DEFAULT_MODEL, find_model, list_models
from stillray.profiling.clip import MADE_UP, Clip, open_clip
from stillray.profiling.cost import stage_costs
from stillray.profiling.machine import describe, measure_peak_rates, output_of, peak_resident
from stillray.profiling.measure import (
    ORDER,
    TOTAL,
    Memory,
    Run,
    Setting,
    Summary,
    measure,
    measure_memory,
)
from stillray.profiling.plot import draw_curves, draw_profile
from stillray.profiling.results import Result
from stillray.profiling.scaling import SIZES, Curve, in_words, scaling_curves
from stillray_training.peers import PEERS, PeerDenoiser

SEQUENCE = "tests/data/room/frame_####.exr"
NOTHING = "nothing"  # the buffers alone: what memory is compared with
OIDN = tuple(peer.label for peer in PEERS if peer.module == "pyoidn")


def measure_in_turn(
    settings: Sequence[Setting], clip: Clip, seconds: float
) -> tuple[list[Run], dict[str, list[float]]]:
    """Our models stage by stage, and milliseconds of each peer in the same rounds."""
    peers: dict[str, list[float]] = {name: [] for name in OIDN}
    for name in peers:
        run_peer(name, clip, 0)  # the first call allocates

    def peers_in_turn(turn: int) -> None:
        for name, times in peers.items():
            start = time.perf_counter()
            run_peer(name, clip, turn)
            times.append(1e3 * (time.perf_counter() - start))

    return measure(settings, clip, seconds, files=False, progress=peers_in_turn), peers


def run_peer(name: str, clip: Clip, turn: int) -> None:
    """Open Image Denoise, or nothing, on one of the frames."""
    if name != NOTHING:
        frame, _ = clip.frame(turn)
        opened_peer(name).denoise(frame)


@cache
def opened_peer(label: str) -> PeerDenoiser:
    """A peer, opened once."""
    (peer,) = (peer for peer in PEERS if peer.label == label)
    return peer.make()


def peer_memory(names: Sequence[str], setting: Setting, source: str) -> dict[str, Memory]:
    """Peak memory of a process that runs one peer three times, and its net."""
    size = ["--height", str(setting.height), "--width", str(setting.width), "--sequence", source]
    peaks = {
        name: float(
            output_of([sys.executable, "-m", "stillray_training.benchmark", "--only", name, *size])
        )
        for name in (NOTHING, *names)
    }
    return {name: Memory(peak=peaks[name], net=peaks[name] - peaks[NOTHING]) for name in names}


def ratio(times: Sequence[float], peer: Sequence[float]) -> float:
    """Median of the ratios round by round: a machine whose speed drifts slows both."""
    return float(np.median(np.array(times) / np.array(peer)))


def methods_table(
    runs: Sequence[Run], peers: dict[str, list[float]], memory: dict[str, Memory]
) -> list[str]:
    """A row a method."""
    times = {run.label: [row[TOTAL] for row in run.warm] for run in runs} | peers
    lines = [
        "| method | median ms | p95 | p99 | worst | / OIDN fast | / OIDN high "
        "| peak MiB | net MiB |",
        "|---" * 9 + "|",
    ]
    for name, values in times.items():
        found = Summary.of(values)
        lines.append(
            f"| {name} | {found.median:.0f} | {found.p95:.0f} | {found.p99:.0f} "
            f"| {found.worst:.0f} | {ratio(values, times['OIDN fast']):.2f} "
            f"| {ratio(values, times['OIDN high']):.2f} "
            f"| {memory[name].peak:.0f} | {memory[name].net:.0f} |"
        )
    return lines


def stages_table(results: Sequence[Result]) -> list[str]:
    """A row a stage: of each model the median, the roofline, and the ratio of both."""
    stages = [result.run.stages() for result in results]
    names = [name for name in (*ORDER, TOTAL) if any(name in found for found in stages)]
    headings = [f"{result.run.label} ms | roofline | ratio" for result in results]
    lines = ["| stage | " + " | ".join(headings) + " |", "|---" * (3 * len(results) + 1) + "|"]
    for name in names:
        cells = []
        for result, found in zip(results, stages, strict=True):
            if name not in found:
                cells += ["", "", ""]
                continue
            median, roofline = found[name].median, result.roofline(name)
            cells += [f"{median:.1f}"]
            cells += [f"{roofline:.1f}", f"{median / roofline:.1f}"] if roofline else ["", ""]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return lines


def curve_lines(curve: Curve) -> list[str]:
    """A curve in words and as a table."""
    rows = [
        [curve.name, *curve.labels],
        ["ms", *(f"{cost:.1f}" for cost in curve.milliseconds)],
    ]
    if curve.memory:
        rows.append(["net MiB", *(f"{net:.0f}" for net in curve.memory)])
    head, *rest = ("| " + " | ".join(row) + " |" for row in rows)
    return [f"{in_words(curve)}.", "", head, "|---" * len(rows[0]) + "|", *rest, ""]


def write_report(
    results: Sequence[Result],
    peers: dict[str, list[float]],
    memory: dict[str, Memory],
    curves: Sequence[Curve],
    pictures: Sequence[str] = (),
) -> str:
    """The figures as Markdown; pictures are linked by name."""
    setting, peaks = results[0].run.setting, results[0].peaks
    machine = describe() | {"pyoidn": version("pyoidn")}
    lines = [
        "# Time and memory",
        "",
        "Written by `make benchmark`: `python -m stillray_training.benchmark "
        "--report docs/performance.md`.",
        "",
        ", ".join(f"{name} {value}" for name, value in machine.items())
        + f"; matrix product {peaks.operations / 1e9:.0f} GFLOP/s, "
        f"copy {peaks.bandwidth / 1e9:.1f} GB/s. "
        f"{setting.width}x{setting.height}, {len(results[0].run.warm)} rounds, "
        "the methods in turn in one process, all stages but the files included; ratios are medians "
        "over the rounds. Peak memory is that of a process with this method alone; net is over the "
        "buffers and the libraries.",
        "",
        *methods_table([result.run for result in results], peers, memory),
        "",
        "## Stages",
        "",
        "Median milliseconds of each stage. The roofline is the slower of its operations at the "
        "matrix product's rate and its bytes at the copy's, each plane moved once: what an earlier "
        "stage of the same pass has brought to the cache counts there only. Stages that run in one "
        "pass share its time; `rest` is what no stage accounts for.",
        "",
        *stages_table(results),
        "",
        "## Scaling",
        "",
        "Exponents are least squares of the logarithms. Made-up frames "
        "(`stillray profile --scaling`); kernels and their sizes with random logits.",
        "",
        *(line for curve in curves for line in curve_lines(curve)),
        *(f"![{name}]({name})" for name in pictures),
    ]
    return "\n".join(lines).rstrip() + "\n"


def main(
    height: Annotated[int, typer.Option(min=1)] = 720,
    width: Annotated[int, typer.Option(min=1)] = 1280,
    seconds: Annotated[float, typer.Option(min=0, help="Of the rounds.")] = 90,
    sequence: Annotated[
        str, typer.Option(help=f"Frames to tile; {MADE_UP}: made up, with second halves.")
    ] = SEQUENCE,
    model: Annotated[
        list[str] | None, typer.Option(help="Ours; repeatable; all listed unless given.")
    ] = None,
    ensemble: Annotated[
        int,
        typer.Option(
            min=1,
            max=MOST_ENSEMBLE,
            help="Time each model as an ensemble of so many too, if it can.",
        ),
    ] = 1,
    scaling: Annotated[bool, typer.Option(help="Measure the scaling curves.")] = True,
    report: Annotated[
        Path | None, typer.Option(help="Write the figures as Markdown, pictures beside it.")
    ] = None,
    only: Annotated[str, typer.Option(hidden=True)] = "",
) -> None:
    """Print times, ratios, stages, memory and how they grow."""
    source = None if sequence == MADE_UP else sequence
    clip = open_clip(source, (height, width))
    if only:
        for turn in range(3):
            run_peer(only, clip, turn)
        print(peak_resident())
        return
    threads = available_threads()
    settings = [
        Setting(model=name, height=height, width=width, threads=threads)
        for name in model or [info.name for info in list_models()]
    ]
    if ensemble > 1:
        settings += [
            dataclasses.replace(each, ensemble=ensemble)
            for each in settings
            if ensemble <= find_model(each.model).spec.decoder.most_ensemble
        ]
    elif not model:
        settings.append(dataclasses.replace(settings[0], model=DEFAULT_MODEL, ensemble=2))
    with status("rounds") as progress:
        peaks = measure_peak_rates(threads)
        runs, peers = measure_in_turn(settings, clip, seconds)
        progress("memory")
        ours = measure_memory(settings, source)
        memory = dict(zip((run.label for run in runs), ours, strict=True))
        memory |= peer_memory(list(peers), settings[0], sequence)
        curves = (
            scaling_curves("wskp-3s", threads=threads, sizes=SIZES, progress=progress)
            if scaling
            else []
        )
    results = [
        Result(
            run=run,
            work=stage_costs(run.info, clip.frames[0], run.precision),
            peaks=peaks,
            memory=found,
        )
        for run, found in zip(runs, ours, strict=True)
    ]
    pictures = []
    if report is not None:
        draw_profile(results, report.with_name(f"{report.stem}-stages.png"))
        pictures.append(f"{report.stem}-stages.png")
        if curves:
            draw_curves(curves, report.with_name(f"{report.stem}-scaling.png"))
            pictures.append(f"{report.stem}-scaling.png")
    text = write_report(results, peers, memory, curves, pictures)
    print(text)
    if report is not None:
        with atomic_path(report) as temporary:
            temporary.write_text(text)


if __name__ == "__main__":
    program.run(main)

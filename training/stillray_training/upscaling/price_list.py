"""``python -m stillray_training.upscaling.price_list HALF --full FULL --scenes SCENES --model M``.

What a picture costs from its first traced ray on: seconds of rendering and of denoising beside its
quality, for half the pixels doubled and for all of them traced. Renders and methods take turns in
one process, on all processors; the renderer is Mitsuba, as the simulator drives it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from stillray.arrays.strips import available_threads
from stillray.cli import program
from stillray.compare import metrics
from stillray.errors import InputError
from stillray.frame import Frame
from stillray.io.exr.read import read_exr
from stillray.pipeline.denoiser import Denoiser
from stillray_training.blocks import frames_of
from stillray_training.examples import find_sequences
from stillray_training.peers import OIDN_QUALITIES, open_image_denoise
from stillray_training.simulate.buffers import Moment, render_noisy
from stillray_training.simulate.paths import recorded_path
from stillray_training.simulate.sequence import RECORD, SequenceOptions, plan_scene
from stillray_training.simulate.stage import Stage
from stillray_training.simulate.variant import load_mitsuba
from stillray_training.upscaling.enlarge import enlarge
from stillray_training.upscaling.time_in_turn import times_in_turn

_MEASURED = ("psnr", "ssim", "smape", "flip", "flicker")
_PICTURES = 2


@dataclass(frozen=True, kw_only=True)
class Way:
    """From rays to a picture.

    Attributes
    ----------
    label
        As tables show it.
    frames
        What was traced.
    denoise
        A frame to the picture of the references' size; the past is its own.
    """

    label: str
    frames: Sequence[Frame]
    denoise: Callable[[Frame], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Price:
    """Of one picture: medians in milliseconds, and metrics by name."""

    render: float
    denoise: float
    scores: dict[str, float]


def prices(
    ways: Sequence[Way], renders: Sequence[float], references: Sequence[np.ndarray]
) -> dict[str, Price]:
    """Quality and time of every way, which take turns.

    Parameters
    ----------
    ways
        With one picture size and as many frames each.
    renders
        Milliseconds that a frame of each takes to trace.
    references
        Of the last frames.
    """
    pictures: dict[str, list[np.ndarray]] = {way.label: [] for way in ways}

    def run(way: Way, turn: int) -> None:
        pictures[way.label].append(way.denoise(way.frames[turn]))

    methods = {way.label: partial(run, way) for way in ways}
    times = times_in_turn(methods, 0.0, rounds=len(ways[0].frames) - 1)
    return {
        way.label: Price(
            render=render,
            denoise=float(np.median(times[way.label])),
            scores=metrics.evaluate(
                pictures[way.label][-len(references) :], references, names=_MEASURED
            ),
        )
        for way, render in zip(ways, renders, strict=True)
    }


def ways_of(
    stack: ExitStack,
    traced: dict[str, Sequence[Frame]],
    models: tuple[str, str],
    quick: str,
) -> list[tuple[str, Way]]:
    """Every way, with the name of what it traces.

    Parameters
    ----------
    stack
        Closes the denoisers.
    traced
        Frames by name: ``half``, ``full``, and further ones of half the size, by their samples.
    models
        What doubles, and the flagship.
    quick
        The model that is given all pixels beside the flagship.
    """
    threads = available_threads()

    def ours(model: str) -> Denoiser:
        return stack.enter_context(Denoiser(model, threads=threads))

    found: list[tuple[str, Way]] = []
    for name in traced:
        if name != "full":
            doubling = ours(models[0])
            samples = "" if name == "half" else f" {name}"
            label = f"half{samples}: {doubling.model.name}"
            found.append((name, Way(label=label, frames=traced[name], denoise=doubling.denoise)))
    plain = ours(models[1])
    scale = doubling.scale
    twice = Way(
        label=f"half: {plain.model.name} + Lanczos",
        frames=traced["half"],
        denoise=lambda frame: enlarge(plain.denoise(frame), scale),
    )
    peer = Way(
        label="half: OIDN high + Lanczos",
        frames=traced["half"],
        denoise=lambda frame: enlarge(_oidn(frame, "high"), scale),
    )
    found += [("half", twice), ("half", peer)]
    for model in (models[1], quick):
        denoiser = ours(model)
        label = f"full: {denoiser.model.name}"
        found.append(("full", Way(label=label, frames=traced["full"], denoise=denoiser.denoise)))
    for quality in OIDN_QUALITIES:
        way = Way(
            label=f"full: OIDN {quality}",
            frames=traced["full"],
            denoise=lambda frame, quality=quality: _oidn(frame, quality),  # type: ignore[misc]
        )
        found.append(("full", way))
    return found


def _oidn(frame: Frame, quality: str) -> np.ndarray:
    return open_image_denoise(frame.color, frame.albedo, frame.normal, quality)


def render_times(mi: Any, scene: Path, records: Sequence[SequenceOptions]) -> list[float]:
    """Median milliseconds to trace a frame of each of some sequences of a scene, in turn."""
    stages = []
    for options in records:
        plan = plan_scene(mi, str(scene), options.seed, None, options)
        path = recorded_path(Path(str(options.cameras)), options.frames)
        stages.append((Stage(mi, plan, options.height, options.width), path, options))

    def run(index: int, turn: int) -> None:
        stage, path, options = stages[index]
        moment = Moment(frame=1, path=path, focus=1.0, jitter=np.zeros(2))
        render_noisy(stage, moment, spp=options.spp, seed=turn)

    # the first round compiles
    times = times_in_turn({str(i): partial(run, i) for i in range(len(stages))}, 0.0)
    return [float(np.median(taken)) for taken in times.values()]


def read_record(sequence: Path) -> tuple[str, SequenceOptions]:
    """The scene's name and the options of a rendered sequence."""
    record = json.loads((sequence / RECORD).read_text())
    given: dict[str, Any] = {
        name: tuple(v) if isinstance(v, list) else v for name, v in record["options"].items()
    }
    options = SequenceOptions(**given)
    if options.cameras is None:
        raise InputError(f"{sequence}: must have recorded cameras (--cameras)")
    return record["scene"], options


def main(
    half: Annotated[Path, typer.Argument(help="Folder of rendered sequences to double.")],
    full: Annotated[Path, typer.Option(help="Folder of the same scenes at full size, by name.")],
    scenes: Annotated[Path, typer.Option(help="Folder with SCENE/scene.xml of each.")],
    model: Annotated[str, typer.Option(help="What doubles: a model, or its .onnx file.")],
    more: Annotated[
        Path | None, typer.Option(help="Folder as the first, of more samples a pixel.")
    ] = None,
    flagship: Annotated[str, typer.Option(help="A model that is given all pixels.")] = "high",
    quick: Annotated[str, typer.Option(help="Another one.")] = "fast",
) -> None:
    """Print what pictures cost and how good they are: means over scenes."""
    mi, _ = load_mitsuba(None)
    found: list[dict[str, Price]] = []
    for sequence in find_sequences(half):
        name, options = read_record(sequence)
        traced: dict[str, Sequence[Frame]] = {
            "half": frames_of(sequence),
            "full": frames_of(full / name),
        }
        records = {"half": options}
        if more is not None:
            _, sampled = read_record(more / sequence.name)
            records[f"{sampled.spp} spp"] = sampled
            traced[f"{sampled.spp} spp"] = frames_of(more / sequence.name)
        height, width = traced["full"][0].shape
        # all pixels are traced without what models that double read beside
        records["full"] = replace(options, height=height, width=width, guides=(), reference_scale=1)
        renders = dict(
            zip(
                records,
                render_times(mi, scenes / name / "scene.xml", [*records.values()]),
                strict=True,
            )
        )
        references = [read_exr(path).color for path in sorted(sequence.glob("ref_*.exr"))]
        with ExitStack() as stack:
            ways = ways_of(stack, traced, (model, flagship), quick)
            costs = [renders[kind] for kind, _ in ways]
            found.append(prices([way for _, way in ways], costs, references[-_PICTURES:]))
    Console(width=120).print(table(found))


def table(found: Sequence[dict[str, Price]]) -> Table:
    """A row a way: means over scenes."""
    rows = Table(title=f"{len(found)} scenes, {available_threads()} threads, means")
    for title in ("traced: denoised by", "render ms", "denoise ms", "sum ms", *_MEASURED):
        rows.add_column(title)
    for label in found[0]:
        of = [scene[label] for scene in found]
        render, denoise = (
            np.mean([getattr(p, part) for p in of]) for part in ("render", "denoise")
        )
        scores = [np.mean([price.scores[name] for price in of]) for name in _MEASURED]
        rows.add_row(
            label, f"{render:.0f}", f"{denoise:.0f}", f"{render + denoise:.0f}",
            *(f"{score:.4g}" for score in scores),
        )  # fmt: skip
    return rows


if __name__ == "__main__":
    program.run(main)

"""``stillray-evaluate VALIDATION``: quality on sequences with references.

Every method sees the same raw frames in order; the last frame of each sequence counts, and for
flicker and FovVideoVDP the frames with references just before it. Open Image Denoise, which
remembers nothing, is also fed the accumulated frame, as our kernels are.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import takewhile
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import track

from stillray.arrays.strips import Strips
from stillray.cli import program
from stillray.compare import metrics
from stillray.compare.display import display_exposure, tone_map, write_png
from stillray.compare.metrics import METRICS, Metric
from stillray.errors import InputError
from stillray.frame import Frame
from stillray.io.exr.read_write import atomic_path, read_exr
from stillray.models.registry import find_model, list_models
from stillray.pipeline.denoiser import Denoiser
from stillray.stages.prepare import History, prepare
from stillray_training.peers import PEERS, Peer, PeerDenoiser, find_peer

# what models are to be better than, in every metric
_TO_BEAT = (
    ("high", "OIDN high"), ("balanced", "OIDN fast"), ("fast", "SVGF"), ("fast", "BMFR"),
    ("nbg-2x3", "SVGF"), ("nbg-2x3", "BMFR"),
)  # fmt: skip
_DISTANCES = """Beside the peers that they are to beat: differences, and ratios (x) where less is
better; bold is worse. Of flicker, `high` is to have half of OIDN high's, x 0.5. Times
are in [performance.md](performance.md).
"""
Scores = dict[str, dict[str, dict[str, float]]]  # method -> scene -> metric -> value
_REPORT_HEAD = """# Quality on validation

Written by `stillray-evaluate VALIDATION --report docs/results.md`. Last frame of
each sequence, 640x360, 1 sample per pixel; six frames are accumulated where a method remembers
them, and "one frame" says where not. PSNR, SSIM and FLIP after exposure to a median of 0.2 and a
power of 1 / 2.2, SMAPE and relative MSE of exposed radiance. No model was trained on these scenes;
the weights of accumulation, the albedo floor of the specs, what is looked at in mirrors and how the
past is interpolated were chosen on them, and the training of the kpyr models was watched on them,
so read these figures as validation, not as a test. SVGF
(Schied et al. 2017) and BMFR (Koskela et al. 2019) are our own implementations in
`training/stillray_training/peers`, with published parameters, which remember frames too; both end
with temporal antialiasing (TAA) of the picture, so SVGF is there without it as well; of ours, the
kpyr models resolve with their last output, and all but kpyr-5 accumulate the albedo. OIDN is Open
Image Denoise with albedo and normal, fed the raw frame, or the frame as accumulated for our
kernels. Flicker is the mean absolute error of the tone-mapped difference between the last two
frames. FovVideoVDP (Mantiuk et al. 2021) sees the same two frames, at 30 frames a second after a
still of the first, on a 24-inch Full HD monitor of 200 cd/m², 38 pixels a degree, not foveated.
References have noise of their own: "fed the references" is about what a perfect picture would
score.

"""


def find_scenes(folder: Path) -> list[Path]:
    """Folders of sequences that have a reference for their last frame."""
    found = sorted(
        path
        for path in folder.iterdir()
        if path.is_dir() and list(path.glob("frame_*.exr")) and list(path.glob("ref_*.exr"))
    )
    if not found:
        raise InputError(f"folder must hold sequences with references, got {folder}")
    return found


def run_stream(
    stream: PeerDenoiser, frames: Sequence[Frame], count: int
) -> tuple[list[np.ndarray], list[float]]:
    """Denoise frames in order: the last images, and the milliseconds of every frame."""
    images, milliseconds = [], []
    for frame in frames:
        start = time.perf_counter()
        images.append(stream.denoise(frame))
        milliseconds.append(1e3 * (time.perf_counter() - start))
    return images[-count:], milliseconds


def evaluate_scene(
    scene: Path, models: Mapping[str, str], *, peers: Sequence[str], pictures: Path | None = None
) -> Iterator[tuple[str, dict[str, float]]]:
    """Method name and metrics, one after the other, of a sequence's last referenced frames.

    Parameters
    ----------
    scene
        Folder of the sequence.
    models
        Label to model, as `stillray.Denoiser` takes it.
    peers
        Names of peers to run too, see `stillray_training.peers.PEERS`.
    pictures
        Folder for tone-mapped PNGs.
    """
    paths, references = last_referenced(scene)
    frames = [read_exr(path) for path in paths]
    count = len(references)
    if pictures:
        _picture(pictures, scene.name, "reference", references[-1], references[-1])

    def scored(name: str, images: list[np.ndarray]) -> tuple[str, dict[str, float]]:
        if pictures:
            _picture(pictures, scene.name, name, images[-1], references[-1])
        return name, metrics.evaluate(images[-count:], references)

    yield scored("noisy", [frame.color for frame in frames])
    accumulated = accumulate_frames(frames, next(iter(models.values())))
    yield scored("accumulated", accumulated)
    for label, model in models.items():
        with Denoiser(model) as denoiser:
            yield scored(label, run_stream(denoiser, frames, count)[0])
        with Denoiser(model, temporal=False) as denoiser:
            yield scored(f"{label}, one frame", run_stream(denoiser, frames[-count:], count)[0])
    chosen = [find_peer(name) for name in peers]
    for peer in chosen:
        seen = frames if peer.remembers else frames[-count:]
        yield scored(peer.label, run_stream(peer.make(), seen, count)[0])

    def fed(peer: Peer, colors: Sequence[np.ndarray]) -> list[np.ndarray]:
        ready = [
            dataclasses.replace(frame, color=color)
            for frame, color in zip(frames[-count:], colors, strict=True)
        ]
        return run_stream(peer.make(), ready, count)[0]

    forgetful = [peer for peer in chosen if not peer.remembers]
    for peer in forgetful:
        yield scored(f"{peer.label}, accumulated", fed(peer, accumulated[-count:]))
    for peer in forgetful[:1]:
        yield scored(f"{peer.label}, fed the references", fed(peer, references))


def last_referenced(scene: Path) -> tuple[list[Path], list[np.ndarray]]:
    """Frames up to the last with a reference, and the references of the last run of frames."""
    with_reference = {path.name.replace("ref", "frame"): path for path in scene.glob("ref_*.exr")}
    last = max(with_reference)
    if not (scene / last).is_file():
        raise InputError(f"{scene}: a reference must have its frame, got none for {last}")
    paths = [path for path in sorted(scene.glob("frame_*.exr")) if path.name <= last]
    run = list(takewhile(lambda path: path.name in with_reference, reversed(paths)))
    return paths, [read_exr(with_reference[path.name]).color for path in reversed(run)]


def accumulate_frames(frames: list[Frame], model: str) -> list[np.ndarray]:
    """Radiance of each frame as a model's kernels get it: accumulated, not filtered."""
    spec = find_model(model).spec
    history: History | None = None
    images = []
    for frame in frames:
        prepared = prepare(frame, spec, history, Strips(1), {})
        history = prepared.history
        mean = history.mean[..., :3]
        images.append(mean if prepared.divisor is None else mean * prepared.divisor)
    return images


def evaluate_folder(
    folder: Path,
    models: Mapping[str, str],
    *,
    peers: Sequence[str],
    pictures: Path | None = None,
    progress: Callable[[list[Path]], Iterable[Path]] = iter,
) -> Scores:
    """Scores of every method on every scene of a folder."""
    scores: Scores = {}
    scenes = find_scenes(folder)
    for scene in progress(scenes):
        for method, values in evaluate_scene(scene, models, peers=peers, pictures=pictures):
            scores.setdefault(method, {})[scene.name] = values
    return scores


def mean_scores(scores: Scores) -> dict[str, dict[str, float]]:
    """Mean over scenes, a row a method."""
    means = {}
    for method, scenes in scores.items():
        rows = list(scenes.values())
        names = [metric.name for metric in METRICS if all(metric.name in row for row in rows)]
        means[method] = {name: float(np.mean([row[name] for row in rows])) for name in names}
    return means


def markdown(scores: Scores) -> str:
    """A table of the means, then one a scene."""
    scenes = sorted(next(iter(scores.values())))
    parts = [_table("mean", mean_scores(scores))]
    for scene in scenes:
        parts.append(_table(scene, {method: rows[scene] for method, rows in scores.items()}))
    return "\n".join(parts)


def distances(scores: Scores) -> str:
    """How far models are from the peers that they are to beat, where both were run; or nothing."""
    means = mean_scores(scores)
    rows = []
    for quality, peer in _TO_BEAT:
        model = find_model(quality).name
        if model not in means or peer not in means:
            continue
        cells = []
        for metric in METRICS:
            mine, other = means[model].get(metric.name), means[peer].get(metric.name)
            if mine is None or other is None:
                cells.append("")
                continue
            apart = f"{mine - other:+.3g}" if metric.higher_is_better else f"x {mine / other:.3g}"
            worse = mine < other if metric.higher_is_better else mine > other
            cells.append(f"**{apart}**" if worse else apart)
        called = model if quality == model else f'{model} ("{quality}")'
        rows.append(f"| {called} against {peer} | " + " | ".join(cells) + " |")
    if not rows:
        return ""
    return "\n".join([_DISTANCES, *_heading("mean", METRICS), *rows]) + "\n\n"


def trained(models: Mapping[str, str]) -> str:
    """A line that says for how many steps each model was trained, each recipe in its turn."""
    shown = []
    for label, model in models.items():
        part = find_model(model).provenance
        counts: list[str] = []
        while part:
            counts.insert(0, str(part.get("steps", "")))
            part = part.get("started_from", {})
        if any(counts):
            shown.append(f"{label} {' + '.join(counts)}")
    return f"Training steps: {', '.join(shown)}.\n\n"


def _heading(title: str, shown: Sequence[Metric]) -> list[str]:
    return [
        f"| {title} | " + " | ".join(metric.title for metric in shown) + " |",
        "|---" * (len(shown) + 1) + "|",
    ]


def _table(title: str, rows: dict[str, dict[str, float]]) -> str:
    measured = [metric for metric in METRICS if any(metric.name in row for row in rows.values())]
    lines = _heading(title, measured)
    for method, row in rows.items():
        values = (format(row[m.name], m.format) if m.name in row else "" for m in measured)
        lines.append(f"| {method} | " + " | ".join(values) + " |")
    return "\n".join(lines) + "\n"


def choose_peers(names: Sequence[str] | None) -> list[str]:
    """The peers to run: those named, or all that are installed.

    Raises
    ------
    InputError
        A named peer does not exist or cannot run here.
    """
    if names is not None:
        return [find_peer(name).name for name in dict.fromkeys(names)]
    return [peer.name for peer in PEERS if peer.is_installed]


def left_out(peers: Sequence[str] | None) -> str:
    """One line that says which metrics, and peers if none were named, lack their package."""
    absent = [(metric.name, metric.package) for metric in METRICS if not metric.is_installed]
    if peers is None:
        absent += [(peer.name, peer.package) for peer in PEERS if not peer.is_installed]
    if not absent:
        return ""
    packages = " ".join(dict.fromkeys(package for _, package in absent))
    names = ", ".join(name for name, _ in absent)
    return f"left out for want of a package: {names} (pip install {packages})"


def _picture(
    folder: Path, scene: str, method: str, image: np.ndarray, reference: np.ndarray
) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    name = f"{scene}-{method.replace(', ', '-').replace(' ', '-')}.png"
    write_png(folder / name, tone_map(image, display_exposure(reference)))


def main(
    folder: Annotated[Path, typer.Argument(help="Folder of sequences with references.")],
    model: Annotated[
        list[str] | None,
        typer.Option(help="Model, .onnx, or LABEL=one of them; repeatable; default: all."),
    ] = None,
    peer: Annotated[
        list[str] | None,
        typer.Option(help=f"{', '.join(p.name for p in PEERS)}; repeatable; default: installed."),
    ] = None,
    peers: Annotated[bool, typer.Option(help="Run peers at all.")] = True,
    out: Annotated[Path | None, typer.Option(help="Write scores as JSON.")] = None,
    report: Annotated[Path | None, typer.Option(help="Write the tables as Markdown.")] = None,
    pictures: Annotated[Path | None, typer.Option(help="Folder for tone-mapped PNGs.")] = None,
) -> None:
    """Print metrics per scene and their means."""
    given = model or [info.name for info in list_models()]
    models = {text.split("=")[0]: text.split("=")[-1] for text in given}
    for name in models.values():
        find_model(name)
    named = peer if peers else []
    chosen = choose_peers(named)
    if line := left_out(named):
        print(line, file=sys.stderr)
    scores = evaluate_folder(
        folder,
        models,
        peers=chosen,
        pictures=pictures,
        progress=lambda scenes: track(scenes, "scenes", console=Console(stderr=True)),
    )
    print(markdown(scores))
    if report:
        with atomic_path(report) as temporary:
            temporary.write_text(
                _REPORT_HEAD + trained(models) + distances(scores) + markdown(scores)
            )
    if out:
        with atomic_path(out) as temporary:
            temporary.write_text(json.dumps(scores, indent=1))


if __name__ == "__main__":
    program.run(main)

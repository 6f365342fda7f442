"""``python -m stillray.training.evaluate VALIDATION``: quality on sequences with references.

Every method sees the same frames in order; the last frame of each sequence counts. Open Image
Denoise is fed the raw frame, as its users do, and the accumulated one, as ours are.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import track

from stillray.cli import program
from stillray.denoiser import Denoiser
from stillray.display import display_exposure, tone_map, write_png
from stillray.errors import InputError
from stillray.exr import atomic_path, read_exr
from stillray.frame import Frame
from stillray.prepare import History, prepare
from stillray.registry import find_model, list_models
from stillray.strips import Strips
from stillray.training import metrics
from stillray.training.peers import OIDN_QUALITIES, open_image_denoise

Scores = dict[str, dict[str, dict[str, float]]]  # method -> scene -> metric -> value
_REPORT_HEAD = """# Quality on validation

Written by `python -m stillray.training.evaluate VALIDATION --report docs/results.md`. Last frame of
each sequence, 640x360, 1 sample per pixel; six frames are accumulated where a method remembers
them, and "one frame" says where not. PSNR, SSIM and FLIP after exposure to a median of 0.2 and a
power of 1 / 2.2, SMAPE and relative MSE of exposed radiance. No model was trained on these scenes;
the outlier ratio and the albedo floor of the specs were chosen on them, so read these figures as
validation, not as a test. OIDN is Open Image Denoise with albedo and normal, fed the raw frame, or
the frame as accumulated for our kernels. Flicker is the mean absolute error of the tone-mapped
difference between the last two frames.

"""
METRICS = ("psnr", "ssim", "smape", "relmse", "flip", "flicker")


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


def evaluate_scene(
    scene: Path, models: Mapping[str, str], *, peers: bool, pictures: Path | None = None
) -> Iterator[tuple[str, dict[str, float]]]:
    """Method name and metrics, one after the other, of a sequence's last referenced frame.

    Parameters
    ----------
    scene
        Folder of the sequence.
    models
        Label to model, as `stillray.Denoiser` takes it.
    peers
        Run Open Image Denoise too.
    pictures
        Folder for tone-mapped PNGs.
    """
    reference_paths = sorted(scene.glob("ref_*.exr"))
    last = scene / reference_paths[-1].name.replace("ref", "frame")
    paths = [path for path in sorted(scene.glob("frame_*.exr")) if path <= last]
    frames = [read_exr(path) for path in paths]
    reference = read_exr(reference_paths[-1]).color
    before = [scene / path.name.replace("frame", "ref") for path in paths[-2:-1]]
    reference_before = read_exr(before[0]).color if set(before) & set(reference_paths) else None
    if pictures:
        _picture(pictures, scene.name, "reference", reference, reference)

    def scored(name: str, images: list[np.ndarray]) -> tuple[str, dict[str, float]]:
        if pictures:
            _picture(pictures, scene.name, name, images[-1], reference)
        values = metrics.evaluate(images[-1], reference)
        if reference_before is not None:
            values["flicker"] = metrics.flicker(images[-2], images[-1], reference_before, reference)
        return name, values

    yield scored("noisy", [frame.color for frame in frames])
    accumulated = accumulate_frames(frames, next(iter(models.values())))
    yield scored("accumulated", accumulated)
    for label, model in models.items():
        with Denoiser(model) as denoiser:
            yield scored(label, [denoiser.denoise(frame) for frame in frames])
        with Denoiser(model, temporal=False) as denoiser:
            images = [denoiser.denoise(frame) for frame in frames[-2:]]
            yield scored(f"{label}, one frame", images)
    if peers:
        for source, colors in (
            ("", [frame.color for frame in frames[-2:]]),
            (", accumulated", accumulated[-2:]),
        ):
            for quality in OIDN_QUALITIES:
                images = [
                    open_image_denoise(color, frame.albedo, frame.normal, quality)
                    for color, frame in zip(colors, frames[-2:], strict=True)
                ]
                yield scored(f"OIDN {quality}{source}", images)


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
    peers: bool,
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
        names = [name for name in METRICS if all(name in row for row in rows)]
        means[method] = {name: float(np.mean([row[name] for row in rows])) for name in names}
    return means


def markdown(scores: Scores) -> str:
    """A table of the means, then one a scene."""
    scenes = sorted(next(iter(scores.values())))
    parts = [_table("mean", mean_scores(scores))]
    for scene in scenes:
        parts.append(_table(scene, {method: rows[scene] for method, rows in scores.items()}))
    return "\n".join(parts)


def _table(title: str, rows: dict[str, dict[str, float]]) -> str:
    lines = [
        f"| {title} | PSNR dB ↑ | SSIM ↑ | SMAPE ↓ | relative MSE ↓ | FLIP ↓ | flicker ↓ |",
        "|---|---|---|---|---|---|---|",
    ]
    for method, row in rows.items():
        lines.append(
            f"| {method} | {row['psnr']:.2f} | {row['ssim']:.3f} | {row['smape']:.4f} "
            f"| {row['relmse']:.3g} | {row['flip']:.3f} "
            + (f"| {row['flicker']:.4f} |" if "flicker" in row else "| |")
        )
    return "\n".join(lines) + "\n"


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
    peers: Annotated[bool, typer.Option(help="Run Open Image Denoise beside.")] = True,
    out: Annotated[Path | None, typer.Option(help="Write scores as JSON.")] = None,
    report: Annotated[Path | None, typer.Option(help="Write the tables as Markdown.")] = None,
    pictures: Annotated[Path | None, typer.Option(help="Folder for tone-mapped PNGs.")] = None,
) -> None:
    """Print metrics per scene and their means."""
    given = model or [info.name for info in list_models()]
    models = {text.split("=")[0]: text.split("=")[-1] for text in given}
    for name in models.values():
        find_model(name)
    scores = evaluate_folder(
        folder,
        models,
        peers=peers,
        pictures=pictures,
        progress=lambda scenes: track(scenes, "scenes", console=Console(stderr=True)),
    )
    print(markdown(scores))
    if report:
        with atomic_path(report) as temporary:
            temporary.write_text(_REPORT_HEAD + markdown(scores))
    if out:
        with atomic_path(out) as temporary:
            temporary.write_text(json.dumps(scores, indent=1))


if __name__ == "__main__":
    program.run(main)

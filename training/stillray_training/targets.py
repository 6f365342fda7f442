"""``python -m stillray_training.targets data/train``: targets of less noise than the references.

References of a few hundred samples a pixel are noisier than what a network gives, which then
learns from their noise. Open Image Denoise, given them and features that it denoised first, leaves
a tenth of it. It helps only where the noise of frames is like people's: with heavier tails a
network learns to put back light that robust accumulation takes away (docs/decisions.md).

Still, of few samples it leaves much: of 96 to 128 a pixel of Cycles' scenes the targets are at 36
to 40 dB, and what a network gives of 64 is at 35.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import track

from stillray.cli import program
from stillray.compare.display import display_exposure, tone_map
from stillray.errors import InputError
from stillray.frame import Frame
from stillray.io.exr.read import read_exr
from stillray.pixel_filter import filter_spread
from stillray_training.blocks import mean_frame, read_blocks
from stillray_training.peers.oidn import PrefilteredOpenImageDenoise
from stillray_training.simulate.sequence import RECORD, is_complete, write


def read_target(sequence: Path) -> tuple[np.ndarray, float]:
    """What the last frame of a sequence is to become, ``(h, w, 3)``, and its samples a pixel.

    The target if there is one, else the reference.

    Raises
    ------
    InputError
        There is none.
    """
    paths = sorted(sequence.glob("target_*.exr")) or sorted(sequence.glob("ref_*.exr"))
    if not paths:
        raise InputError(f"{sequence}: must hold a reference, ref_0007.exr for frame_0007.exr")
    return read_exr(paths[-1]).color, float(_record(sequence)["options"]["spp"])


def read_albedo_target(sequence: Path) -> np.ndarray | None:
    """The albedo of the last frame's target, ``(h, w, 3)``, or of its reference; None where
    neither has one."""
    for kind in ("target", "ref"):
        paths = sorted(sequence.glob(f"{kind}_*.exr"))
        albedo = read_exr(paths[-1]).albedo if paths else None
        if albedo is not None:
            return np.clip(albedo, 0, 1)
    return None


def read_filter(sequence: Path) -> float | None:
    """Standard deviation of the pixel filter that a sequence was rendered with, in pixels.

    None where its record does not say. What stillray's simulator renders has a box, unless its
    samples fill a part of their pixels alone.
    """
    record = _record(sequence)
    simulated = "integrator" in record and record["options"].get("spread", 1.0) == 1
    told = record.get("filter_spread", filter_spread("box") if simulated else None)
    return None if told is None else float(told)


def read_samples(sequence: Path) -> float | None:
    """Samples a pixel of the frames of a sequence; None where its record does not say."""
    told = _record(sequence).get("options", {}).get("spp")
    return None if told is None else float(told)


def make_target(sequence: Path) -> float:
    """Write the target of a sequence; its brightness over the reference's, minus 1, tone-mapped."""
    reference_path = sorted(sequence.glob("ref_*.exr"))[-1]
    reference = read_exr(reference_path).color
    frame = read_exr(sequence / reference_path.name.replace("ref", "frame"))
    spp = _record(sequence)["options"]["spp"]
    features = mean_frame(read_blocks(sequence, frame, spp))
    path = sequence / reference_path.name.replace("ref", "target")
    return _write_target(path, replace(features, color=reference))


def make_targets(sequence: Path) -> float:
    """Write targets of a sequence whose references have features of their own: all of them.

    Returns
    -------
    float
        Mean brightness of the targets over the references', minus 1, tone-mapped.
    """
    biases = []
    for path in sorted(sequence.glob("ref_*.exr")):
        target = path.with_name(path.name.replace("ref", "target"))
        biases.append(_write_target(target, read_exr(path)))
    return float(np.mean(biases))


def _write_target(path: Path, reference: Frame) -> float:
    """Brightness of what a reference becomes over its own, minus 1, tone-mapped."""
    # features that are taken for clean as they are leave their own noise in the picture
    network = PrefilteredOpenImageDenoise("high")
    clean = network.prefiltered(reference)
    layers = {"color": network.denoise(clean)}
    if clean.albedo is not None:
        layers["albedo"] = np.clip(clean.albedo, 0, 1)
    write(path, layers)
    exposure = display_exposure(reference.color)
    ours, theirs = (
        float(np.mean(tone_map(image, exposure))) for image in (layers["color"], reference.color)
    )
    return ours / max(theirs, 1e-6) - 1


def has_own_features(sequence: Path) -> bool:
    """Whether references come with albedo and normal, see ``--reference-features``."""
    return bool(_record(sequence)["options"].get("reference_features", 0))


def _record(sequence: Path) -> dict[str, Any]:
    record: dict[str, Any] = json.loads((sequence / RECORD).read_text())
    return record


def main(folder: Annotated[Path, typer.Argument(help="A folder of rendered sequences.")]) -> None:
    """Make the targets that are missing in a folder of sequences."""
    todo = [
        path
        for path in sorted(folder.iterdir())
        if path.is_dir() and is_complete(path) and not list(path.glob("target_*.exr"))
    ]
    bias = [
        (make_targets if has_own_features(path) else make_target)(path)
        for path in track(todo, "targets", console=Console(stderr=True))
    ]
    if bias:
        print(
            f"{len(bias)} targets; brightness against the references: mean {np.mean(bias):+.4f}, "
            f"from {np.min(bias):+.4f} to {np.max(bias):+.4f}"
        )


if __name__ == "__main__":
    program.run(main)

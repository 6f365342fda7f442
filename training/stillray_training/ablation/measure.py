"""Quality of the trained variants on sequences with references, and the time of their graphs."""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import json
import os
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from torch import nn

from stillray.compare import metrics
from stillray.compare.display import display_exposure, tone_map, write_png
from stillray.frame import Frame
from stillray.io.atomic import atomic_path
from stillray.io.exr.read import read_exr
from stillray.models.registry import read_model
from stillray.pipeline.denoiser import Denoiser
from stillray.profiling.machine import describe
from stillray.profiling.synthetic import swing
from stillray_training.ablation.study import folder_of, is_finished
from stillray_training.ablation.variants import ONE_FRAME, STILL_SAMPLES, Variant
from stillray_training.checkpoint import CHECKPOINT, load_network
from stillray_training.evaluate.cases import find_cases, find_scenes, last_referenced
from stillray_training.evaluate.methods import run_stream
from stillray_training.loss_log import LOG
from stillray_training.networks.fuse import fuse
from stillray_training.onnx_graph import network_graph
from stillray_training.peers.kernel_predictor import KernelPredictor

METRICS = ("psnr", "ssim", "smape", "flip")
SCORES = "scores.json"
TIMES = "times.json"
_LAST_LOSSES = 10  # rows of the log: 200 steps
PARTS = ("network", "reconstruct")


def export(variant: Variant, network: nn.Module, path: Path) -> None:
    """Write a variant's network as the runtime takes it; the network is not changed.

    The file is for `open_stream` alone: the runtime would take a peer's for a model of ours.
    """
    path.write_bytes(network_graph(fuse(network), variant.spec, {}).SerializeToString())


def open_stream(variant: Variant, path: Path, *, temporal: bool = True) -> Denoiser:
    """A variant as a user would run it: through ONNX Runtime and the runtime's stages."""
    if variant.predicts:
        # whose network gives more than the specification says
        return KernelPredictor(read_model(path), temporal=temporal)
    return Denoiser(path, temporal=temporal)


def score_all(
    variants: Sequence[Variant], out: Path, validation: Path, pictures: Path | None = None
) -> None:
    """Score every finished variant whose weights were not scored yet; see `scores_of`.

    Parameters
    ----------
    variants, out
        The study and its folder.
    validation
        Folder of sequences with references.
    pictures
        Folder for tone-mapped PNGs, of the first seed's.
    """
    for variant in variants:
        if not is_finished(variant, out):
            continue
        folder = folder_of(variant, out)
        checkpoint = hashlib.sha256((folder / CHECKPOINT).read_bytes()).hexdigest()
        path = folder / SCORES
        if path.is_file() and json.loads(path.read_text())["checkpoint"] == checkpoint:
            continue
        network, _ = load_network(variant.spec, folder / CHECKPOINT, variant.family)
        found: dict[str, Any] = {"checkpoint": checkpoint, "loss": _last_loss(folder / LOG)}
        with TemporaryDirectory() as temporary_folder:
            file = Path(temporary_folder) / "network.onnx"
            export(variant, network, file)
            shown = pictures if variant.seed == 1 else None
            with open_stream(variant, file, temporal=not variant.stills) as stream:
                scored = score_stills if variant.stills else score
                found["scenes"] = scored(stream, validation, shown)
            if variant.name in ONE_FRAME:
                with open_stream(variant, file, temporal=False) as stream:
                    found["one frame"] = score(stream, validation, shown)
        with atomic_path(path) as temporary:
            temporary.write_text(json.dumps(found, indent=1))


def _last_loss(log: Path) -> float:
    """Mean loss of the last steps of a training."""
    with log.open(newline="") as file:
        return float(np.mean([float(row["loss"]) for row in csv.DictReader(file)][-_LAST_LOSSES:]))


def score(
    stream: Denoiser, validation: Path, pictures: Path | None = None
) -> dict[str, dict[str, float]]:
    """Scene to metric to value, of the last frame that has a reference."""
    scenes = {}
    for scene in find_scenes(validation):
        paths, references = last_referenced(scene)
        frames = [read_exr(path) for path in (paths if stream.temporal else paths[-1:])]
        how = "" if stream.temporal else "one frame"
        picture = _picture(pictures, scene.name, stream.model.name, how)
        scenes[scene.name] = _score_last(stream, frames, references[-1], picture)
    return scenes


def score_stills(
    stream: Denoiser, validation: Path, pictures: Path | None = None
) -> dict[str, dict[str, float]]:
    """Scene to metric to value, of single frames of `STILL_SAMPLES` samples a pixel."""
    scenes = {}
    for case in find_cases(validation, kinds=("stills",), counts=(STILL_SAMPLES,)):
        frames, references = case.read()
        picture = _picture(pictures, case.name, stream.model.name)
        scenes[case.name] = _score_last(stream, frames, references[-1], picture)
    return scenes


def _picture(folder: Path | None, *parts: str) -> Path | None:
    """Where a picture goes, if pictures are wanted."""
    if folder is None:
        return None
    folder.mkdir(parents=True, exist_ok=True)
    name = "-".join(part.replace(" ", "-").replace(",", "") for part in parts if part)
    return folder / f"{name}.png"


def _score_last(
    stream: Denoiser, frames: list[Frame], reference: np.ndarray, picture: Path | None
) -> dict[str, float]:
    stream.reset()
    (image,), _ = run_stream(stream, frames, 1)
    if picture is not None:
        write_png(picture, tone_map(image, display_exposure(reference)))
    return metrics.evaluate([image], [reference], names=METRICS)


def time_all(variants: Sequence[Variant], out: Path, size: tuple[int, int], rounds: int) -> None:
    """Time network and reconstruction of variants, in turn in one process; writes `TIMES`.

    The graphs have random weights: time does not depend on them, and nothing has to be trained.

    Parameters
    ----------
    variants
        What to time.
    out
        Folder of the study.
    size
        Height and width of a made-up frame, pixels.
    rounds
        How often each is timed, each time after once that does not count.
    """
    frame = dataclasses.replace(swing(*size)[0], motion=None)
    taken: dict[str, dict[str, list[float]]] = {}
    with TemporaryDirectory() as folder:
        for index, variant in enumerate(variants):
            torch.manual_seed(variant.spec.training.seed)
            network = variant.family.network(variant.spec)
            export(variant, network, Path(folder) / f"{index}.onnx")
            taken[variant.name] = {part: [] for part in PARTS}
        for _ in range(rounds):
            for index, variant in enumerate(variants):
                # one at a time: kernels of 169 weights a pixel take 2 GB
                with open_stream(variant, Path(folder) / f"{index}.onnx", temporal=False) as stream:
                    stream.denoise(frame)  # takes the memory
                    stream.denoise(frame)
                    for part in PARTS:
                        taken[variant.name][part].append(stream.last_timings[part])
    found = {
        "size": size,
        "rounds": rounds,
        "machine": describe(),
        "load": os.getloadavg()[0],
        "milliseconds": taken,
    }
    out.mkdir(parents=True, exist_ok=True)
    with atomic_path(out / TIMES) as temporary:
        temporary.write_text(json.dumps(found, indent=1))

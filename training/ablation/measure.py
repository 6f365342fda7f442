"""Quality of the trained variants on sequences with references, and the time of their graphs."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
from torch import nn

from stillray.compare import metrics
from stillray.denoiser import Denoiser
from stillray.display import display_exposure, tone_map, write_png
from stillray.export.fuse import fuse
from stillray.export.to_onnx import network_graph
from stillray.exr import atomic_path, read_exr
from stillray.profiling.machine import describe
from stillray.profiling.synthetic import swing
from stillray.training.ablation.study import folder_of, is_finished
from stillray.training.ablation.variants import ONE_FRAME, Variant
from stillray.training.evaluate import find_scenes, last_referenced, run_stream
from stillray.training.peers.kernel_predictor import KernelPredictor
from stillray.training.train import CHECKPOINT, load_network

METRICS = ("psnr", "ssim", "smape", "flip")
SCORES = "scores.json"
TIMES = "times.json"
PARTS = ("network", "reconstruct")


@contextmanager
def denoiser(
    variant: Variant, network: nn.Module, *, threads: int | None = None, temporal: bool = True
) -> Iterator[Denoiser]:
    """A variant as a user would run it: exported, through ONNX Runtime and the runtime's stages.

    Parameters
    ----------
    variant, network
        What to run; the network is not changed.
    threads, temporal
        As `stillray.Denoiser` takes them.
    """
    kind = KernelPredictor if variant.predicts else Denoiser
    # not kept: the runtime would take a peer's file for a model of ours
    with TemporaryDirectory() as folder:
        path = Path(folder) / "network.onnx"
        path.write_bytes(network_graph(fuse(network), variant.spec, {}).SerializeToString())
        with kind(path, threads=threads, temporal=temporal) as stream:
            yield stream


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
        Folder for tone-mapped PNGs.
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
        found: dict[str, Any] = {"checkpoint": checkpoint}
        with denoiser(variant, network) as stream:
            found["scenes"] = score(stream, validation, pictures)
            if variant.name in ONE_FRAME:
                stream.temporal = False
                found["one frame"] = score(stream, validation, pictures)
        with atomic_path(path) as temporary:
            temporary.write_text(json.dumps(found, indent=1))


def score(
    stream: Denoiser, validation: Path, pictures: Path | None = None
) -> dict[str, dict[str, float]]:
    """Scene to metric to value, of the last frame that has a reference."""
    scenes = {}
    for scene in find_scenes(validation):
        paths, references = last_referenced(scene)
        frames = [read_exr(path) for path in (paths if stream.temporal else paths[-1:])]
        stream.reset()
        (image,), _ = run_stream(stream, frames, 1)
        scenes[scene.name] = metrics.evaluate([image], references[-1:], names=METRICS)
        if pictures is not None:
            pictures.mkdir(parents=True, exist_ok=True)
            parts = [scene.name, stream.model.name, "" if stream.temporal else "one frame"]
            name = "-".join(part.replace(" ", "-") for part in parts if part)
            exposure = display_exposure(references[-1])
            write_png(pictures / f"{name}.png", tone_map(image, exposure))
    return scenes


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
        How often each is timed, after once that does not count.
    """
    frame = dataclasses.replace(swing(*size)[0], motion=None)
    taken: dict[str, dict[str, list[float]]] = {}
    with ExitStack() as open_ones:
        streams = {}
        for variant in variants:
            torch.manual_seed(variant.spec.training.seed)
            network = variant.family.network(variant.spec)
            streams[variant.name] = open_ones.enter_context(
                denoiser(variant, network, temporal=False)
            )
            taken[variant.name] = {part: [] for part in PARTS}
        for turn in range(rounds + 1):
            for name, stream in streams.items():
                stream.denoise(frame)
                if turn:
                    for part in PARTS:
                        taken[name][part].append(stream.last_timings[part])
    found = {"size": size, "rounds": rounds, "machine": describe(), "milliseconds": taken}
    out.mkdir(parents=True, exist_ok=True)
    with atomic_path(out / TIMES) as temporary:
        temporary.write_text(json.dumps(found, indent=1))

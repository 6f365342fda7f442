"""Weights that the model which learns while it denoises may begin with, learned on other scenes.

``python -m stillray_training.online.warm DATA --out runs/online-warm``

DATA has sequences of two halves with references (``halves.toml``). They go through the model, which
remembers what its filter was given; its network is then taught by the references, as other models
are, and so in turn, since the last picture is one of its own.

differs: Choi et al. 2024 begin with random weights, so that no data set is needed.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

import numpy as np
import torch
import typer
from rich.console import Console
from rich.progress import track
from safetensors.torch import save_file
from torch import Tensor

from stillray.arrays.strips import Strips
from stillray.cli import program
from stillray.compare.display import display_exposure
from stillray.errors import InputError
from stillray.families.contract import State
from stillray.families.cross_bilateral import EDGE_SHARE, Estimates
from stillray.families.online import THINNED, OnlineModel
from stillray.families.online_learning import Learned
from stillray.families.registry import FAMILIES
from stillray.io.atomic import atomic_path
from stillray.io.exr.read import read_exr
from stillray.model_spec import ModelSpec, load
from stillray.model_spec.network_weights import Shapes, network_weights
from stillray.pipeline.denoiser import Denoiser
from stillray_training.blocks import frame_paths
from stillray_training.decoders.cross_bilateral import cross_bilateral
from stillray_training.loss_log import LOG, log_loss
from stillray_training.losses import displayed, smape
from stillray_training.networks.filter_parameters import filter_parameters, split, start
from stillray_training.provenance import record_data
from stillray_training.run import sequences_in

WEIGHTS = "weights.safetensors"
_CROP = 96  # pixels
_BATCH = 4
_SMAPE_EPSILON = 0.01
_LEAST = 1e-6  # of what is filtered, below which no factor can be told
_RATE_LEFT = 0.02  # share of the rate at the end


@dataclasses.dataclass(frozen=True, eq=False)
class Taught:
    """A frame to learn from, at the filter.

    Attributes
    ----------
    features : (15, h, w) float32
        Pilots of both halves, albedo, normals, the last picture.
    valid : (1, h, w) float32
        1 where there is a last picture.
    edges : (1, h, w) float32
        1 where the frame's share is bounded.
    factor : (3, h, w) float32
        What the filter's result is multiplied by, to be exposed radiance.
    wanted : (3, h, w) float32
        The reference, exposed.
    """

    features: np.ndarray
    valid: np.ndarray
    edges: np.ndarray
    factor: np.ndarray
    wanted: np.ndarray


class _Watched(OnlineModel):
    """The model, which keeps what its filter was given, and what it gave."""

    def __init__(self, spec: ModelSpec, seen: list[tuple[Estimates, np.ndarray]]) -> None:
        super().__init__(spec)
        self._seen = seen

    def filter(self, estimates: Estimates, theta: np.ndarray, strips: Strips) -> np.ndarray:
        """As the model's."""
        result = super().filter(estimates, theta, strips)
        # all of it lies in memory that the next frame writes to
        parts = {name: part for name, part in vars(estimates).items() if part is not None}
        given = Estimates(**{name: part.copy() for name, part in parts.items()})
        self._seen.append((given, result.copy()))
        return result


def _watched(model: str, seen: list[tuple[Estimates, np.ndarray]]) -> Denoiser:
    class Watched(Denoiser):
        families = MappingProxyType(
            {**FAMILIES, "cross-regression": lambda spec: _Watched(spec, seen)}
        )

    return Watched(model, threads=1)


def lessons_of(sequence: Path, weights: np.ndarray, model: str = "online") -> Iterator[Taught]:
    """What frames of a sequence teach a model that has some weights.

    Parameters
    ----------
    sequence
        Folder of ``frame_0000.exr`` and so on, of two halves; those with a target or a reference
        teach.
    weights : (n,) float32
        The network's.
    model
        Whose rules hold.

    Raises
    ------
    InputError
        No frame has a reference.
    """
    found, watched = False, list[tuple[Estimates, np.ndarray]]()
    with _watched(model, watched) as denoiser:
        for path in frame_paths(sequence):
            frame = read_exr(path)
            before = denoiser.state or State(shape=frame.shape, temporal=None)
            # what it has learned by itself is not kept
            denoiser.state = dataclasses.replace(before, learned=Learned.begin(weights))
            image = denoiser.denoise(frame)
            seen, filtered = watched.pop()
            wanted = _wanted(path)
            if wanted is None:
                continue
            found = True
            exposure = np.float32(display_exposure(wanted))
            planes = np.ascontiguousarray(image.transpose(2, 0, 1)) * exposure
            known = filtered > _LEAST
            assert seen.edges is not None
            yield Taught(
                features=np.concatenate([*seen.values, *seen.guides, seen.past]),
                valid=seen.valid[None],
                edges=seen.edges[None].astype(np.float32),
                factor=np.divide(planes, filtered, out=np.zeros_like(planes), where=known),
                wanted=wanted.transpose(2, 0, 1) * exposure,
            )
    if not found:
        raise InputError(f"{sequence}: must hold references of its frames, ref_0000.exr and so on")


def _wanted(frame: Path) -> np.ndarray | None:
    for kind in ("target", "ref"):
        path = frame.with_name(frame.name.replace("frame", kind))
        if path.is_file():
            return read_exr(path).color
    return None


def picture_loss(weights: Tensor, lesson: dict[str, Tensor], layout: Shapes) -> Tensor:
    """How far a crop's picture is from its reference: SMAPE, and the error as displayed."""
    planes = lesson["features"]
    theta = filter_parameters(split(weights, layout), planes[None])[0]
    filtered, totals = cross_bilateral(
        planes[:6], planes[6:12], torch.ones_like(planes[:1]), theta, thinned=THINNED
    )
    now = (filtered * totals[:, None]).sum(0) / totals.sum(0)
    kept = torch.maximum(torch.sigmoid(-theta[5:]), (1 - EDGE_SHARE) * lesson["edges"])
    share = 1 - lesson["valid"] * kept
    picture = planes[12:15] + share * (now - planes[12:15])
    image, wanted = (picture * lesson["factor"])[None], lesson["wanted"][None]
    error = (displayed(image) - displayed(wanted)).abs().mean()
    return smape(image, wanted, _SMAPE_EPSILON).mean() + error


def teach(
    weights: Tensor,
    lessons: Sequence[Taught],
    layout: Shapes,
    *,
    steps: int,
    rate: float,
    seed: int,
) -> tuple[Tensor, float]:
    """Adam on crops of frames, with a cosine decay: the weights, and the last half's mean loss.

    Parameters
    ----------
    weights : (n,)
        To begin with.
    lessons
        Frames to draw from.
    layout
        Names and shapes of the weights.
    steps, rate, seed
        Of the training.
    """
    rng = np.random.default_rng(seed)
    learned = weights.clone().requires_grad_(True)
    optimiser = torch.optim.Adam([learned], lr=rate)
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps, rate * _RATE_LEFT)
    losses = []
    for _ in range(steps):
        optimiser.zero_grad()
        for _ in range(_BATCH):
            crop = _crop(lessons[int(rng.integers(len(lessons)))], rng)
            loss = picture_loss(learned, crop, layout) / _BATCH
            loss.backward()
            losses.append(_BATCH * float(loss.detach()))
        optimiser.step()
        decay.step()
    return learned.detach(), float(np.mean(losses[len(losses) // 2 :]))


def _crop(lesson: Taught, rng: np.random.Generator) -> dict[str, Tensor]:
    height, width = lesson.valid.shape[1:]
    sizes = [min(size, _CROP) // 4 * 4 for size in (height, width)]
    top, left = (
        int(rng.integers(size - part + 1))
        for size, part in zip((height, width), sizes, strict=True)
    )
    at = (..., slice(top, top + sizes[0]), slice(left, left + sizes[1]))
    return {
        name: torch.from_numpy(np.ascontiguousarray(planes[at]))
        for name, planes in vars(lesson).items()
    }


def main(
    data: Annotated[Path, typer.Argument(help="Folder of sequences of two halves.")],
    out: Annotated[Path, typer.Option(help="Folder for the weights.")],
    rounds: Annotated[int, typer.Option(min=1, help="Each on pictures of the last.")] = 3,
    steps: Annotated[int, typer.Option(min=1, help="Of Adam, in each.")] = 300,
    rate: Annotated[float, typer.Option(min=0, help="Of Adam, at first.")] = 2e-3,
    model: Annotated[str, typer.Option(help="Whose rules hold.")] = "online",
) -> None:
    """Teach the network of a model that learns while it denoises."""
    spec = load(model)
    layout, seed = network_weights(spec), spec.training.seed
    sequences = sequences_in([data])
    weights, began = start(layout, seed), time.monotonic()
    out.mkdir(parents=True, exist_ok=True)
    (out / LOG).unlink(missing_ok=True)
    for number in range(rounds):
        given = track(sequences, f"round {number + 1}", console=Console(stderr=True))
        lessons = [lesson for path in given for lesson in lessons_of(path, weights.numpy(), model)]
        weights, loss = teach(weights, lessons, layout, steps=steps, rate=rate, seed=seed + number)
        with atomic_path(out / WEIGHTS) as temporary:
            save_file({"weights": weights}, temporary)
        log_loss(out / LOG, (number + 1) * steps, loss, time.monotonic() - began)
        print(f"round {number + 1}: {len(lessons)} frames, loss {loss:.4f}", flush=True)
    record_data(out, sequences)


if __name__ == "__main__":
    program.run(main)

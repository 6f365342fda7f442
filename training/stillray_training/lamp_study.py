"""``python -m stillray_training.lamp_study --model kpyr-5s-still``: what is left of a small lamp.

A lamp of 4x3 pixels on a wall of two colours, single frames of 1 to 16 samples a pixel: its edges
on those of pixels, or half a pixel off, so that samples meet it by chance there. Models with and
without the rule that puts lamps back (`stillray.stages.lamps`), and peers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from statistics import fmean
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from stillray.cli import program
from stillray.frame import Frame
from stillray.model_spec.stages import Lamps
from stillray.models.registry import ModelInfo, find_model
from stillray.pipeline.denoiser import Denoiser
from stillray_training.peers import find_peer
from stillray_training.small_lamps import Lamp, lit_frame

SAMPLES = (1, 2, 4, 16)
#: Columns of the table: where the lamp's edges lie, in pixels from those of pixels.
EDGES = {"hard": 0.0, "mixed": 0.5}
_SHAPE = (33, 45)
_TOP, _LEFT, _HEIGHT, _WIDTH = 4, 22, 3, 4  # pixels
_RADIANCE = np.array([6, 4.8, 3], np.float32)
_IRRADIANCE = 0.12  # of the wall
_FACING = np.array([0, 0, 1], np.float32)
_SEEDS = 5

Denoise = Callable[[Frame], np.ndarray]


def wall_with_lamp(samples: int, offset: float, seed: int) -> tuple[Frame, np.ndarray]:
    """A frame, and which pixels see nothing but the lamp ``(h, w)``."""
    rng = np.random.default_rng(seed)
    albedo = np.full((*_SHAPE, 3), 0.7, np.float32)
    albedo[:, : _SHAPE[1] // 3] = (0.6, 0.06, 0.05)
    grain = rng.gamma(samples, 1 / samples, (*_SHAPE, 1))
    wall = Frame(
        color=(albedo * np.float32(_IRRADIANCE) * grain).astype(np.float32),
        albedo=albedo,
        normal=np.tile(_FACING, (*_SHAPE, 1)),
        depth=np.full(_SHAPE, 5, np.float32),
    )
    coverage = np.outer(
        _covered(_SHAPE[0], _TOP + offset, _HEIGHT), _covered(_SHAPE[1], _LEFT + offset, _WIDTH)
    )
    lamp = Lamp(
        coverage=coverage.astype(np.float32),
        radiance=_RADIANCE,
        albedo=np.full(3, 0.9, np.float32),
        normal=_FACING,
        distance=5.0,
    )
    return lit_frame(wall, [lamp], samples, rng), coverage == 1


def _covered(count: int, first: float, length: float) -> np.ndarray:
    """How much of each of so many pixels a line covers."""
    at = np.arange(count)
    return np.clip(np.minimum(at + 1, first + length) - np.maximum(at, first), 0, 1)


def shares_kept(denoise: Denoise) -> dict[str, list[float]]:
    """By where the edges lie, for each of `SAMPLES`: the light that is left, 1 for all."""
    found: dict[str, list[float]] = {}
    for edge, offset in EDGES.items():
        for samples in SAMPLES:
            kept = []
            for seed in range(_SEEDS):
                frame, seen = wall_with_lamp(samples, offset, seed)
                kept.append(float(denoise(frame)[seen].mean() / frame.color[seen].mean()))
            found.setdefault(edge, []).append(fmean(kept))
    return found


def with_rule(info: ModelInfo, *, restored: bool) -> ModelInfo:
    """A model that puts lamps back, or does not."""
    spec = dataclasses.replace(info.spec, lamps=Lamps(restored=restored))
    return dataclasses.replace(info, spec=spec)


def main(
    model: Annotated[list[str] | None, typer.Option(help="Model, or an .onnx; repeatable.")] = None,
    peer: Annotated[list[str] | None, typer.Option(help="oidn-high and so on; repeatable.")] = None,
) -> None:
    """Print the share of a lamp's light that is left."""
    heads = [f"{edge}, {samples}" for edge in EDGES for samples in SAMPLES]
    table = Table("", "rule", *heads, box=None)

    def add(name: str, rule: str, denoise: Denoise) -> None:
        kept = shares_kept(denoise)
        table.add_row(name, rule, *(f"{share:.2f}" for edge in EDGES for share in kept[edge]))

    for name in model or ["kpyr-5-still", "kpyr-5s-still"]:
        for restored in (False, True):
            with Denoiser(with_rule(find_model(name), restored=restored), temporal=False) as stream:
                add(name, "yes" if restored else "no", stream.denoise)
    for name in peer or []:
        add(name, "", find_peer(name).make().denoise)
    Console(width=140).print(table)


if __name__ == "__main__":
    program.run(main)

"""``stillray-train wskp-3 --data data/train --out runs/wskp-3``.

Trains a model by its spec's recipe. Stops and resumes at any step: ``checkpoint.safetensors`` holds
weights and the optimiser's moments, ``log.csv`` the losses.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import torch
import typer

from stillray.cli import program
from stillray.errors import InputError
from stillray.model_spec import load
from stillray_training.families import FAMILIES, RECURRENT
from stillray_training.machine import Machine
from stillray_training.networks.repvgg import without_branches
from stillray_training.patch_training import train
from stillray_training.upscaling.loop import train_recurrent


def main(
    model: Annotated[str, typer.Argument(help="Name of a spec: wskp-3, wskp-6.")],
    data: Annotated[list[Path], typer.Option(help="Folder of rendered sequences; repeatable.")],
    out: Annotated[Path, typer.Option(help="Folder for checkpoint and log.")],
    threads: Annotated[int, typer.Option(help="Threads of PyTorch.")] = 0,
    steps: Annotated[int, typer.Option(help="Override the recipe's steps.")] = 0,
    start: Annotated[
        str, typer.Option(help="Similar model to start from: checkpoint, .onnx file or name.")
    ] = "",
    device: Annotated[str, typer.Option(help="What learns: cpu, or a card: cuda.")] = "cpu",
    workers: Annotated[
        int, typer.Option(help="Processes that prepare batches ahead; 0: none.")
    ] = 0,
    batch: Annotated[int, typer.Option(help="Override the recipe's patches a step.")] = 0,
    seed: Annotated[int, typer.Option(help="Override the recipe's seed; -1: as it is.")] = -1,
    minutes: Annotated[
        float, typer.Option(help="Be done after so long, whatever steps those are.")
    ] = float("inf"),
    plain: Annotated[
        bool, typer.Option("--plain", help="Train without the extra branches (the ablation).")
    ] = False,
) -> None:
    """Train a model."""
    spec = load(model)
    if spec.family not in FAMILIES | RECURRENT:
        raise InputError(
            f"model must be of {', '.join(FAMILIES | RECURRENT)}, got {spec.name}, which learns as "
            "it denoises"
        )
    if threads:
        torch.set_num_threads(threads)
    machine = Machine.named(device, workers, minutes)
    recipe = dataclasses.replace(
        spec.training,
        steps=steps or spec.training.steps,
        batch=batch or spec.training.batch,
        seed=spec.training.seed if seed < 0 else seed,
    )
    spec = dataclasses.replace(spec, training=recipe)
    if plain:
        spec = without_branches(spec)
    learn = train_recurrent if spec.family in RECURRENT else train
    learn(spec, data, out, start=start or None, machine=machine)


if __name__ == "__main__":
    program.run(main)

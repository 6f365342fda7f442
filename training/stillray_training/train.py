"""``stillray-train wskp-3 --data data/train --out runs/wskp-3``.

Trains a model by its spec's recipe. Stops and resumes at any step: ``checkpoint.safetensors`` holds
weights and Adam's moments, ``log.csv`` the losses.
"""

from __future__ import annotations

import copy
import csv
import dataclasses
import json
import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import typer
from rich.progress import MofNCompleteColumn, Progress, TimeRemainingColumn
from safetensors.torch import load_file, save_file
from torch import Tensor, nn
from torch.utils._pytree import tree_map

from stillray.arrays.strips import Strips
from stillray.cli import program
from stillray.errors import InputError
from stillray.io.exr.read_write import atomic_path
from stillray.model_spec import ModelSpec, load
from stillray.model_spec.loader import FeatureFilters, FilterNetwork
from stillray_training.dataset import (
    NOISY,
    Batch,
    Example,
    PatchSampler,
    find_sequences,
    load_examples,
    previous_outputs,
)
from stillray_training.families import FAMILIES, Family, network_of
from stillray_training.losses import (
    blur_error,
    displayed,
    dissimilarity,
    excess,
    per_patch,
    slope_error,
    smape,
    unsteadiness,
)
from stillray_training.provenance import ASSETS, assets_of
from stillray_training.start import STARTED_FROM, start_from

CHECKPOINT = "checkpoint.safetensors"
LOG = "log.csv"
PREVIOUS = "previous.onnx"  # the model whose outputs are the previous ones of a recurrence
_LOG_EVERY = 20  # steps
_USUAL_ERROR = 0.25  # mean error as displayed of a patch of one sample a pixel
_QUIETEST = 0.01  # and what is added to it, so that a patch without noise does not count alone


def reconstruct_loss(
    network: nn.Module, batch: Batch, spec: ModelSpec, family: Family | None = None
) -> Tensor:
    """Error of the re-modulated result against the reference, both exposed."""
    family = family or FAMILIES[spec.family]
    take = {
        field.name: torch.from_numpy(getattr(batch, field.name))
        for field in dataclasses.fields(batch)
    }
    # channels last: the processor's convolutions of 16 channels run a third faster
    features = take["features"].contiguous(memory_format=torch.channels_last)
    with torch.autocast("cpu", torch.bfloat16, enabled=spec.training.bfloat16):
        outputs = network(features)
    outputs = tree_map(Tensor.float, outputs)
    image = family.radiance(outputs, take, spec) * take["exposure"]
    reference = take["reference"] * take["exposure"]
    recipe = spec.training
    shown, wanted = displayed(image), displayed(reference)
    error = shown - wanted
    loss = smape(image, reference, recipe.smape_epsilon)
    loss = loss + recipe.display_weight * per_patch(error.abs())
    loss = loss + recipe.squared_weight * per_patch(error.square())
    if recipe.structure_weight:
        loss = loss + recipe.structure_weight * dissimilarity(shown, wanted)
    if recipe.slope_weight:
        loss = loss + recipe.slope_weight * slope_error(error)
    if recipe.blur_weight:
        loss = loss + recipe.blur_weight * blur_error(error)
    if recipe.steady_weight:
        before = displayed(take["previous"] * take["exposure"])
        change = unsteadiness(shown, wanted, before, take["valid"])
        loss = loss + recipe.steady_weight * change
    if recipe.hinge_weight or recipe.quiet_power:
        given = displayed(take["irradiance"] * take["divisor"] * take["exposure"])
        before = (given - wanted).abs()
        loss = loss + recipe.hinge_weight * excess(error.abs(), before)
        before = per_patch(before)
        # 1 for the noise of one sample a pixel
        loss = loss * ((before + _QUIETEST) / _USUAL_ERROR) ** -recipe.quiet_power
    return loss.mean()


def learning_rate(step: int, spec: ModelSpec) -> float:
    """A short linear rise, then a cosine decay to one per cent."""
    recipe = spec.training
    rise = min(1.0, (step + 1) / 100)
    return (
        recipe.learning_rate
        * rise
        * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * min(step / recipe.steps, 1.0))))
    )


def train(
    spec: ModelSpec,
    data: list[Path],
    out: Path,
    *,
    start: str | Path | None = None,
    save_every: int = 200,
    family: Family | None = None,
    examples: Sequence[Example] = (),
) -> nn.Module:
    """Train until the recipe's last step; resumes from ``out`` if it holds a checkpoint.

    Parameters
    ----------
    spec
        The model and its recipe.
    data
        Folders of rendered sequences.
    out
        Folder for the checkpoint and the log; made if missing.
    start
        A similar model to start from, see `stillray_training.start`; None for random weights.
    save_every
        Steps between checkpoints.
    family
        Network and reconstruction; None for those of the spec's family.
    examples
        What `load_all` gave for the same data, to several trainings that see it alike; loaded here
        if there are none.

    Raises
    ------
    InputError
        There are no finished sequences, or the checkpoint belongs to another spec.
    """
    sequences = _all_sequences(data)
    family = family or FAMILIES[spec.family]
    out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(spec.training.seed)
    network = family.network(spec)
    optimiser = torch.optim.Adam(network.parameters(), lr=spec.training.learning_rate)
    average = copy.deepcopy(network) if spec.training.average else network
    step = restore(out / CHECKPOINT, spec, network, optimiser, average)
    if start is not None and step == 0:
        origin = start_from(start, network, spec)
        (out / STARTED_FROM).write_text(json.dumps(origin, indent=1))
        average.load_state_dict(network.state_dict())
    with Progress(
        *Progress.get_default_columns()[:3],
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        transient=not sys.stderr.isatty(),
    ) as progress:
        # a list of its own: previous outputs are this model's
        examples = list(examples) or load_all(data, spec, progress)
        forget_after(out / LOG, step)
        (out / "data.json").write_text(json.dumps([path.name for path in sequences], indent=1))
        (out / ASSETS).write_text(json.dumps(assets_of(list(sequences)), indent=1))
        recipe = spec.training
        resumed = recipe.history_from and step > recipe.history_from
        if resumed and (step - recipe.history_from) % recipe.history_every:
            _refresh_previous_output(examples, sequences, out / PREVIOUS, progress)
        sampler = PatchSampler(examples, spec)
        task = progress.add_task(spec.name, total=spec.training.steps, completed=step)
        losses: list[float] = []
        began = time.monotonic()
        while step < spec.training.steps:
            since = step - recipe.history_from
            if recipe.history_from and since >= 0 and since % recipe.history_every == 0:
                _export_for_previous_output(average, spec, out / PREVIOUS)
                _refresh_previous_output(examples, sequences, out / PREVIOUS, progress)
            for group in optimiser.param_groups:
                group["lr"] = learning_rate(step, spec)
            loss = reconstruct_loss(network, sampler.batch(step), spec, family)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            if average is not network:
                follow(average, network, min(spec.training.average, step / (step + 10)))
            losses.append(loss.item())
            step += 1
            progress.advance(task)
            if step % _LOG_EVERY == 0:
                log_loss(out / LOG, step, float(np.mean(losses)), time.monotonic() - began)
                losses = []
            if step % save_every == 0 or step == spec.training.steps:
                save(out / CHECKPOINT, spec, network, optimiser, average, step)
    return average


def follow(average: nn.Module, network: nn.Module, decay: float) -> None:
    """A step of a running mean of weights."""
    with torch.no_grad():
        for mean, weight in zip(average.parameters(), network.parameters(), strict=True):
            mean.lerp_(weight, 1 - decay)


def load_all(data: list[Path], spec: ModelSpec, progress: Progress) -> list[Example]:
    """The examples of all sequences of some folders.

    Raises
    ------
    InputError
        There are no finished sequences.
    """
    sequences = _all_sequences(data)
    loading = progress.add_task("load", total=len(sequences))
    examples: list[Example] = []
    for sequence in sequences:
        examples += load_examples(sequence, spec, Strips(1))
        progress.advance(loading)
    return examples


def _all_sequences(data: list[Path]) -> list[Path]:
    sequences = [path for folder in data for path in find_sequences(folder)]
    if not sequences:
        raise InputError(
            f"data must hold finished sequences, got {', '.join(map(str, data))}; stillray-gather "
            "makes them of renders of your own"
        )
    return sequences


def _export_for_previous_output(network: nn.Module, spec: ModelSpec, path: Path) -> None:
    """Write the network as it is now, so that a resumed run sees the same previous outputs."""
    # the export knows of training, not the other way round, but for this
    from stillray_export.fuse import fuse
    from stillray_export.to_onnx import network_graph

    with atomic_path(path) as temporary:
        temporary.write_bytes(network_graph(fuse(network), spec, {}).SerializeToString())


def _refresh_previous_output(
    examples: list[Example], sequences: list[Path], model: Path, progress: Progress
) -> None:
    """Give every example the previous output of a model: one step of a recurrence, unrolled.

    Gradients stop at the previous output, which grows old until it is renewed; in return the
    recurrence costs nothing a step, and is as long as the sequence.
    """
    task = progress.add_task("previous output", total=len(sequences))
    places = {
        (example.sequence, example.frames): index
        for index, example in enumerate(examples)
        if example.kind == NOISY
    }
    for sequence in sequences:
        for frames, previous in previous_outputs(sequence, model, Strips(1)).items():
            at = places[sequence.name, frames]
            examples[at] = dataclasses.replace(examples[at], previous=previous)
        progress.advance(task)
    progress.remove_task(task)


def load_network(
    spec: ModelSpec, checkpoint: Path, family: Family | None = None
) -> tuple[nn.Module, int]:
    """A network with a checkpoint's weights (their mean over steps), and the steps trained."""
    network = family.network(spec) if family else network_of(spec)
    step = restore(checkpoint, spec, network, None, network)
    if step == 0:
        raise InputError(f"{checkpoint}: no such checkpoint")
    return network, step


def log_loss(path: Path, step: int, loss: float, seconds: float) -> None:
    """Append a row to a log; makes it if it is missing."""
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.writer(file)
        if new:
            writer.writerow(["step", "loss", "seconds"])
        writer.writerow([step, f"{loss:.6f}", f"{seconds:.1f}"])


def forget_after(path: Path, step: int) -> None:
    """Drop the rows of steps that a resumed run takes again."""
    if path.is_file():
        with path.open(newline="") as file:
            header, *rows = list(csv.reader(file))
        with atomic_path(path) as temporary, temporary.open("w", newline="") as file:
            csv.writer(file).writerows([header, *(row for row in rows if int(row[0]) <= step)])


def save(
    path: Path,
    spec: ModelSpec,
    network: nn.Module,
    optimiser: torch.optim.Optimizer,
    average: nn.Module,
    step: int,
) -> None:
    """Write a checkpoint, complete or not at all; ``average`` may be the network itself."""
    tensors = {f"network.{name}": value for name, value in network.state_dict().items()}
    if average is not network:
        means = average.state_dict().items()
        tensors.update({f"average.{name}": value for name, value in means})
    for index, moments in optimiser.state_dict()["state"].items():
        for name, value in moments.items():
            tensors[f"adam.{index}.{name}"] = torch.as_tensor(value)
    with atomic_path(path) as temporary:
        save_file(tensors, temporary, metadata={"step": str(step), "spec": spec.to_json()})


def restore(
    path: Path,
    spec: ModelSpec,
    network: nn.Module,
    optimiser: torch.optim.Optimizer | None,
    average: nn.Module,
) -> int:
    """Read a checkpoint, if there is one; its steps, 0 without.

    Raises
    ------
    InputError
        It is of another network.
    """
    if not path.is_file():
        return 0
    from safetensors import safe_open

    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    if json.loads(metadata["spec"])["network"] != json.loads(spec.to_json())["network"]:
        raise InputError(f"{path}: the checkpoint must be of {spec.name} as it is specified now")
    tensors = load_file(path)

    def weights(prefix: str) -> dict[str, Tensor]:
        found = {name: value for name, value in tensors.items() if name.startswith(prefix)}
        return {name.removeprefix(prefix): value for name, value in found.items()}

    network.load_state_dict(weights("network."))
    average.load_state_dict(weights("average.") or weights("network."))
    if optimiser is not None:
        state: dict[int, dict[str, Any]] = {}
        for name, value in weights("adam.").items():
            index, key = name.split(".")
            state.setdefault(int(index), {})[key] = value
        optimiser.load_state_dict(
            {"state": state, "param_groups": optimiser.state_dict()["param_groups"]}
        )
    return int(metadata["step"])


def main(
    model: Annotated[str, typer.Argument(help="Name of a spec: wskp-3, wskp-6.")],
    data: Annotated[list[Path], typer.Option(help="Folder of rendered sequences; repeatable.")],
    out: Annotated[Path, typer.Option(help="Folder for checkpoint and log.")],
    threads: Annotated[int, typer.Option(help="Threads of PyTorch.")] = 0,
    steps: Annotated[int, typer.Option(help="Override the recipe's steps.")] = 0,
    start: Annotated[
        str, typer.Option(help="Similar model to start from: checkpoint, .onnx file or name.")
    ] = "",
    plain: Annotated[
        bool, typer.Option("--plain", help="Train without the extra branches (the ablation).")
    ] = False,
) -> None:
    """Train a model."""
    spec = load(model)
    if spec.family not in FAMILIES:
        raise InputError(
            f"model must be of {', '.join(FAMILIES)}, got {spec.name}, which learns as it denoises"
        )
    if threads:
        torch.set_num_threads(threads)
    if steps:
        spec = dataclasses.replace(spec, training=dataclasses.replace(spec.training, steps=steps))
    if plain:
        spec = without_branches(spec)
    if isinstance(spec.decoder, FeatureFilters):
        # it uses this module's checkpoints
        from stillray_training.upscaling.loop import train_recurrent

        if start:
            raise InputError(f"start must not be given with {spec.name}, got {start}")
        train_recurrent(spec, data, out)
        return
    train(spec, data, out, start=start or None)


def without_branches(spec: ModelSpec) -> ModelSpec:
    """The same model as plain convolutions: Fan et al. 2021, table 5, "without RepVGG"."""
    if isinstance(spec.network, FilterNetwork):
        raise InputError(f"model must have branches to go without, got {spec.name}")
    network = dataclasses.replace(
        spec.network, branches=(max(spec.network.branches),), identity=False
    )
    return dataclasses.replace(spec, network=network)


if __name__ == "__main__":
    program.run(main)

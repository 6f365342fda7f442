"""A training's checkpoint: weights, their mean, the optimiser's moments and the step."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from stillray.errors import InputError
from stillray.io.atomic import atomic_path
from stillray.model_spec import ModelSpec
from stillray_training.families import Family, network_of

CHECKPOINT = "checkpoint.safetensors"


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
            tensors[f"optimiser.{index}.{name}"] = torch.as_tensor(value)
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
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    before, now = json.loads(metadata["spec"]), json.loads(spec.to_json())
    if before["network"] != now["network"]:
        raise InputError(f"{path}: the checkpoint must be of {spec.name} as it is specified now")
    if optimiser is not None and _optimiser_in(before) != _optimiser_in(now):
        raise InputError(
            f"{path}: the checkpoint must be of optimiser {_optimiser_in(now)}, got "
            f"{_optimiser_in(before)}; another one can start from it"
        )
    tensors = load_file(path)

    def weights(prefix: str) -> dict[str, Tensor]:
        found = {name: value for name, value in tensors.items() if name.startswith(prefix)}
        return {name.removeprefix(prefix): value for name, value in found.items()}

    network.load_state_dict(weights("network."))
    average.load_state_dict(weights("average.") or weights("network."))
    if optimiser is not None:
        state: dict[int, dict[str, Any]] = {}
        for name, value in weights("optimiser.").items():
            index, key = name.split(".")
            state.setdefault(int(index), {})[key] = value
        optimiser.load_state_dict(
            {"state": state, "param_groups": optimiser.state_dict()["param_groups"]}
        )
    return int(metadata["step"])


def load_network(
    spec: ModelSpec, checkpoint: Path, family: Family | None = None
) -> tuple[nn.Module, int]:
    """A network with a checkpoint's weights (their mean over steps), and the steps trained."""
    network = family.network(spec) if family else network_of(spec)
    step = restore(checkpoint, spec, network, None, network)
    if step == 0:
        raise InputError(f"{checkpoint}: no such checkpoint")
    return network, step


def _optimiser_in(spec: dict[str, Any]) -> str:
    """Adam in specs of before it was named."""
    return str(spec["training"].get("optimiser", "adam"))

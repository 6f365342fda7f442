"""``python -m stillray_training.mean_weights RUN --before OLD.onnx --share 0.6 --out RUN2``.

A weighted mean of the weights before a training and after it. Training on all counts of samples
made kpyr-5 keep noise that the weights before had taken away; between the two lie weights that do
both well (Wortsman et al. 2022, Robust fine-tuning of zero-shot models).
"""

from __future__ import annotations

import copy
import json
import shutil
from pathlib import Path
from typing import Annotated

import torch
import typer
from safetensors import safe_open
from safetensors.torch import save_file

from stillray.cli import program
from stillray.errors import InputError
from stillray.io.atomic import atomic_path
from stillray.model_spec import from_json
from stillray_training.checkpoint import CHECKPOINT, load_network
from stillray_training.start import STARTED_FROM, start_from


def mean_weights(run: Path, before: str, share: float, out: Path) -> None:
    """Write a run whose checkpoint is a mean of two models' weights.

    Parameters
    ----------
    run
        Folder of a training run.
    before
        Another model of the same network, which may give fewer logits, see
        `stillray_training.start.read_start`.
    share
        Of the run's weights in the mean, [0, 1].
    out
        Folder to write: the checkpoint, and what the run tells of its data.

    Raises
    ------
    InputError
        ``share`` is out of its range, or a model cannot be read or has another network.
    """
    if not 0 <= share <= 1:
        raise InputError(f"share must be in [0, 1], got {share:g}")
    with safe_open(run / CHECKPOINT, framework="pt") as file:
        metadata = file.metadata()
    spec = from_json(metadata["spec"])
    network, _ = load_network(spec, run / CHECKPOINT)
    other = copy.deepcopy(network)  # logits that the other model does not give stay the run's
    origin = start_from(before, other, spec)
    earlier = other.state_dict()
    mean = {
        name: torch.lerp(earlier[name], value, share)
        for name, value in network.state_dict().items()
    }
    out.mkdir(parents=True, exist_ok=True)
    for path in run.iterdir():
        if path.suffix in (".json", ".csv"):
            shutil.copy(path, out / path.name)
    record = {**origin, "share_of_its_weights": round(1 - share, 6)}
    (out / STARTED_FROM).write_text(json.dumps(record, indent=1))
    with atomic_path(out / CHECKPOINT) as temporary:
        tensors = {f"network.{name}": value.contiguous() for name, value in mean.items()}
        save_file(tensors, temporary, metadata=metadata)


def main(
    run: Annotated[Path, typer.Argument(help="Folder of a training run.")],
    before: Annotated[str, typer.Option(help="The other model: checkpoint, .onnx or name.")],
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    share: Annotated[float, typer.Option(help="Of the run's weights.")] = 0.5,
) -> None:
    """Write a run with a mean of its weights and another model's."""
    mean_weights(run, before, share, out)


if __name__ == "__main__":
    program.run(main)

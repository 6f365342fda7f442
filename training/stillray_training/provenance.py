"""Where a model comes from: data and its credits, steps, seed, date, versions, last loss."""

from __future__ import annotations

import csv
import json
import tomllib
from collections import Counter
from datetime import UTC, datetime
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Any

from stillray.errors import InputError
from stillray.model_spec import ModelSpec

_LOSS_ROWS = 10  # rows of the log whose mean is the last loss


def credits_of(scenes: set[str]) -> dict[str, str]:
    """Credit line of each scene.

    Raises
    ------
    InputError
        A scene is not in ``credits.toml``: its licence is not known to allow a shipped model.
    """
    known = tomllib.loads(
        (resources.files("stillray_training") / "credits.toml").read_text(encoding="utf-8")
    )
    if missing := sorted(scenes - set(known)):
        raise InputError(
            f"scenes of a model that ships must be in credits.toml, got {', '.join(missing)}"
        )
    return {name: f"{known[name]['credit']}, {known[name]['licence']}" for name in sorted(scenes)}


def collect(run: Path, spec: ModelSpec, steps: int) -> dict[str, Any]:
    """What a training run's folder tells about the model made in it.

    Parameters
    ----------
    run
        Holds ``data.json``, ``log.csv`` and perhaps ``started_from.json``, as
        `stillray_training.train` writes them.
    spec
        The model's specification.
    steps
        Steps of its checkpoint.
    """
    sequences = json.loads((run / "data.json").read_text())
    scenes = Counter(name.rsplit("-", 2)[0] for name in sequences)
    with (run / "log.csv").open(newline="") as file:
        losses = [float(row["loss"]) for row in csv.DictReader(file)][-_LOSS_ROWS:]
    started = run / "started_from.json"
    origin = {"started_from": json.loads(started.read_text())} if started.is_file() else {}
    return {
        **origin,
        "data": dict(sorted(scenes.items())),
        "credits": credits_of(set(scenes)),
        "steps": steps,
        "seed": spec.training.seed,
        "date": datetime.now(UTC).date().isoformat(),
        "torch": version("torch"),
        "training_loss": round(sum(losses) / len(losses), 5),
    }

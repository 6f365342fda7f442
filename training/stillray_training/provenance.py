"""Where a model comes from: data and its credits, steps, seed, date, versions, last loss."""

from __future__ import annotations

import csv
import json
import tomllib
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Any

from stillray.errors import InputError
from stillray.model_spec import ModelSpec

#: Credit of scenes of which nobody has said whose they are.
UNSTATED = "not stated: renders of whoever trained this model"
DATA = "data.json"  # in a run's folder: the names of its sequences
ASSETS = "assets.json"  # in a run's folder: who made the objects in its sequences
_FREE = ("CC0", "CC BY", "CC-BY")  # licences whose objects may train a model that ships begin so
_LOSS_ROWS = 10  # rows of the log whose mean is the last loss


def credits_of(scenes: set[str]) -> dict[str, str]:
    """Credit line of each scene; `UNSTATED` of one that ``credits.toml`` does not know.

    Those are renders of whoever trains; a model that ships must have none of them, which is what
    ``tests/training/test_training.py`` looks at.
    """
    known = tomllib.loads(
        (resources.files("stillray_training") / "credits.toml").read_text(encoding="utf-8")
    )
    return {
        name: f"{known[name]['credit']}, {known[name]['licence']}" if name in known else UNSTATED
        for name in sorted(scenes)
    }


def assets_of(sequences: list[Path]) -> dict[str, str]:
    """Credit line of each asset that stands in the sequences, as their ``sequence.json`` say.

    Raises
    ------
    InputError
        An asset's licence does not allow a shipped model.
    """
    found = {}
    for sequence in sequences:
        record = sequence / "sequence.json"
        if not record.is_file():
            continue
        for asset in json.loads(record.read_text(encoding="utf-8")).get("assets", ()):
            line = '"{title}" by {author} ({source}), {licence}'.format(**asset)
            found[asset["name"]] = (asset["licence"], line)
    if bound := sorted(name for name, (licence, _) in found.items() if not _may_ship(licence)):
        raise InputError(
            f"assets of a model that ships must be under CC0 or CC BY, got {', '.join(bound)}"
        )
    return {name: line for name, (_, line) in sorted(found.items())}


def _may_ship(licence: str) -> bool:
    return licence.startswith(_FREE) and not any(word in licence for word in ("NC", "ND", "SA"))


def record_data(run: Path, sequences: Sequence[Path]) -> None:
    """Write into a run's folder what it learns from, and who made the objects in that.

    Raises
    ------
    InputError
        As `assets_of`.
    """
    (run / DATA).write_text(json.dumps([path.name for path in sequences], indent=1))
    (run / ASSETS).write_text(json.dumps(assets_of(list(sequences)), indent=1))


def collect(run: Path, spec: ModelSpec, steps: int) -> dict[str, Any]:
    """What a training run's folder tells about the model made in it.

    Parameters
    ----------
    run
        Holds ``data.json``, ``log.csv`` and perhaps ``assets.json`` and ``started_from.json``, as
        a training writes them.
    spec
        The model's specification.
    steps
        Steps of its checkpoint.
    """
    sequences = json.loads((run / DATA).read_text())
    scenes = Counter(name.rsplit("-", 2)[0] for name in sequences)
    with (run / "log.csv").open(newline="") as file:
        losses = [float(row["loss"]) for row in csv.DictReader(file)][-_LOSS_ROWS:]
    started = run / "started_from.json"
    origin = {"started_from": json.loads(started.read_text())} if started.is_file() else {}
    assets = run / ASSETS
    objects = json.loads(assets.read_text()) if assets.is_file() else {}
    return {
        **origin,
        "data": dict(sorted(scenes.items())),
        "credits": {**credits_of(set(scenes)), **objects},
        "steps": steps,
        "seed": spec.training.seed,
        "date": datetime.now(UTC).date().isoformat(),
        "torch": version("torch"),
        "training_loss": round(sum(losses) / len(losses), 5),
    }

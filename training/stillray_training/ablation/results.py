"""What the study has found so far: read from its folder, averaged."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray_training.ablation.measure import METRICS, PARTS, SCORES, TIMES
from stillray_training.ablation.study import folder_of
from stillray_training.ablation.variants import BASE, Variant


@dataclass(frozen=True, kw_only=True)
class Results:
    """Means over scenes and medians over rounds.

    Attributes
    ----------
    scores
        Variant to scene to metric to value; variants that are not finished are absent.
    one_frame
        The same without accumulation, for some variants.
    losses
        Variant to the mean loss of its last 200 steps of training, on the same patches for all.
    milliseconds
        Variant to part to the median over rounds.
    ratios
        Variant to part, and to their sum as "both", to the median ratio to `BASE`, round by round.
    size
        Height and width of the frame that was timed, pixels.
    rounds
        How often.
    machine
        Where.
    load
        Programs that were running there, this one among them: the mean of the last minute.
    """

    scores: dict[str, dict[str, dict[str, float]]]
    one_frame: dict[str, dict[str, dict[str, float]]]
    losses: dict[str, float]
    milliseconds: dict[str, dict[str, float]]
    ratios: dict[str, dict[str, float]]
    size: tuple[int, int]
    rounds: int
    machine: dict[str, str]
    load: float

    def mean(self, name: str) -> dict[str, float]:
        """Mean scores of a variant over the scenes."""
        return mean_over_scenes(self.scores[name])


def mean_over_scenes(scenes: dict[str, dict[str, float]]) -> dict[str, float]:
    """Metric to mean, for the metrics that every scene has."""
    return {
        metric: float(np.mean([scores[metric] for scores in scenes.values()]))
        for metric in METRICS
        if all(metric in scores for scores in scenes.values())
    }


def read_results(variants: Sequence[Variant], out: Path) -> Results:
    """The results that lie in the folder of a study.

    Raises
    ------
    InputError
        Nothing was scored, or nothing was timed.
    """
    scores, one_frame, losses = {}, {}, {}
    for variant in variants:
        path = folder_of(variant, out) / SCORES
        if path.is_file():
            found = json.loads(path.read_text())
            scores[variant.name] = found["scenes"]
            losses[variant.name] = found["loss"]
            if "one frame" in found:
                one_frame[variant.name] = found["one frame"]
    if BASE not in scores:
        raise InputError(f"out must hold the scores of {BASE} at least, got {out}")
    if not (out / TIMES).is_file():
        raise InputError(f"out must hold times, got {out}: run with --rounds first")
    times = json.loads((out / TIMES).read_text())
    rounds = {name: _with_sum(parts) for name, parts in times["milliseconds"].items()}
    return Results(
        scores=scores,
        one_frame=one_frame,
        losses=losses,
        milliseconds={
            name: {part: float(np.median(values)) for part, values in parts.items()}
            for name, parts in rounds.items()
        },
        ratios={
            name: {
                part: float(np.median(values / rounds[BASE][part]))
                for part, values in parts.items()
            }
            for name, parts in rounds.items()
        },
        size=(times["size"][0], times["size"][1]),
        rounds=times["rounds"],
        machine=times["machine"],
        load=times["load"],
    )


def _with_sum(parts: dict[str, Any]) -> dict[str, np.ndarray]:
    arrays = {part: np.array(parts[part]) for part in PARTS}
    return {**arrays, "both": arrays["network"] + arrays["reconstruct"]}

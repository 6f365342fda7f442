"""What the study has found so far: read from its folder, averaged over scenes and seeds."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, stdev
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray_training.ablation.measure import METRICS, PARTS, SCORES, TIMES
from stillray_training.ablation.study import folder_of
from stillray_training.ablation.variants import BASE, Variant

#: Scene to metric to value.
Scenes = dict[str, dict[str, float]]
#: Seed to what was found with it.
Seeds = dict[int, Scenes]


@dataclass(frozen=True, kw_only=True)
class Value:
    """A mean over seeds, and how far seeds lie apart.

    Attributes
    ----------
    mean
    deviation
        Standard deviation over the seeds, of the sample; None of one seed.
    seeds
        How many.
    """

    mean: float
    deviation: float | None
    seeds: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Value:
        """Of one value a seed."""
        apart = stdev(values) if len(values) > 1 else None
        return cls(mean=fmean(values), deviation=apart, seeds=len(values))


@dataclass(frozen=True, kw_only=True)
class Results:
    """Means over scenes and seeds, and medians over rounds.

    Attributes
    ----------
    scores
        Variant to seed to scene to metric to value; what is not finished is absent.
    one_frame
        The same without accumulation, for some variants.
    losses
        Variant to the mean loss of its last 200 steps of training, on the same patches for all of
        a seed; mean over seeds.
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

    scores: dict[str, Seeds]
    one_frame: dict[str, Seeds]
    losses: dict[str, float]
    milliseconds: dict[str, dict[str, float]]
    ratios: dict[str, dict[str, float]]
    size: tuple[int, int]
    rounds: int
    machine: dict[str, str]
    load: float

    def mean(self, name: str) -> dict[str, Value]:
        """Metric to the mean of a variant over the scenes, and its spread over the seeds."""
        return mean_over_scenes(self.scores[name])

    def difference(self, first: str, second: str) -> Value | None:
        """PSNR of the first less that of the second, seed by seed; None without a shared seed.

        Both saw the same patches with the same seed, so what those do to both does not count.
        """
        pair = self.scores.get(first, {}), self.scores.get(second, {})
        shared = sorted(pair[0].keys() & pair[1].keys())
        if not shared:
            return None
        return Value.of([_psnr(pair[0][seed]) - _psnr(pair[1][seed]) for seed in shared])

    def of_scene(self, name: str, scene: str) -> dict[str, Value]:
        """The same as `mean`, of one scene."""
        return mean_over_scenes(
            {seed: {scene: scenes[scene]} for seed, scenes in self.scores[name].items()}
        )


def mean_over_scenes(seeds: Seeds) -> dict[str, Value]:
    """Metric to mean and spread, for the metrics that every scene has."""
    return {
        metric: Value.of(
            [fmean(one[metric] for one in scenes.values()) for scenes in seeds.values()]
        )
        for metric in METRICS
        if all(metric in one for scenes in seeds.values() for one in scenes.values())
    }


def _psnr(scenes: Scenes) -> float:
    return fmean(one["psnr"] for one in scenes.values())


def read_results(variants: Sequence[Variant], out: Path) -> Results:
    """The results that lie in the folder of a study.

    Raises
    ------
    InputError
        Nothing was scored, or nothing was timed.
    """
    scores: dict[str, Seeds] = {}
    one_frame: dict[str, Seeds] = {}
    losses: dict[str, list[float]] = {}
    for variant in variants:
        path = folder_of(variant, out) / SCORES
        if path.is_file():
            found = json.loads(path.read_text())
            scores.setdefault(variant.name, {})[variant.seed] = found["scenes"]
            losses.setdefault(variant.name, []).append(found["loss"])
            if "one frame" in found:
                one_frame.setdefault(variant.name, {})[variant.seed] = found["one frame"]
    if BASE not in scores:
        raise InputError(f"out must hold the scores of {BASE} at least, got {out}")
    if not (out / TIMES).is_file():
        raise InputError(f"out must hold times, got {out}: run with --rounds first")
    times = json.loads((out / TIMES).read_text())
    rounds = {name: _with_sum(parts) for name, parts in times["milliseconds"].items()}
    return Results(
        scores=scores,
        one_frame=one_frame,
        losses={name: fmean(values) for name, values in losses.items()},
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

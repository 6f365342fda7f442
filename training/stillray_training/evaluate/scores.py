"""Figures of every method on every case, their means, and where a method makes matters worse."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from pathlib import Path

import numpy as np

from stillray.compare import metrics
from stillray.compare.display import display_exposure, tone_map, write_png
from stillray.compare.metrics import METRICS, Metric
from stillray.compare.warping import Followed
from stillray.frame import Frame
from stillray_training.evaluate.cases import Case
from stillray_training.evaluate.methods import NOISY, Methods, Models

Scores = dict[str, dict[str, dict[str, float]]]  # method -> case -> metric -> value
Results = dict[str, Scores]  # title of a set -> its scores
#: Percent of brightness that a picture may be off before it counts as a defect.
BIAS_ALLOWED = 1.0


def evaluate_cases(
    cases: Sequence[Case],
    models: Models,
    *,
    peers: Sequence[str],
    names: Collection[str] | None = None,
    pictures: Path | None = None,
    progress: Callable[[Sequence[Case]], Iterable[Case]] = iter,
) -> Results:
    """Scores of every method on every case.

    Parameters
    ----------
    cases
        From `stillray_training.evaluate.cases.find_cases`.
    models
        Label to model, as `stillray.Denoiser` takes it.
    peers
        Names of peers to run too.
    names
        Metrics that are wanted; None for all.
    pictures
        Folder for tone-mapped PNGs of the last frames.
    progress
        Wraps the cases.
    """
    results: Results = {}
    with Methods(models, peers) as methods:
        for case in progress(cases):
            frames, references = case.read()
            rows = results.setdefault(case.title, {})
            followed = _followed(frames, len(references))
            if pictures:
                title = f"{case.title}-{case.name}"
                write_shown(pictures, f"{title}-reference", references[-1], references[-1])
            run = methods.run(case, frames, len(references))
            for method, images in chain(run, methods.of_references(case, frames, references)):
                scores = _measure(case, images, references, names, followed)
                rows.setdefault(method, {}).update(scores)
                if pictures:
                    write_shown(pictures, f"{title}-{method}", images[-1], references[-1])
    return results


def _measure(
    case: Case,
    images: Sequence[np.ndarray],
    references: Sequence[np.ndarray],
    names: Collection[str] | None,
    followed: Sequence[Followed | None],
) -> dict[str, dict[str, float]]:
    """Case to values: the last frame's, or those of every frame."""
    if case.kind != "frames":
        last = followed[-1]
        return {case.name: metrics.evaluate(images, references, names=names, followed=last)}
    first = len(case.frames) - len(case.references)
    return {
        f"frame {first + index}": metrics.evaluate(
            images[max(0, index - 1) : index + 1],
            references[max(0, index - 1) : index + 1],
            names=names,
            followed=followed[index],
        )
        for index in range(len(images))
    }


def _followed(frames: Sequence[Frame], count: int) -> list[Followed | None]:
    """Where the pixels of the last frames, which have references, were; None of a first one."""
    pairs = pairwise(frames[-count - 1 :])  # not of all: frames may be many, references few
    found = [Followed.between(before, frame) for before, frame in pairs]
    return [*([None] * (count - len(found))), *found]


def taken_from(
    results: Results, former: Results, labels: Collection[str], names: Collection[str] | None
) -> None:
    """Add rows of a former run: of methods that are the same every time.

    Parameters
    ----------
    results
        What they are added to, where sets and cases are the same.
    former
        As ``--out`` wrote it.
    labels
        The methods.
    names
        Metrics that are wanted; None for all.
    """
    for title, rows in results.items():
        cases = {case for row in rows.values() for case in row}
        for method, row in former.get(title, {}).items():
            if method in rows or method not in labels:
                continue
            kept = {
                case: {name: v for name, v in values.items() if names is None or name in names}
                for case, values in row.items()
                if case in cases
            }
            if set(kept) == cases:
                rows[method] = kept


def mean_scores(scores: Scores) -> dict[str, dict[str, float]]:
    """One value of each metric over the cases, a row a method, see `Metric.summary`."""
    means = {}
    for method, cases in scores.items():
        rows = list(cases.values())
        shared = [metric for metric in METRICS if all(metric.name in row for row in rows)]
        means[method] = {m.name: m.summary([row[m.name] for row in rows]) for m in shared}
    return means


@dataclass(frozen=True, kw_only=True)
class Worse:
    """A frame and a metric by which a method's picture is worse than its input."""

    title: str
    case: str
    method: str
    metric: Metric
    value: float
    noisy: float


def worse_than_input(results: Results, methods: Collection[str]) -> list[Worse]:
    """Every frame and metric by which one of the methods does harm.

    A bias counts where it is beyond `BIAS_ALLOWED` and larger than the input's, which clipping
    makes darker the noisier it is.
    """
    found = []
    for title, rows in results.items():
        for method in methods:
            for case, values in rows.get(method, {}).items():
                before = rows.get(NOISY, {}).get(case, {})
                found += [
                    Worse(
                        title=title, case=case, method=method, metric=metric,
                        value=values[metric.name], noisy=before[metric.name],
                    )
                    for metric in METRICS
                    if metric.name in values
                    and metric.name in before
                    and metric.loss(values[metric.name]) > metric.loss(before[metric.name])
                    and not (metric.is_signed and abs(values[metric.name]) <= BIAS_ALLOWED)
                ]  # fmt: skip
    return found


def write_shown(folder: Path, name: str, image: np.ndarray, reference: np.ndarray) -> None:
    """Write an image as it is displayed, exposed as its reference.

    Parameters
    ----------
    folder
        Where it goes, made if missing.
    name
        Of the file, without ``.png``; spaces and what they surround become dashes.
    image, reference : (h, w, 3) float32
        Radiance.
    """
    folder.mkdir(parents=True, exist_ok=True)
    name = name.replace(" + ", "-").replace(", ", "-").replace(" ", "-")
    write_png(folder / f"{name}.png", tone_map(image, display_exposure(reference)))

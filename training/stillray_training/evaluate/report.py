"""Results as Markdown: tables, distances to peers, and where a model is worse than its input."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stillray.compare.metrics import METRICS, Metric
from stillray.models.registry import find_model, for_single_frames
from stillray.pipeline.opening import model_of
from stillray_training.evaluate.cases import WITHOUT_PAST
from stillray_training.evaluate.methods import Models
from stillray_training.evaluate.scores import (
    BIAS_ALLOWED,
    Results,
    Scores,
    mean_scores,
    worse_than_input,
)

# what models are to beat, in every metric
_TO_BEAT = (
    ("high", "OIDN high"), ("balanced", "OIDN fast"), ("fast", "SVGF"), ("fast", "BMFR"),
    ("nbg-2x3", "SVGF"), ("nbg-2x3", "BMFR"),
)  # fmt: skip
_HEAD = """# Quality on validation

Written by
`stillray-evaluate VALIDATION Blender=BLENDER Effects=EFFECTS --pixel-filter box
--report docs/results.md`;
[validation.md](validation.md) says what the folders hold and defines the metrics. No model was
trained on these scenes; the weights of accumulation, the albedo floor of the specs, what is looked
at in mirrors and how the past is interpolated were chosen on them, and the training of the kpyr
models was watched on them, so read these figures as validation, not as a test. SVGF
(Schied et al. 2017) and BMFR (Koskela et al. 2019) are our own implementations, with published
parameters; both end with temporal antialiasing (TAA), so SVGF is there without it as well. OIDN is
Open Image Denoise with albedo and normal, fed the raw frame, or the frame as accumulated for our
kernels; fed the references of a sequence it shows what their own noise leaves of each figure, below
which nothing can come. Our models are told the renderer's pixel filter, of which peers take none.
Tables are means over the scenes; of the bias the worst scene. Under each
table the distances to the peers that models are to beat: differences, and ratios (x) where less is
better; bold is worse. Times are in [performance.md](performance.md).

"""
_WORSE = f"""## Worse than the input

Every frame and metric by which a model's picture is worse than the noisy one that it was given
(bias: beyond {BIAS_ALLOWED:g} %).

"""


def report(results: Results, kinds: Mapping[str, str], models: Models) -> str:
    """The page of results.

    Parameters
    ----------
    results
        From `stillray_training.evaluate.scores.evaluate_cases`.
    kinds
        Title of each set to its kind.
    models
        Label to model, as they were run.
    """
    return _HEAD + trained(models) + sections(results, kinds, models)


def sections(results: Results, kinds: Mapping[str, str], models: Models) -> str:
    """A section a set, and what is worse than the input."""
    parts = []
    for title, scores in results.items():
        parts += [f"## {title[:1].upper()}{title[1:]}\n", table("mean", mean_scores(scores))]
        parts.append(distances(scores, alone=kinds[title] in WITHOUT_PAST))
        if kinds[title] == "sequences":
            parts += [table(case, _of_case(scores, case)) for case in _cases(scores)]
        else:
            parts.append(_every_case(scores))
    return "\n".join(part for part in parts if part) + "\n" + worse(results, list(models))


def distances(scores: Scores, *, alone: bool = False) -> str:
    """How far models are from the peers that they are to beat, where both were run; or nothing.

    Parameters
    ----------
    scores
        Of a set.
    alone
        Whether its frames have no past, for which a quality may be another model.
    """
    means = mean_scores(scores)
    rows = []
    for quality, peer in _TO_BEAT:
        names = [for_single_frames(quality)] if alone else []
        names = [quality, *names, find_model(quality).name]
        label = next((name for name in names if name in means), "")
        if not label or peer not in means:
            continue
        cells = [_distance(metric, means[label], means[peer]) for metric in _measured(means)]
        called = label if quality == label else f'{label} ("{quality}")'
        rows.append(f"| {called} against {peer} | " + " | ".join(cells) + " |")
    if not rows:
        return ""
    return "\n".join([*_heading("mean", _measured(means)), *rows]) + "\n"


def _distance(metric: Metric, mine: Mapping[str, float], other: Mapping[str, float]) -> str:
    if metric.name not in mine or metric.name not in other:
        return ""
    a, b = mine[metric.name], other[metric.name]
    is_difference = metric.higher_is_better or metric.is_signed or b == 0
    apart = f"{a - b:+.3g}" if is_difference else f"x {a / b:.3g}"
    return f"**{apart}**" if metric.loss(a) > metric.loss(b) else apart


def trained(models: Models) -> str:
    """A line that says for how many steps each model was trained, each recipe in its turn."""
    shown = []
    for label, model in models.items():
        part = model_of(model).provenance
        counts: list[str] = []
        while part:
            counts.insert(0, str(part.get("steps", "")))
            part = part.get("started_from", {})
        if any(counts):
            shown.append(f"{label} {' + '.join(counts)}")
    return (
        f"Training steps: {', '.join(shown)}. Models differ in data and losses, too, as\n"
        "[training-log.md](training-log.md) and [differences.md](differences.md) tell.\n\n"
    )


def worse(results: Results, methods: Sequence[str]) -> str:
    """Where the methods are worse than their input: a row a frame and method."""
    found = worse_than_input(results, methods)
    if not found:
        return f"{_WORSE}None.\n"
    rows: dict[tuple[str, str, str], list[str]] = {}
    for entry in found:
        how = f"{entry.metric.format}"
        text = f"{entry.metric.name} {entry.value:{how}} (noisy {entry.noisy:{how}})"
        rows.setdefault((entry.title, entry.case, entry.method), []).append(text)
    lines = ["| set | frame | model | metrics |", "|---|---|---|---|"]
    lines += [f"| {' | '.join(key)} | {', '.join(texts)} |" for key, texts in rows.items()]
    return _WORSE + "\n".join(lines) + "\n"


def _cases(scores: Scores) -> list[str]:
    return list(dict.fromkeys(case for row in scores.values() for case in row))


def _of_case(scores: Scores, case: str) -> dict[str, dict[str, float]]:
    return {method: row[case] for method, row in scores.items() if case in row}


def _every_case(scores: Scores) -> str:
    """PSNR of every case, a column each."""
    metric, cases = METRICS[0], _cases(scores)
    if not any(metric.name in values for row in scores.values() for values in row.values()):
        return ""
    lines = [f"| {metric.title} | " + " | ".join(cases) + " |", "|---" * (len(cases) + 1) + "|"]
    for method, row in scores.items():
        values = (row.get(case, {}).get(metric.name) for case in cases)
        texts = ("" if value is None else format(value, metric.format) for value in values)
        lines.append(f"| {method} | " + " | ".join(texts) + " |")
    return "\n".join(lines) + "\n"


def _measured(rows: Mapping[str, Mapping[str, float]]) -> list[Metric]:
    return [metric for metric in METRICS if any(metric.name in row for row in rows.values())]


def _heading(title: str, shown: Sequence[Metric]) -> list[str]:
    return [
        f"| {title} | " + " | ".join(metric.title for metric in shown) + " |",
        "|---" * (len(shown) + 1) + "|",
    ]


def table(title: str, rows: Mapping[str, Mapping[str, float]]) -> str:
    """A row a method, a column a metric that at least one has."""
    measured = _measured(rows)
    lines = _heading(title, measured)
    for method, row in rows.items():
        values = (format(row[m.name], m.format) if m.name in row else "" for m in measured)
        lines.append(f"| {method} | " + " | ".join(values) + " |")
    return "\n".join(lines) + "\n"

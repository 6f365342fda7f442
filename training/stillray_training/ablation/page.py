"""The page of the study: tables, a plot, and which of the paper's findings hold."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from stillray.compare.metrics import METRICS as ALL_METRICS
from stillray.io.atomic import atomic_path
from stillray.model_spec import load
from stillray.model_spec.training import Training
from stillray_training.ablation.claims import (
    CLAIMS,
    HOLDS,
    measured,
    rises_in,
    uncertainty,
    verdict,
)
from stillray_training.ablation.measure import METRICS
from stillray_training.ablation.plots import draw_kernels
from stillray_training.ablation.results import Results, Value, mean_over_scenes
from stillray_training.ablation.variants import (
    BASE,
    COMPARISONS,
    KERNEL_COUNTS,
    Variant,
    fused,
)

_SHOWN = [metric for metric in ALL_METRICS if metric.name in METRICS]
_BUSY = 3.0  # load above which others had a share of the processor
_HEAD = """# Ablations

Written by `{command}`; the study is `training/stillray_training/ablation/variants.py`.

The ablations of Fan et al. 2021 on our data, and its learned peers. Every variant was trained alike
and shortly: {steps} steps of {batch} patches of {patch}x{patch} pixels, with the same seed the same
patches in the same order, {seeds}, by SMAPE alone as in the paper; the recipe of {base} sees
{factor:.0f} times as many pixels. So these figures compare variants with one another, not with the
models that stillray comes with, and tell more of what is learned early than of what can be learned.
All read the same {features} features of frames accumulated alike, and run as users run a model:
exported, through ONNX Runtime and the runtime's stages; directly predicted kernels (KP, MR-KP)
differ in the reconstruction alone. {spread}PSNR, SSIM, SMAPE and FLIP are of the last frame, mean
of {scenes} validation sequences ({names}), with exposure as in [results.md](results.md).

Milliseconds are of a {width}x{height} frame on {machine}: medians of {rounds} rounds in which the
variants take turns in one process; "/ {base}" is the median of the rounds' ratios of both together.
About {load:.0f} programs wanted the processor meanwhile{busy}.
The training loss is the mean of the last 200 steps, on the same patches for all. The
reconstruction of KP and MR-KP is ours, a pass over the frame for each of a kernel's weights; it is
tested against the same loop as what it was trained with.
"""


_SPREAD = """Behind each mean stands
the standard deviation over the seeds. """


def write_page(variants: Sequence[Variant], results: Results, path: Path, command: str) -> None:
    """Write the page and, once numbers of kernels can be compared, its plot beside it.

    Parameters
    ----------
    variants, results
        The study and what it found; variants that are not finished are left out and named.
    path
        The Markdown file; the plot is a PNG of the same name.
    command
        What wrote it, for the reader.
    """
    plot = path.with_suffix(".png")
    drawn = any(fused(count) in results.scores for count in KERNEL_COUNTS if fused(count) != BASE)
    if drawn:
        draw_kernels(results, plot)
    parts = [
        _head(variants, results, command),
        _left_out(variants, results),
        f"![PSNR and time of kernels]({plot.name})\n" if drawn else "",
        _claims(results),
        *(
            f"## {one.title}\n\n{one.source}.\n\n{_table(one.variants, results)}"
            for one in COMPARISONS
            if sum(name in results.scores for name in one.variants) > 1
        ),
        _accumulation(results),
        _scenes(results),
    ]
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join(part for part in parts if part))


def _head(variants: Sequence[Variant], results: Results, command: str) -> str:
    base = next(variant.spec for variant in variants if variant.name == BASE)
    recipe = base.training
    scenes, count = _scenes_of(results), len(results.scores[BASE])
    return _HEAD.format(
        command=command,
        steps=recipe.steps,
        batch=recipe.batch,
        patch=recipe.patch,
        seeds=_of_seeds(count),
        spread=_SPREAD if count > 1 else "",
        factor=_pixels(load(BASE).training) / _pixels(recipe),
        features=len(base.network.features),
        scenes=len(scenes),
        names=", ".join(scenes),
        width=results.size[1],
        height=results.size[0],
        machine=f"{results.machine['processor']}, {results.machine['threads']} threads",
        rounds=results.rounds,
        load=results.load,
        busy=", so take only large ratios for certain" if results.load > _BUSY else "",
        base=BASE,
    )


def _pixels(recipe: Training) -> int:
    return recipe.steps * recipe.batch * recipe.patch**2


def _of_seeds(count: int) -> str:
    return "one seed" if count == 1 else f"{count} seeds each"


def _scenes_of(results: Results) -> list[str]:
    return sorted(next(iter(results.scores[BASE].values())))


def _left_out(variants: Sequence[Variant], results: Results) -> str:
    """Which trainings are missing, and how many of each."""
    wanted = Counter(variant.name for variant in variants)
    missing = {
        name: count - len(results.scores.get(name, ()))
        for name, count in wanted.items()
        if len(results.scores.get(name, ())) < count
    }
    if not missing:
        return ""
    told = [
        name if wanted[name] == 1 else f"{name} ({count} of {wanted[name]} seeds)"
        for name, count in missing.items()
    ]
    return f"Not finished when this was written: {'; '.join(told)}.\n"


def _claims(results: Results) -> str:
    lines = [
        "## What of the papers holds",
        "",
        "Differences are in PSNR, dB, seed by seed: both saw the same patches; behind them, half "
        "of the interval in which the mean over all seeds lies, 95 %. Of times, the first over the "
        "second. Of one seed nothing is concluded.",
        "",
        "| finding | paper | here | scenes in which the first is above | |",
        "|---|---|---|---|---|",
    ]
    reasons = []
    for claim in CLAIMS:
        found, form = measured(claim, results), ".2f" if claim.times else "+.2f"
        if found is None:  # the variants that are missing are named above
            continue
        paper = "" if claim.paper is None else format(claim.paper, form)
        said = verdict(claim, found)
        scenes = "" if claim.times else rises_in(claim, results)
        unsure = uncertainty(found)
        here = format(found.mean, form) + ("" if unsure is None else f" ± {unsure:.2f}")
        lines.append(f"| {claim.text} | {paper} | {here} | {scenes} | {said} |")
        if claim.why and said != HOLDS:
            reasons.append(f"- {claim.text}: {said}. {claim.why}")
    return "\n".join([*lines, "", *reasons]).rstrip() + "\n"


def _table(names: Sequence[str], results: Results) -> str:
    rows = {name: results.mean(name) for name in names if name in results.scores}
    timed = any(name in results.milliseconds for name in rows)
    extra = ["training loss"] + (["network ms", "reconstruct ms", f"/ {BASE}"] if timed else [])
    lines = _header("variant", extra)
    for name, row in rows.items():
        cells = [*_cells(row), f"{results.losses[name]:.4f}"]
        if name in results.milliseconds:
            parts = results.milliseconds[name]
            ratio = results.ratios[name]["both"]
            cells += [f"{parts['network']:.0f}", f"{parts['reconstruct']:.0f}", f"{ratio:.2f}"]
        else:
            cells += [""] * (len(extra) - 1)
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _accumulation(results: Results) -> str:
    if not results.one_frame:
        return ""
    lines = [
        "## Accumulation on and off",
        "",
        "The same weights on six frames accumulated (section 4.1), and on the last frame alone; "
        "they were trained with both.",
        "",
        *_header("variant", []),
    ]
    for name, seeds in results.one_frame.items():
        lines.append(f"| {name} | " + " | ".join(_cells(results.mean(name))) + " |")
        lines.append(f"| {name}, one frame | " + " | ".join(_cells(mean_over_scenes(seeds))) + " |")
    return "\n".join(lines) + "\n"


def _scenes(results: Results) -> str:
    parts = ["## By scene", ""]
    for scene in _scenes_of(results):
        parts += _header(scene, [])
        parts += [
            f"| {name} | " + " | ".join(_cells(results.of_scene(name, scene))) + " |"
            for name in results.scores
        ]
        parts.append("")
    return "\n".join(parts)


def _header(first: str, extra: Sequence[str]) -> list[str]:
    titles = [first, *(metric.title for metric in _SHOWN), *extra]
    return ["| " + " | ".join(titles) + " |", "|---" * len(titles) + "|"]


def _cells(row: Mapping[str, Value]) -> list[str]:
    return [_cell(row[m.name], m.format) if m.name in row else "" for m in _SHOWN]


def _cell(value: Value, form: str) -> str:
    mean = format(value.mean, form)
    return mean if value.deviation is None else f"{mean} ± {value.deviation:{form}}"

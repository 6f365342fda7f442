"""``python -m stillray_training.grid_study nbg-2x3``: what guides, scales and grids are worth.

The time of reconstruction against the number of grids and of fused kernels, in turn in one
process; and with ``--validation`` the ablations of Meng et al. 2020, section 6.3: each scale alone
beside the blend, and guides that are the mean of the features beside the learned ones; the network
is the same, only its outputs are replaced. ``--report`` writes them to a page.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from stillray.arrays.strips import Strips, available_threads
from stillray.cli import program
from stillray.compare import metrics
from stillray.errors import InputError
from stillray.families import bilateral_grid as grid
from stillray.families import box_filter as kernels
from stillray.families.contract import Engine
from stillray.io.atomic import atomic_path
from stillray.io.exr.read import read_exr
from stillray.model_spec import ModelSpec
from stillray.model_spec.decoders import BilateralGrids, FusedKernels
from stillray.models.registry import find_model
from stillray.pipeline.denoiser import Denoiser
from stillray_training.evaluate.cases import find_scenes, last_referenced

KERNELS = "wskp-6"
_AUXILIARY = ("albedo.r", "albedo.g", "albedo.b", "normal.x", "normal.y", "normal.z", "depth")
_SHOWN = ("psnr", "ssim", "smape")
_PAGE = """# Bilateral grids: what guides, scales and grids are worth

Written by `python -m stillray_training.grid_study {model} --validation VALIDATION --report
docs/grids.md`. The ablations of Meng et al. 2020, section 6.3, with the weights of {model} as they
are: each scale alone instead of the blend (their table 5), and the mean of the features as every
grid's guide instead of the learned ones. Nothing was trained for them anew, so they say what the
parts of this network do, not what a network without them could learn. PSNR, SSIM and SMAPE are the
mean of the last frames of the validation sequences, with exposure as in [results.md](results.md),
where the model stands beside the others.

Times are of the reconstruction alone, on made-up frames, medians of rounds in which all take turns
in one process; ratios are medians over the rounds (their figure 6; on their GPU three grids took
6.1 ms and kernels 1.1)."""
Change = Callable[[np.ndarray, np.ndarray], np.ndarray]  # features and maps to maps


class Changed:
    """An engine whose maps are replaced on their way to the grids.

    Parameters
    ----------
    engine
        As `stillray.Denoiser` runs it.
    change
        From features ``(planes, h, w)`` and maps ``(2 m - 1, h, w)`` to maps.
    """

    def __init__(self, engine: Engine, change: Change) -> None:
        self._engine = engine
        self._change = change

    def run(self, graph: str, inputs: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The replaced outputs."""
        ((name, maps),) = self._engine.run(graph, inputs).items()
        return {name: self._change(inputs["features"][0], maps)}

    def close(self) -> None:
        """Close the engine."""
        self._engine.close()


def changes(spec: ModelSpec) -> dict[str, Change]:
    """What is compared, by name."""
    assert isinstance(spec.decoder, BilateralGrids)
    count = spec.decoder.grids
    planes = [spec.network.features.index(name) for name in _AUXILIARY]

    def alone(scale: int) -> Change:
        def change(features: np.ndarray, maps: np.ndarray) -> np.ndarray:
            maps = maps.copy()
            maps[count:] = 0
            if scale < count - 1:
                maps[count + scale] = 1
            return maps

        return change

    def mean_guides(features: np.ndarray, maps: np.ndarray) -> np.ndarray:
        auxiliary = features[planes]
        auxiliary[3:6] = (auxiliary[3:6] + 1) / 2  # normals as the paper has them, in [0, 1]
        maps = maps.copy()
        maps[:count] = auxiliary.mean(0)
        return maps

    def mean_guide_alone(features: np.ndarray, maps: np.ndarray) -> np.ndarray:
        return alone(0)(features, mean_guides(features, maps))

    rows: dict[str, Change] = {"as trained": lambda features, maps: maps}
    if count > 1:
        rows |= {f"scale {scale} alone": alone(scale) for scale in range(count)}
        rows["mean of features, scale 0 alone"] = mean_guide_alone
    rows["mean of features as guides"] = mean_guides
    return rows


def ablations(model: str, folder: Path) -> dict[str, dict[str, float]]:
    """Mean scores of each change over the last frames of the scenes of a folder."""
    spec = find_model(model).spec
    rows: dict[str, list[dict[str, float]]] = {}
    with Denoiser(model) as plain:
        for scene in find_scenes(folder):
            paths, references = last_referenced(scene)
            frames = [read_exr(path) for path in paths]
            for name, change in changes(spec).items():
                with Denoiser(plain.model, engine=Changed(plain.engine, change)) as denoiser:
                    images = [denoiser.denoise(frame) for frame in frames]
                scores = metrics.evaluate(images[-1:], references[-1:])
                rows.setdefault(name, []).append(scores)
    return {
        name: {metric: float(np.mean([row[metric] for row in scores])) for metric in _SHOWN}
        for name, scores in rows.items()
    }


def times(model: str, height: int, width: int, rounds: int) -> dict[str, list[float]]:
    """Milliseconds of each reconstruction in each round, 1 to 3 grids and 1 to 6 kernels."""
    grids, fused = find_model(model).spec.decoder, find_model(KERNELS).spec.decoder
    assert isinstance(grids, BilateralGrids)
    assert isinstance(fused, FusedKernels)
    rng = np.random.default_rng(0)
    mean = rng.uniform(0.1, 1, (height, width, 4)).astype(np.float32)
    # as smooth as what networks give: places of neighbours in memory are near each other
    maps = np.stack(
        [cv2.GaussianBlur(rng.random((height, width), np.float32), (0, 0), 3) for _ in range(12)]
    )
    strips = Strips(available_threads())
    runs: dict[str, Callable[[], object]] = {}
    for count in (1, 2, 3):
        options = dataclasses.replace(grids, grids=count)
        runs[f"{count} grids"] = _grids_run(mean, maps, options, strips)
    for count in (1, 2, 4, 6):
        sizes = dataclasses.replace(fused, kernel_sizes=fused.kernel_sizes[-count:])
        runs[f"{count} kernels"] = _kernels_run(mean, maps, sizes, strips)
    for run in runs.values():
        run()
    taken: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(rounds):
        for name, run in runs.items():
            start = time.perf_counter()
            run()
            taken[name].append(1e3 * (time.perf_counter() - start))
    strips.close()
    return taken


def _grids_run(
    mean: np.ndarray, maps: np.ndarray, options: BilateralGrids, strips: Strips
) -> Callable[[], object]:
    own = maps[: 2 * options.grids - 1]
    return lambda: grid.filter_grids(mean, own, options, strips)


def _kernels_run(
    mean: np.ndarray, maps: np.ndarray, options: FusedKernels, strips: Strips
) -> Callable[[], object]:
    own, half = maps[: 2 * len(options.kernel_sizes)], max(options.kernel_sizes) // 2
    height, width = mean.shape[:2]

    def work(rows: slice) -> None:
        near = slice(max(rows.start - half, 0), min(rows.stop + half, height))
        inner = slice(rows.start - near.start, rows.stop - near.start)
        kernels.filter_rows(mean[near], own[:, near], inner, options, workspace=strips.workspace)

    return lambda: strips.run(work, height, width)


def grid_bytes(height: int, width: int, options: BilateralGrids) -> list[int]:
    """Bytes of each grid of a frame, four float32 channels a cell."""
    cells = [grid.grid_cells(height, width, options, scale) for scale in range(options.grids)]
    return [16 * int(np.prod(shape)) for shape in cells]


def _table(title: str, columns: Sequence[str], rows: Mapping[str, Sequence[float]]) -> str:
    lines = [f"| {title} | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    lines += [f"| {k} | " + " | ".join(f"{v:.4g}" for v in row) + " |" for k, row in rows.items()]
    return "\n".join(lines)


def main(
    model: Annotated[str, typer.Argument(help="Model with bilateral grids, or an .onnx.")],
    validation: Annotated[
        Path | None, typer.Option(help="Sequences with references: ablations too.")
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Markdown file to write.")] = None,
    height: Annotated[int, typer.Option(min=1)] = 720,
    width: Annotated[int, typer.Option(min=1)] = 1280,
    rounds: Annotated[int, typer.Option(min=1)] = 7,
) -> None:
    """Print the tables."""
    options = find_model(model).spec.decoder
    if not isinstance(options, BilateralGrids):
        raise InputError(f"model must be one with bilateral grids, got {model}")
    taken = times(model, height, width, rounds)
    full = taken["6 kernels"]
    rows = {
        name: [float(np.median(values)), float(np.median(np.array(values) / np.array(full)))]
        for name, values in taken.items()
    }
    megabytes = [f"{size / 1e6:.1f}" for size in grid_bytes(height, width, options)]
    parts = [
        f"## Time and memory, {width}x{height}",
        _table("reconstruction", ("median ms", "/ 6 kernels"), rows),
        f"Memory of the {options.grids} grids, MB: {', '.join(megabytes)}.",
    ]
    if validation is not None:
        scores = ablations(model, validation)
        table = _table("maps", _SHOWN, {name: list(row.values()) for name, row in scores.items()})
        parts = ["## Guides and scales", table, *parts]
    tables = "\n\n".join(parts)
    print(tables)
    if report is not None:
        with atomic_path(report) as temporary:
            temporary.write_text(f"{_PAGE.format(model=model)}\n\n{tables}\n")


if __name__ == "__main__":
    program.run(main)

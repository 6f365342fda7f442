"""``stillray-evaluate VALIDATION``: quality on everything there that has a reference."""

from __future__ import annotations

import json
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import track

from stillray.cli import program
from stillray.compare.metrics import METRICS
from stillray.errors import InputError
from stillray.frame import GUIDES
from stillray.io.atomic import atomic_path
from stillray.model_spec.decoders import MOST_ENSEMBLE
from stillray.models.registry import (
    ModelInfo,
    find_model,
    for_single_frames,
    list_models,
    qualities,
    with_overrides,
)
from stillray.pixel_filter import parse_filter
from stillray_training.evaluate.cases import KINDS, WITHHELD, Case, find_cases, titles
from stillray_training.evaluate.methods import NOISY, choose_peers, left_out
from stillray_training.evaluate.report import report as page
from stillray_training.evaluate.report import sections
from stillray_training.evaluate.scores import Results, evaluate_cases, taken_from
from stillray_training.peers import PEERS

UNTOLD = "none"
_PEER_NAMES = [peer.name for peer in PEERS if not peer.halves]
_METRIC_NAMES = [metric.name for metric in METRICS]
_WIDEST_FILM = 1.0  # pixels; `stillray_training.film` reaches two


def main(
    folders: Annotated[
        list[str], typer.Argument(help="FOLDER or LABEL=FOLDER of frames with references.")
    ],
    model: Annotated[
        list[str] | None,
        typer.Option(help="Model, .onnx, or LABEL=one of them; repeatable; default: all."),
    ] = None,
    ensemble: Annotated[
        int,
        typer.Option(
            min=1,
            max=MOST_ENSEMBLE,
            help="Run each model as an ensemble of so many too, where it can.",
        ),
    ] = 1,
    peer: Annotated[
        list[str] | None,
        typer.Option(help=f"{', '.join(_PEER_NAMES)}; repeatable; default: installed."),
    ] = None,
    peers: Annotated[bool, typer.Option(help="Run peers at all.")] = True,
    peers_from: Annotated[
        Path | None, typer.Option(help="JSON of a former --out: rows of peers from there.")
    ] = None,
    only: Annotated[
        str | None, typer.Option(help=f"Sets, out of {','.join(KINDS)}; default: all.")
    ] = None,
    stills: Annotated[
        str | None, typer.Option(help="Samples a pixel of the stills, such as 4,16; default: all.")
    ] = None,
    pixel_filter: Annotated[
        str | None,
        typer.Option(
            help="Of frames whose files do not say: box, ..., as stillray denoise's; or none: "
            "models are not told what files say, either."
        ),
    ] = None,
    film: Annotated[
        float,
        typer.Option(
            help="Standard deviation in pixels of a Gaussian film that frames and references go "
            "through, whose samples count in several pixels, as Mitsuba's of 0.5; 0: none."
        ),
    ] = 0.0,
    without: Annotated[
        str | None,
        typer.Option(help=f"Buffers to keep from all, out of {','.join(WITHHELD)}; default: none."),
    ] = None,
    metrics: Annotated[
        str | None, typer.Option(help=f"Out of {','.join(_METRIC_NAMES)}; default: all but rmse.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Write scores as JSON.")] = None,
    report: Annotated[Path | None, typer.Option(help="Write the tables as Markdown.")] = None,
    pictures: Annotated[Path | None, typer.Option(help="Folder for tone-mapped PNGs.")] = None,
) -> None:
    """Print every set's metrics, and where a model's picture is worse than its input."""
    kept_back = withheld(without)
    guided = not set(GUIDES) <= set(kept_back)
    alone = {for_single_frames(quality, guided=guided) for quality in qualities()}
    given = model or [*(info.name for info in list_models()), *sorted(alone)]
    models = with_ensembles(
        {text.split("=")[0]: find_model(text.split("=")[-1]) for text in given}, ensemble
    )
    named = peer if peers else []
    chosen = choose_peers(named)
    names = _listed(metrics, "metrics", _METRIC_NAMES) if metrics else None
    if line := left_out(named):
        print(line, file=sys.stderr)
    cases = find_all(
        folders,
        _listed(only, "only", KINDS) if only else KINDS,
        _counts(stills) if stills else None,
        pixel_filter,
        film,
        kept_back,
    )
    results = evaluate_cases(
        cases, models, peers=chosen, names=names, pictures=pictures, progress=_shown
    )
    if peers_from:
        labels = {NOISY, *(one.label for one in PEERS)}
        taken_from(results, _read(peers_from), labels, names)
    kinds = titles(cases)
    print(sections(results, kinds, models))
    if report:
        with atomic_path(report) as temporary:
            temporary.write_text(page(results, kinds, models))
    if out:
        with atomic_path(out) as temporary:
            temporary.write_text(json.dumps(results, indent=1))


def with_ensembles(models: Mapping[str, ModelInfo], ensemble: int) -> dict[str, ModelInfo]:
    """Models by label, and after each that can, itself as an ensemble."""
    found: dict[str, ModelInfo] = {}
    for label, info in models.items():
        found[label] = info
        if 1 < ensemble <= info.spec.decoder.most_ensemble:
            found[f"{label}, ensemble of {ensemble}"] = with_overrides(info, ensemble=ensemble)
    return found


def find_all(
    folders: Sequence[str],
    kinds: Collection[str] = KINDS,
    counts: Collection[int] | None = None,
    pixel_filter: str | None = None,
    film: float = 0.0,
    without: Sequence[str] = (),
) -> list[Case]:
    """Cases of several folders, each ``FOLDER`` or ``LABEL=FOLDER``, see `find_cases`.

    ``pixel_filter`` is that of frames whose files do not say, see `parse_filter`; ``none`` keeps
    from models what files say, too. ``film`` and ``without`` are `Case`'s.
    """
    if not 0 <= film <= _WIDEST_FILM:
        raise InputError(f"film must be 0 to {_WIDEST_FILM:g} pixels, got {film:g}")
    tells = pixel_filter != UNTOLD
    spread = parse_filter(pixel_filter) if pixel_filter and tells else None
    cases: list[Case] = []
    for text in folders:
        label, _, folder = text.rpartition("=")
        if not Path(folder).is_dir():
            raise InputError(f"folder must exist, got {folder}")
        cases += find_cases(Path(folder), label=label, kinds=kinds, counts=counts)
    return [
        replace(
            case, filter_spread=spread, tells_filter=tells, film=film, without=tuple(without)
        )
        for case in cases
    ]  # fmt: skip


def withheld(text: str | None) -> list[str]:
    """Buffers that are listed as ``--without`` takes them."""
    return _listed(text, "without", WITHHELD) if text else []


def _listed(text: str, option: str, allowed: Collection[str]) -> list[str]:
    names = text.split(",")
    for name in names:
        if name not in allowed:
            raise InputError(f"{option} must be out of {', '.join(allowed)}, got {name}")
    return names


def _counts(text: str) -> list[int]:
    if not all(part.isdecimal() for part in text.split(",")):
        raise InputError(f"stills must be numbers such as 4,16, got {text}")
    return [int(part) for part in text.split(",")]


def _read(path: Path) -> Results:
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise InputError(
            f"peers-from must be a file that --out wrote, got {path}: {error}"
        ) from None


def _shown(cases: Sequence[Case]) -> Iterable[Case]:
    return track(cases, "frames", console=Console(stderr=True))


if __name__ == "__main__":
    program.run(main)

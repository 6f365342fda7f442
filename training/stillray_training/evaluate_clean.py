"""``python -m stillray_training.evaluate_clean FOLDER``: quality on input of 64 samples a pixel.

``docs/simulator.md`` says how the sequences are rendered.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import track

from stillray.cli import program
from stillray.io.exr.read_write import atomic_path
from stillray.models.registry import find_model, list_models
from stillray_training.evaluate import (
    choose_peers,
    evaluate_folder,
    find_scenes,
    last_referenced,
    markdown,
)

_FOR_CLEAN = ("nbg-7x3",)  # models that were trained on 64 samples a pixel
_OTHERS = ("nbg-2x3", "wskp-mr", "wskp-6", "kpyr-5")
_PEERS = ("oidn-high",)


def head(folder: Path, models: Sequence[str]) -> str:
    """What the tables show, with the sizes that the folder has.

    Parameters
    ----------
    folder
        Sequences with references.
    models
        Names of the specifications of the models that are compared.
    """
    runs = [last_referenced(scene) for scene in find_scenes(folder)]
    counts = " or ".join(str(count) for count in sorted({len(paths) for paths, _ in runs}))
    height, width = runs[0][1][-1].shape[:2]
    clean = [name for name in models if name in _FOR_CLEAN]
    trained = f"Only {clean[0]} was trained on such frames" if clean else "No model was"
    trained += ", the others for one sample." if clean else " trained on such frames."
    return f"""# Quality at 64 samples a pixel

Written by `python -m stillray_training.evaluate_clean FOLDER --report docs/results-64spp.md`;
`docs/simulator.md` says how the folder is rendered. Last frame of each sequence, {width}x{height},
64 samples a pixel; frames a sequence: {counts}. Metrics and exposure as in `docs/results.md`.
References have 1024 samples a pixel: 16 times the input, not more. No model was trained on these
scenes. {trained} OIDN is
Open Image Denoise with albedo and normal, fed the raw frame, or the frame as accumulated.

"""


def main(
    folder: Annotated[Path, typer.Argument(help="Folder of sequences with references.")],
    model: Annotated[
        list[str] | None, typer.Option(help="Model or .onnx; repeatable; default: a choice.")
    ] = None,
    peer: Annotated[
        list[str] | None, typer.Option(help="Repeatable; default: oidn-high if installed.")
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Write the tables as Markdown.")] = None,
    pictures: Annotated[Path | None, typer.Option(help="Folder for tone-mapped PNGs.")] = None,
) -> None:
    """Print metrics per scene and their means."""
    shipped = {info.name for info in list_models()}
    given = model or [name for name in (*_FOR_CLEAN, *_OTHERS) if name in shipped]
    models = {find_model(name).name: name for name in given}
    title = head(folder, list(models))
    scores = evaluate_folder(
        folder,
        models,
        peers=choose_peers(peer) if peer else [p for p in _PEERS if p in choose_peers(None)],
        pictures=pictures,
        progress=lambda scenes: track(scenes, "scenes", console=Console(stderr=True)),
    )
    print(markdown(scores))
    if report:
        with atomic_path(report) as temporary:
            temporary.write_text(title + markdown(scores))


if __name__ == "__main__":
    program.run(main)

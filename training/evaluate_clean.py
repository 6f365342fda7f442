"""``python -m stillray.training.evaluate_clean FOLDER``: quality on input of 64 samples a pixel.

``docs/simulator.md`` says how the sequences are rendered. The models that are compared were trained
for one sample, but for `MODEL`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import track

from stillray.cli import program
from stillray.exr import atomic_path
from stillray.registry import find_model
from stillray.training.evaluate import evaluate_folder, find_scenes, last_referenced, markdown

MODEL = "nbg-7x3"
_OTHERS = ("nbg-2x3", "wskp-6", "kpyr-5")
_PEERS = ("oidn-high",)


def head(folder: Path) -> str:
    """What the tables show, with the sizes that the folder has."""
    runs = [last_referenced(scene) for scene in find_scenes(folder)]
    frames = sorted({len(paths) for paths, _ in runs})
    height, width = runs[0][1][-1].shape[:2]
    count = " or ".join(map(str, frames))
    model = find_model(MODEL)
    training = model.provenance
    data = ", ".join(f"{scene} {n}" for scene, n in training["data"].items())
    origin = training["started_from"]
    return f"""# Quality at 64 samples a pixel

Written by `python -m stillray.training.evaluate_clean FOLDER --report docs/results-64spp.md`;
`docs/simulator.md` says how the folder is rendered. Last frame of each sequence, {width}x{height},
64 samples a pixel, {count} frame{"" if frames == [1] else "s"} a sequence; metrics and exposure
as in `docs/results.md`. References have 1024 samples a pixel: 16 times the input, not more.
No model was trained on these scenes.

Only {MODEL} was trained on 64 samples a pixel: {training["steps"]} steps, begun with the weights of
{origin["model"]}, on the last frames of procedural sequences ({data}), whose references have 256
samples a pixel. The others were trained for one sample. OIDN is Open Image Denoise with albedo and
normal, fed the raw frame, or the frame as accumulated for our kernels.

"""


def main(
    folder: Annotated[Path, typer.Argument(help="Folder of sequences with references.")],
    report: Annotated[Path | None, typer.Option(help="Write the tables as Markdown.")] = None,
    pictures: Annotated[Path | None, typer.Option(help="Folder for tone-mapped PNGs.")] = None,
) -> None:
    """Print metrics per scene and their means."""
    title = head(folder)
    scores = evaluate_folder(
        folder,
        {name: name for name in (MODEL, *_OTHERS)},
        peers=_PEERS,
        pictures=pictures,
        progress=lambda scenes: track(scenes, "scenes", console=Console(stderr=True)),
    )
    print(markdown(scores))
    if report:
        with atomic_path(report) as temporary:
            temporary.write_text(title + markdown(scores))


if __name__ == "__main__":
    program.run(main)

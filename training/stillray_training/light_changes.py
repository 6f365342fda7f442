"""``python -m stillray_training.light_changes FOLDER``: where the past is let go for its light.

Of sequences whose light stands still it says how often noise is taken for a change.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.progress import track

from stillray.arrays.strips import Strips
from stillray.cli import program
from stillray.io.exr.read import read_exr
from stillray.model_spec import load
from stillray.stages.prepare import prepare
from stillray.stages.state import History
from stillray_training.blocks import frame_paths


def main(
    folders: Annotated[list[Path], typer.Argument(help="Folders of sequences.")],
) -> None:
    """List the frames that lose some of their past, and how much of the picture does."""
    spec, strips = load("wskp-3"), Strips(1)
    sequences = [path for folder in folders for path in sorted(folder.iterdir()) if path.is_dir()]
    total = 0
    lost: list[tuple[str, float]] = []
    for sequence in track(sequences, description="sequences", transient=True):
        history: History | None = None
        for path in frame_paths(sequence):
            prepared = prepare(read_exr(path), spec, history, strips)
            history = prepared.history
            total += 1
            if (kept := prepared.history_confidence) is not None:
                lost.append((f"{sequence.name}/{path.name}", 1 - float(kept.mean())))
    print(f"{len(lost)} of {total} frames lost some of their past")
    for name, share in lost:
        print(f"{name}: {100 * share:.2f} %")


if __name__ == "__main__":
    program.run(main)

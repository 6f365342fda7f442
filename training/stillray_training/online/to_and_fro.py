"""Cameras of the validation scenes, to and fro: as many frames as learning takes to be seen.

``python -m stillray_training.online.to_and_fro VALIDATION/bathroom/scene.json cameras.json`` writes
what ``stillray-simulate --cameras`` takes. Every camera is one of the scene's own, so that its
references, of more samples than a new rendering would have, are those of many frames.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from stillray.cli import program
from stillray.errors import InputError


def to_and_fro(frames: int, cameras: int) -> list[int]:
    """Which camera each frame has: back and forth through all, the last one at the end.

    Parameters
    ----------
    frames
        How many are wanted.
    cameras
        How many there are, two or more.
    """
    period = 2 * (cameras - 1)
    steps = ((frames - 1 - frame) % period for frame in range(frames))
    return [cameras - 1 - min(step, period - step) for step in steps]


def main(
    scene: Annotated[Path, typer.Argument(help="JSON with the cameras of a few frames.")],
    out: Annotated[Path, typer.Argument(help="JSON to write.")],
    frames: Annotated[int, typer.Option(help="How many cameras to write.")] = 30,
) -> None:
    """Write cameras that go to and fro."""
    try:
        record = json.loads(scene.read_text(encoding="utf-8"))
        given = record.get("cameras") or record["frames"]
        poses = [entry["camera_to_world"] for entry in given]
        fov = given[0].get("fov_x_deg", record.get("fov_x_deg"))
    except (OSError, ValueError, KeyError, AttributeError):
        raise InputError(f"scene must be a readable JSON file with cameras, got {scene}") from None
    if len(poses) < 2:
        raise InputError(f"scene must hold two cameras or more, got {len(poses)} in {scene}")
    cameras = [
        {"camera_to_world": poses[index], "fov_x_deg": fov}
        for index in to_and_fro(frames, len(poses))
    ]
    out.write_text(json.dumps({"cameras": cameras}, indent=1), encoding="utf-8")


if __name__ == "__main__":
    program.run(main)

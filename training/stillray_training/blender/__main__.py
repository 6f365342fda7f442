"""``python -m stillray_training.blender FOLDER``: render the validation scenes of Blender.

Sequences go to ``<scene>/frame_0000.exr``, ..., stills to ``spp/<scene>/<samples a pixel>``, and
references of both to ``<scene>/ref_0000.exr``, ...; files are as Blender writes them, multilayer.
What is there already is kept.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

from stillray_training.blender import interior, moving_shadow, objects
from stillray_training.blender.cycles import prepare, render

_STILL_SAMPLES = (1, 4, 16, 64)
_SEQUENCE_SAMPLES, _FRAMES = 2, 8
_STILL_SEED, _REFERENCE_SEED = 100, 1000  # no two files of a frame share their noise


def render_stills(folder: Path, scene: str, frame: int) -> None:
    """One frame at every number of samples."""
    for place, count in enumerate(_STILL_SAMPLES):
        path = folder / "spp" / scene / str(count) / f"frame_{frame:04d}.exr"
        render(path, frame=frame, samples=count, seed=_STILL_SEED + place)


def render_sequence(folder: Path, scene: str) -> None:
    """All frames of the scene that is built."""
    for frame in range(_FRAMES):
        path = folder / scene / f"frame_{frame:04d}.exr"
        render(path, frame=frame, samples=_SEQUENCE_SAMPLES, seed=frame)


def render_references(folder: Path, scene: str, frames: Sequence[int], samples: int) -> None:
    """What some frames should be."""
    for frame in frames:
        path = folder / scene / f"ref_{frame:04d}.exr"
        render(path, frame=frame, samples=samples, seed=_REFERENCE_SEED + frame)


def render_moving_shadow(folder: Path) -> None:
    """A sequence with a reference for every frame."""
    prepare((320, 180))
    moving_shadow.build(_FRAMES)
    render_sequence(folder, "moving_shadow")
    render_references(folder, "moving_shadow", range(_FRAMES), 256)


def render_objects(folder: Path) -> None:
    """Stills of one frame."""
    prepare((384, 216))
    objects.build()
    render_stills(folder, "objects", 0)
    render_references(folder, "objects", [0], 512)


def render_interior(folder: Path) -> None:
    """A sequence whose last two frames have references, and stills of the last."""
    prepare((384, 216))
    interior.build()
    interior.move(_FRAMES)
    render_sequence(folder, "interior")
    render_stills(folder, "interior", _FRAMES - 1)
    render_references(folder, "interior", [_FRAMES - 1, _FRAMES - 2], 384)


SCENES: dict[str, Callable[[Path], None]] = {
    "moving_shadow": render_moving_shadow,
    "objects": render_objects,
    "interior": render_interior,
}


def main() -> None:
    """Render the scenes that are named, or all."""
    parser = argparse.ArgumentParser(description="Render the validation scenes of Blender.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--scene", action="append", choices=SCENES, help="default: all")
    given = parser.parse_args()
    for name in given.scene or SCENES:
        SCENES[name](given.folder.resolve())


if __name__ == "__main__":
    main()

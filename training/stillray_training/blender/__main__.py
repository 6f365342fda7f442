"""``python -m stillray_training.blender FOLDER``: render the validation scenes of Blender.

Stills go to ``<scene>/<samples a pixel>/frame_0000.exr`` with ``<scene>/ref_0000.exr``,
sequences to ``<scene>/frame_0000.exr``, ... with ``<scene>/ref_0000.exr``, ...; files are as
Blender writes them, multilayer. What is there already is kept.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from stillray_training.blender import interior, moving_shadow, objects
from stillray_training.blender.cycles import prepare, render

_STILL_SAMPLES = (1, 4, 16, 64)
_SEQUENCE_SAMPLES, _FRAMES = 2, 8
_REFERENCE_SEED = 1000  # references share no noise with the frames, whose seeds are smaller


def render_still(folder: Path, build: Callable[[], None], samples: int) -> None:
    """One view at every number of samples, and its reference of ``samples``."""
    prepare((480, 270))
    build()
    for seed, count in enumerate(_STILL_SAMPLES):
        render(folder / str(count) / "frame_0000.exr", frame=0, samples=count, seed=seed)
    render(folder / "ref_0000.exr", frame=0, samples=samples, seed=_REFERENCE_SEED)


def render_sequence(folder: Path, referenced: range, samples: int) -> None:
    """All frames of the scene that is built, and the references of some."""
    for frame in range(_FRAMES):
        path = folder / f"frame_{frame:04d}.exr"
        render(path, frame=frame, samples=_SEQUENCE_SAMPLES, seed=frame)
    for frame in referenced:
        path = folder / f"ref_{frame:04d}.exr"
        render(path, frame=frame, samples=samples, seed=_REFERENCE_SEED + frame)


def render_moving_shadow(folder: Path) -> None:
    """The sequence with a moving shadow; every frame has its reference."""
    prepare((320, 180))
    moving_shadow.build(_FRAMES)
    render_sequence(folder, range(_FRAMES), 256)


def render_camera_move(folder: Path) -> None:
    """The camera moves through the interior; the last two frames have references."""
    prepare((480, 270))
    interior.build()
    interior.move(_FRAMES)
    render_sequence(folder, range(_FRAMES - 2, _FRAMES), 512)


SCENES: dict[str, Callable[[Path], None]] = {
    "moving_shadow": render_moving_shadow,
    "interior": lambda folder: render_still(folder, interior.build, 1024),
    "objects": lambda folder: render_still(folder, objects.build, 1024),
    "interior_move": render_camera_move,
}


def main() -> None:
    """Render the scenes that are named, or all."""
    parser = argparse.ArgumentParser(description="Render the validation scenes of Blender.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--scene", action="append", choices=SCENES, help="default: all")
    given = parser.parse_args()
    for name in given.scene or SCENES:
        SCENES[name](given.folder.resolve() / name)


if __name__ == "__main__":
    main()

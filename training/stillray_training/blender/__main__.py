"""``python -m stillray_training.blender FOLDER``: render the validation scenes of Blender.

Sequences go to ``<scene>/frame_0000.exr``, ..., stills to ``spp/<scene>/<samples a pixel>``, and
references of both to ``<scene>/ref_0000.exr``, ...; files are as Blender writes them, multilayer.
What is there already is kept. ``--noise-seed 500`` renders frames of sequences again, with noise of
their own and nothing beside: second halves, for another folder, or with ``--samples 16`` frames as
animations have them. What a camera does, its lens wide open or its shutter, and what few scenes
have (grass, a night, haze) is rendered where ``--scene`` names it, for folders of their own.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import ModuleType

import bpy

from stillray_training.blender import (
    desk,
    hall,
    interior,
    meadow,
    moving_shadow,
    objects,
    pool,
    street,
)
from stillray_training.blender.cycles import prepare, render
from stillray_training.blender.lens import open_lens

_STILL_SAMPLES = (1, 4, 16, 64)
_SEQUENCE_SAMPLES, _FRAMES = 2, 8
_STILL_SEED, _REFERENCE_SEED = 100, 1000  # no two files of a frame share their noise


def render_stills(folder: Path, scene: str, frame: int) -> None:
    """One frame at every number of samples."""
    for place, count in enumerate(_STILL_SAMPLES):
        path = folder / "spp" / scene / str(count) / f"frame_{frame:04d}.exr"
        render(path, frame=frame, samples=count, seed=_STILL_SEED + place)


def render_sequence(
    folder: Path, scene: str, noise_seed: int = 0, samples: int = _SEQUENCE_SAMPLES
) -> None:
    """All frames of the scene that is built; the seed is that of the first one's noise."""
    for frame in range(_FRAMES):
        path = folder / scene / f"frame_{frame:04d}.exr"
        render(path, frame=frame, samples=samples, seed=noise_seed + frame)


def render_references(folder: Path, scene: str, frames: Sequence[int], samples: int) -> None:
    """What some frames should be."""
    for frame in frames:
        path = folder / scene / f"ref_{frame:04d}.exr"
        render(path, frame=frame, samples=samples, seed=_REFERENCE_SEED + frame)


def build_moving_shadow() -> None:
    """The scene of a sequence with a reference for every frame."""
    prepare((320, 180))
    moving_shadow.build(_FRAMES)


def render_moving_shadow(folder: Path) -> None:
    """All of it."""
    build_moving_shadow()
    render_sequence(folder, "moving_shadow")
    render_references(folder, "moving_shadow", range(_FRAMES), 256)


def render_objects(folder: Path) -> None:
    """Stills of one frame."""
    prepare((384, 216))
    objects.build()
    render_stills(folder, "objects", 0)
    render_references(folder, "objects", [0], 512)


def build_interior() -> None:
    """The scene of a sequence whose last two frames have references, and stills of the last."""
    prepare((384, 216))
    interior.build()
    interior.move(_FRAMES)


def render_interior(folder: Path) -> None:
    """All of it."""
    build_interior()
    render_sequence(folder, "interior")
    render_stills(folder, "interior", _FRAMES - 1)
    render_references(folder, "interior", [_FRAMES - 1, _FRAMES - 2], 384)


def render_shallow_objects(folder: Path) -> None:
    """The still life through a lens wide open, the wall behind it 12 pixels out of focus."""
    prepare((384, 216))
    objects.build()
    open_lens(3.6, 30)
    render_stills(folder, "shallow_objects", 0)
    render_references(folder, "shallow_objects", [0], 512)


def render_shallow_interior(folder: Path) -> None:
    """The room through such a lens, the table in focus."""
    build_interior()
    open_lens(3.3, 30)
    render_sequence(folder, "shallow_interior")
    render_stills(folder, "shallow_interior", _FRAMES - 1)
    render_references(folder, "shallow_interior", [_FRAMES - 1, _FRAMES - 2], 384)


def render_blurred_cube(folder: Path) -> None:
    """The cube and its shadow, 14 pixels long for the shutter being open for two frames."""
    build_moving_shadow()
    scene = bpy.context.scene
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 2.0
    render_stills(folder, "blurred_cube", 3)
    render_references(folder, "blurred_cube", [3], 512)


def name_of(place: ModuleType) -> str:
    """What a scene is called, of which there is a module."""
    return place.__name__.rpartition(".")[2]


def render_effect(place: ModuleType, folder: Path) -> None:
    """A sequence whose camera moves, whose last two frames have references, and stills."""
    scene = name_of(place)
    prepare((384, 216))
    place.build()
    place.move(_FRAMES)
    render_sequence(folder, scene)
    render_stills(folder, scene, _FRAMES - 1)
    render_references(folder, scene, [_FRAMES - 1], 512)
    render_references(folder, scene, [_FRAMES - 2], 384)


SCENES: dict[str, Callable[[Path], None]] = {
    "moving_shadow": render_moving_shadow,
    "objects": render_objects,
    "interior": render_interior,
}
CAMERA: dict[str, Callable[[Path], None]] = {
    "shallow_objects": render_shallow_objects,
    "shallow_interior": render_shallow_interior,
    "blurred_cube": render_blurred_cube,
}
EFFECTS: dict[str, Callable[[Path], None]] = {
    name_of(place): partial(render_effect, place) for place in (meadow, street, hall, pool, desk)
}
EVERY = {**SCENES, **CAMERA, **EFFECTS}
SEQUENCES = {"moving_shadow": build_moving_shadow, "interior": build_interior}


def main() -> None:
    """Render the scenes that are named, or all."""
    parser = argparse.ArgumentParser(description="Render the validation scenes of Blender.")
    parser.add_argument("folder", type=Path)
    parser.add_argument(
        "--scene",
        action="append",
        choices=list(EVERY),
        help="default: moving_shadow, objects and interior",
    )
    parser.add_argument("--noise-seed", type=int, help="frames of sequences alone, of this seed on")
    parser.add_argument("--samples", type=int, help="a pixel of those frames, 1 or more")
    given = parser.parse_args()
    samples = _SEQUENCE_SAMPLES if given.samples is None else given.samples
    if given.samples is not None and given.noise_seed is None:
        parser.error(f"samples goes with noise-seed, got {samples} without one")
    if samples < 1:
        parser.error(f"samples must be 1 or more, got {samples}")
    folder = given.folder.resolve()
    if given.noise_seed is None:
        for name in given.scene or SCENES:
            EVERY[name](folder)
        return
    for name in given.scene or SEQUENCES:
        if name not in SEQUENCES:
            parser.error(f"noise-seed is for one of {', '.join(SEQUENCES)}, got {name}")
        SEQUENCES[name]()
        render_sequence(folder, name, given.noise_seed, samples)


if __name__ == "__main__":
    main()

"""``python -m stillray_training.blender.show FOLDER``: a small show in a look of its own.

Shots of `stillray_training.blender.neon`: ``noisy/s000.0000.exr``, ... as Blender writes them, and
``clean/s000.0007.exr``, the reference of every eighth frame. What is there already is kept. The
same shots with another ``--noise-seed``, in another folder, are second halves of their samples.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from stillray_training.blender import neon
from stillray_training.blender.cycles import prepare, render

_REFERENCE_SEED = 1000  # input and reference share no noise


def main() -> None:
    """Render shots of consecutive seeds, one after the other."""
    parser = argparse.ArgumentParser(description="Render a small show with Cycles.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--shots", type=int, default=8)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--frames", type=int, default=8, help="frames of a shot")
    parser.add_argument("--size", type=int, default=160, help="width and height in pixels")
    parser.add_argument("--samples", type=int, default=4, help="of noisy frames, a pixel")
    parser.add_argument("--reference", type=int, default=128, help="samples of references")
    parser.add_argument("--noise-seed", type=int, default=0, help="of the noise of frame 0")
    given = parser.parse_args()
    last = given.noise_seed + given.frames
    if given.noise_seed < 0 or last > _REFERENCE_SEED:
        parser.error(f"noise-seed and frames must sum to {_REFERENCE_SEED} at most, got {last}")
    folder = given.folder.resolve()
    for shot in range(given.first_seed, given.first_seed + given.shots):
        scene = prepare((given.size, given.size))
        scene.cycles.use_light_tree = False  # in fog it costs more than it takes of the noise
        neon.build(shot, given.frames)
        for frame in range(given.frames):
            name = f"s{shot:03d}.{frame:04d}.exr"
            seed = given.noise_seed + frame
            render(folder / "noisy" / name, frame=frame, samples=given.samples, seed=seed)
            if frame % 8 == 7:
                seed = _REFERENCE_SEED + frame
                render(folder / "clean" / name, frame=frame, samples=given.reference, seed=seed)


if __name__ == "__main__":
    main()

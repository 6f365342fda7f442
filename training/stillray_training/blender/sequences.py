"""``python -m stillray_training.blender.sequences FOLDER``: Cycles renders to learn from.

Each scene gives 8 frames, blocks of further samples of the last, and its reference, multilayer as
Blender writes them; ``stillray_training.cycles_sequences`` makes training's sequences of them.
What is there already is kept, so a run can be taken up again.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
from pathlib import Path

import bpy

from stillray_training.blender.cycles import prepare, render
from stillray_training.blender.generated import KINDS, build
from stillray_training.blender.record import RECORD, TAKEN

FRAMES = 8
BLOCKS = (1, 2, 4, 8, 16)  # samples a pixel of the blocks beside the last frame
_BLOCK_SEED, _REFERENCE_SEED = 100, 1000  # no two files share their noise
_ROOMS = 0.5  # share of the scenes that are rooms
_PANELLED = 0.4  # and of those, of rooms full of painted joinery
_BOX = 0.5  # share with a box filter, as other renderers have
_TABLES = 0.6  # and of the others that are things on a table
_NOISE = 0.01  # of a reference's pixel, at which it takes no more samples: Cycles' own


def render_scene(folder: Path, seed: int, given: argparse.Namespace) -> None:
    """All files of one scene.

    Parameters
    ----------
    folder
        Where they go, made if missing.
    seed
        Of scene and settings.
    given
        Arguments of the command.
    """
    if (folder / RECORD).exists():
        return
    drawn = random.Random(seed)
    others = 1 - given.rooms
    odds = {
        "cycles_room": given.rooms * (1 - given.panelled),
        "cycles_table": others * _TABLES,
        "cycles_outdoors": others * (1 - _TABLES),
        "cycles_panelled": given.rooms * given.panelled,
    }
    kind = drawn.choices(list(KINDS), [odds[name] for name in KINDS])[0]
    size = given.size
    scene = prepare((size, size))
    scene.cycles.filter_width = drawn.choice((1.5, 1.5, 1.5, 1.0, 2.0))
    if random.Random(f"filter {seed}").random() < given.box:
        scene.cycles.pixel_filter_type = "BOX"
    scene.cycles.sample_clamp_indirect = drawn.choice((10.0, 10.0, 3.0, 30.0))
    scene.cycles.caustics_reflective = scene.cycles.caustics_refractive = drawn.random() < 0.5
    samples = drawn.choice((1, 1, 2, 4))
    used = build(kind, seed, given.assets, FRAMES)
    last = FRAMES - 1
    for frame in range(FRAMES):
        render(folder / f"frame_{frame:04d}.exr", frame=frame, samples=samples, seed=frame)
    for index, count in enumerate(BLOCKS):
        path = folder / f"block_{index:02d}.exr"
        render(path, frame=last, samples=count, seed=_BLOCK_SEED + index)
    path = folder / f"ref_{last:04d}.exr"
    render(path, frame=last, samples=given.reference, seed=_REFERENCE_SEED, noise=_NOISE)
    record = {
        "scene": kind, "seed": seed, "frames": FRAMES, "spp": samples, "blocks": BLOCKS,
        "reference_spp": given.reference, "height": size, "width": size, "used": used,
        "filter": scene.cycles.pixel_filter_type, "clamp": scene.cycles.sample_clamp_indirect,
        "blender": bpy.app.version_string,
    }  # fmt: skip
    (folder / RECORD).write_text(json.dumps(record, indent=1))


def main() -> None:
    """Render scenes of consecutive seeds."""
    parser = argparse.ArgumentParser(description="Render scenes to learn from with Cycles.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=100, help="scenes")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--size", type=int, default=192, help="width and height in pixels")
    parser.add_argument("--reference", type=int, default=512, help="most samples a pixel")
    parser.add_argument("--rooms", type=float, default=_ROOMS, help="share of scenes, [0, 1]")
    parser.add_argument(
        "--panelled", type=float, default=_PANELLED, help="of rooms, with joinery, [0, 1]"
    )
    parser.add_argument("--box", type=float, default=_BOX, help="share with a box filter, [0, 1]")
    parser.add_argument("--assets", type=Path, help="folder of licensed objects")
    given = parser.parse_args()
    for seed in range(given.first_seed, given.first_seed + given.count):
        folder = given.folder.resolve() / f"{seed:05d}"
        if (folder / TAKEN).exists():
            continue
        render_scene(folder, seed, given)
        left = shutil.disk_usage(folder).free
        if left < 2 << 30:
            raise SystemExit(f"{folder}: disk full but for {left >> 20} MiB")


if __name__ == "__main__":
    main()

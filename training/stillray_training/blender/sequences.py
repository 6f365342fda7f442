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
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import bpy

from stillray_training.blender.cycles import prepare, render
from stillray_training.blender.fur import grow
from stillray_training.blender.generated import KINDS, build
from stillray_training.blender.haze import fill
from stillray_training.blender.lamps import light_up
from stillray_training.blender.leaves import hang
from stillray_training.blender.lens import open_somewhere
from stillray_training.blender.night import fall
from stillray_training.blender.record import RECORD, TAKEN
from stillray_training.blender.relief import emboss_all
from stillray_training.blender.slender import scatter

FRAMES = 8
#: Samples a pixel of the blocks beside the last frame: many of few, since networks learn the noise
#: of those few frames by heart that can be made of few blocks.
BLOCKS = (1, 2, 4, 8, 16, 1, 1, 1, 2, 2, 4, 8)
_BLOCK_SEED, _REFERENCE_SEED = 100, 1000  # no two files share their noise
_ROOMS = 0.5  # share of the scenes that are rooms
_PANELLED = 0.4  # and of those, of rooms full of painted joinery
_RELIEF = 0.0  # share whose surfaces have one color and relief
_SLENDER = 0.0  # share with thin things and glasses stood about
_LAMPS = 0.0  # share with small lamps in view
_FUR = 0.0  # share with hair, fur and lawns on what is seen
_LEAVES = 0.0  # share with foliage before what is seen
_NIGHT = 0.0  # share at night, with many lamps
_HAZE = 0.0  # share in haze
_SHALLOW = 0.0  # share whose lens is wide open
_BACKLIT = 0.0  # and of the others, of rooms that are looked at against their windows
_MANY = 0.0  # share whose frames have many samples
_MOTION = 1.0  # cameras move up to so many times as far
_BOX = 0.5  # share with a box filter, as other renderers have
_TABLES = 0.6  # and of the others that are things on a table
#: What shares of scenes have besides, in the order in which it is built.
EFFECTS: dict[str, Callable[[random.Random], None]] = {
    "relief": emboss_all,
    "slender": scatter,
    "fur": grow,
    "leaves": hang,
    "night": fall,
    "lamps": light_up,
    "haze": fill,
    "shallow": open_somewhere,
}
_MANY_SAMPLES = (8, 16, 32, 64)
_NOISE = 0.01  # of a reference's pixel, at which it takes no more samples: Cycles' own


@dataclass(frozen=True, kw_only=True)
class Options:
    """What scenes are drawn from, and how they are rendered.

    Attributes
    ----------
    size
        Width and height, pixels.
    reference
        Most samples a pixel of references.
    rooms, panelled, backlit, box, relief, slender, fur, leaves, night, lamps, haze, shallow, many
        Shares, [0, 1]: of scenes that are rooms, of rooms full of painted joinery, of other rooms
        that are looked at against their windows, of scenes rendered with a box filter, of scenes
        most of whose surfaces have one color and relief that only normals show, of scenes with
        thin things and glasses stood about, with hair and lawns, with foliage, of scenes at
        night, with small lamps in view, in haze, seen through a lens that is wide open, and of
        scenes whose frames have 8 to 64 samples a pixel where others have 1 to 4.
    motion
        Cameras move 1 to this many times as far as usual, 1 or more.
    assets
        Folder of licensed objects; None for none.

    Raises
    ------
    ValueError
        One is out of its range.
    """

    size: int = 192
    reference: int = 512
    rooms: float = _ROOMS
    panelled: float = _PANELLED
    backlit: float = _BACKLIT
    box: float = _BOX
    relief: float = _RELIEF
    slender: float = _SLENDER
    fur: float = _FUR
    leaves: float = _LEAVES
    night: float = _NIGHT
    lamps: float = _LAMPS
    haze: float = _HAZE
    shallow: float = _SHALLOW
    many: float = _MANY
    motion: float = _MOTION
    assets: Path | None = None

    def __post_init__(self) -> None:
        for name in ("size", "reference"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be 1 or more, got {getattr(self, name)}")
        for name in ("rooms", "panelled", "backlit", "box", *EFFECTS, "many"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be 0 to 1, got {getattr(self, name)}")
        if not 1 <= self.motion <= 100:
            raise ValueError(f"motion must be 1 to 100, got {self.motion}")
        if self.assets is not None and not self.assets.is_dir():
            raise ValueError(f"assets must be a folder, got {self.assets}")

    def kind(self, drawn: random.Random) -> str:
        """One of `KINDS`."""
        others, plain = 1 - self.rooms, self.rooms * (1 - self.panelled)
        odds = {
            "cycles_room": plain * (1 - self.backlit),
            "cycles_table": others * _TABLES,
            "cycles_outdoors": others * (1 - _TABLES),
            "cycles_panelled": self.rooms * self.panelled,
            "cycles_backlit": plain * self.backlit,
        }
        return drawn.choices(list(KINDS), [odds[name] for name in KINDS])[0]


def render_scene(folder: Path, seed: int, options: Options) -> None:
    """All files of one scene, unless they are there.

    Parameters
    ----------
    folder
        Where they go, made if missing.
    seed
        Of scene and settings.
    options
        What is drawn.
    """
    if (folder / RECORD).exists():
        return
    drawn = random.Random(seed)
    kind = options.kind(drawn)
    size = options.size
    scene = prepare((size, size))
    scene.cycles.filter_width = drawn.choice((1.5, 1.5, 1.5, 1.0, 2.0))
    if random.Random(f"filter {seed}").random() < options.box:
        scene.cycles.pixel_filter_type = "BOX"
    scene.cycles.sample_clamp_indirect = drawn.choice((10.0, 10.0, 3.0, 30.0))
    scene.cycles.caustics_reflective = scene.cycles.caustics_refractive = drawn.random() < 0.5
    samples = drawn.choice((1, 1, 2, 4))
    used = build(kind, seed, options.assets, FRAMES, options.motion)
    effects = _add_effects(seed, options)
    counted = random.Random(f"many {seed}")
    if counted.random() < options.many:
        samples = counted.choice(_MANY_SAMPLES)
    last = FRAMES - 1
    for frame in range(FRAMES):
        render(folder / f"frame_{frame:04d}.exr", frame=frame, samples=samples, seed=frame)
    for index, count in enumerate(BLOCKS):
        path = folder / f"block_{index:02d}.exr"
        render(path, frame=last, samples=count, seed=_BLOCK_SEED + index)
    path = folder / f"ref_{last:04d}.exr"
    render(path, frame=last, samples=options.reference, seed=_REFERENCE_SEED, noise=_NOISE)
    record = {
        "scene": kind, "seed": seed, "frames": FRAMES, "spp": samples, "blocks": BLOCKS,
        "reference_spp": options.reference, "height": size, "width": size, "used": used,
        "filter": scene.cycles.pixel_filter_type, "filter_width": scene.cycles.filter_width,
        "clamp": scene.cycles.sample_clamp_indirect,
        "motion": options.motion, **effects,
        "blender": bpy.app.version_string,
    }  # fmt: skip
    (folder / RECORD).write_text(json.dumps(record, indent=1))


def _add_effects(seed: int, options: Options) -> dict[str, bool]:
    """What the seed's scene has of `EFFECTS`; each is drawn by itself: without, it is the same."""
    has = {}
    for name, add in EFFECTS.items():
        drawn = random.Random(f"{name} {seed}")
        has[name] = drawn.random() < getattr(options, name)
        if has[name]:
            add(drawn)
    return has


def main() -> None:
    """Render scenes of consecutive seeds."""
    usual = Options()
    parser = argparse.ArgumentParser(description="Render scenes to learn from with Cycles.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=100, help="scenes")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--size", type=int, default=usual.size, help="width and height, pixels")
    parser.add_argument("--reference", type=int, default=usual.reference, help="samples, at most")
    parser.add_argument("--rooms", type=float, default=usual.rooms, help="share of scenes, [0, 1]")
    parser.add_argument(
        "--panelled", type=float, default=usual.panelled, help="of rooms, with joinery, [0, 1]"
    )
    parser.add_argument(
        "--backlit",
        type=float,
        default=usual.backlit,
        help="of others, against windows, [0, 1]",
    )
    parser.add_argument("--box", type=float, default=usual.box, help="with a box filter, [0, 1]")
    parser.add_argument(
        "--relief", type=float, default=usual.relief, help="with relief on all surfaces, [0, 1]"
    )
    parser.add_argument(
        "--slender", type=float, default=usual.slender, help="with thin things, glasses, [0, 1]"
    )
    parser.add_argument(
        "--fur", type=float, default=usual.fur, help="with hair, fur and lawns, [0, 1]"
    )
    parser.add_argument("--leaves", type=float, default=usual.leaves, help="with foliage, [0, 1]")
    parser.add_argument(
        "--night", type=float, default=usual.night, help="at night, with many lamps, [0, 1]"
    )
    parser.add_argument("--haze", type=float, default=usual.haze, help="in haze, [0, 1]")
    parser.add_argument(
        "--lamps", type=float, default=usual.lamps, help="with small lamps in view, [0, 1]"
    )
    parser.add_argument(
        "--shallow", type=float, default=usual.shallow, help="with a lens wide open, [0, 1]"
    )
    parser.add_argument(
        "--many", type=float, default=usual.many, help="of 8 to 64 samples a frame, [0, 1]"
    )
    parser.add_argument(
        "--motion", type=float, default=usual.motion, help="cameras move up to so many times as far"
    )
    parser.add_argument("--assets", type=Path, help="folder of licensed objects")
    given = vars(parser.parse_args())
    folder, count, first = (given.pop(name) for name in ("folder", "count", "first_seed"))
    try:
        options = Options(**given)
    except ValueError as error:
        parser.error(str(error))
    for seed in range(first, first + count):
        scene = folder.resolve() / f"{seed:05d}"
        if (scene / TAKEN).exists():
            continue
        render_scene(scene, seed, options)
        left = shutil.disk_usage(scene).free
        if left < 2 << 30:
            raise SystemExit(f"{scene}: disk full but for {left >> 20} MiB")


if __name__ == "__main__":
    main()

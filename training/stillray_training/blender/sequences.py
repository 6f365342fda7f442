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
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import bpy

from stillray_training.blender.cycles import prepare, render
from stillray_training.blender.fur import grow
from stillray_training.blender.generated import KINDS, build
from stillray_training.blender.haze import fill
from stillray_training.blender.lamps import light_up
from stillray_training.blender.leaves import hang
from stillray_training.blender.lens import open_somewhere
from stillray_training.blender.letters import paste
from stillray_training.blender.night import fall
from stillray_training.blender.record import RECORD, TAKEN
from stillray_training.blender.relief import emboss_all
from stillray_training.blender.slender import scatter
from stillray_training.blender.smoke import blow
from stillray_training.blender.water import flood
from stillray_training.blender.wax import soften

FRAMES = 8
#: Samples a pixel of the blocks beside the last frame: many of few, since networks learn the noise
#: of those few frames by heart that can be made of few blocks.
BLOCKS = (1, 2, 4, 8, 16, 1, 1, 1, 2, 2, 4, 8)
_BLOCK_SEED, _REFERENCE_SEED = 100, 1000  # no two files share their noise
_TABLES = 0.6  # share of things on a table among scenes that are no rooms


class Effect(NamedTuple):
    """What a share of scenes has besides."""

    add: Callable[[random.Random], None]  # to the scene that is built
    text: str  # what it is, of scenes


#: In the order in which they are added.
EFFECTS = {
    "relief": Effect(emboss_all, "whose surfaces have one color and relief"),
    "wax": Effect(soften, "whose surfaces light enters"),
    "slender": Effect(scatter, "with thin things and glasses stood about"),
    "print": Effect(paste, "with print on what is seen"),
    "fur": Effect(grow, "with hair, fur and lawns"),
    "leaves": Effect(hang, "with foliage"),
    "night": Effect(fall, "at night, with many lamps"),
    "lamps": Effect(light_up, "with small lamps in view"),
    "water": Effect(flood, "with water over what is seen"),
    "smoke": Effect(blow, "with clouds of smoke"),
    "haze": Effect(fill, "in haze"),
    "shallow": Effect(open_somewhere, "seen through a lens that is wide open"),
}
#: Shares of other kinds, usual values and what they are of.
SHARES = {
    "rooms": (0.5, "scenes that are rooms"),
    "panelled": (0.4, "rooms full of painted joinery"),
    "backlit": (0.0, "other rooms that are looked at against their windows"),
    "box": (0.5, "scenes rendered with a box filter, as other renderers have"),
    "many": (0.0, "scenes whose frames have 8 to 64 samples a pixel where others have 1 to 4"),
    **{name: (0.0, f"scenes {effect.text}") for name, effect in EFFECTS.items()},
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
    motion
        Cameras move 1 to this many times as far as usual, 1 or more.
    assets
        Folder of licensed objects; None for none.
    shares
        By the names of `SHARES`, [0, 1]; those that are left out are the usual ones.

    Raises
    ------
    ValueError
        One is out of its range.
    """

    size: int = 192
    reference: int = 512
    motion: float = 1.0
    assets: Path | None = None
    shares: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("size", "reference"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be 1 or more, got {getattr(self, name)}")
        for name, share in self.shares.items():
            if name not in SHARES:
                raise ValueError(f"shares must be of {', '.join(SHARES)}, got {name}")
            if not 0 <= share <= 1:
                raise ValueError(f"{name} must be 0 to 1, got {share}")
        if not 1 <= self.motion <= 100:
            raise ValueError(f"motion must be 1 to 100, got {self.motion}")
        if self.assets is not None and not self.assets.is_dir():
            raise ValueError(f"assets must be a folder, got {self.assets}")

    def share(self, name: str) -> float:
        """One of `SHARES`."""
        return self.shares.get(name, SHARES[name][0])

    def kind(self, drawn: random.Random) -> str:
        """One of `KINDS`."""
        rooms, panelled, backlit = map(self.share, ("rooms", "panelled", "backlit"))
        others, plain = 1 - rooms, rooms * (1 - panelled)
        odds = {
            "cycles_room": plain * (1 - backlit),
            "cycles_table": others * _TABLES,
            "cycles_outdoors": others * (1 - _TABLES),
            "cycles_panelled": rooms * panelled,
            "cycles_backlit": plain * backlit,
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
    if random.Random(f"filter {seed}").random() < options.share("box"):
        scene.cycles.pixel_filter_type = "BOX"
    scene.cycles.sample_clamp_indirect = drawn.choice((10.0, 10.0, 3.0, 30.0))
    scene.cycles.caustics_reflective = scene.cycles.caustics_refractive = drawn.random() < 0.5
    samples = drawn.choice((1, 1, 2, 4))
    used = build(kind, seed, options.assets, FRAMES, options.motion)
    effects = _add_effects(seed, options)
    counted = random.Random(f"many {seed}")
    if counted.random() < options.share("many"):
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
    for name, effect in EFFECTS.items():
        drawn = random.Random(f"{name} {seed}")
        has[name] = drawn.random() < options.share(name)
        if has[name]:
            effect.add(drawn)
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
    for name, (share, text) in SHARES.items():
        told = f"share of {text}, [0, 1]; {share:g} unless given"
        parser.add_argument(f"--{name}", type=float, default=share, help=told)
    parser.add_argument(
        "--motion", type=float, default=usual.motion, help="cameras move up to so many times as far"
    )
    parser.add_argument("--assets", type=Path, help="folder of licensed objects")
    given = vars(parser.parse_args())
    folder, count, first = (given.pop(name) for name in ("folder", "count", "first_seed"))
    shares = {name: given.pop(name) for name in SHARES}
    try:
        options = Options(shares=shares, **given)
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

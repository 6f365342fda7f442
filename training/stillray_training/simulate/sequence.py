"""A rendered sequence on disk: ``frame_0000.exr ...``, ``ref_0007.exr`` and ``sequence.json``."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Collection, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.stats import qmc

from stillray.compare.display import DISPLAY_MEDIAN
from stillray.errors import InputError
from stillray.io.atomic import atomic_path
from stillray.io.exr.jitter import JITTER_ATTRIBUTE, jitter_text
from stillray.io.exr.new_file import write_channels
from stillray_training.simulate import buffers
from stillray_training.simulate.assets import Library
from stillray_training.simulate.camera import Camera, look_at
from stillray_training.simulate.generators import GENERATORS, generate
from stillray_training.simulate.paths import MOVES, CameraPath, camera_path, recorded_path
from stillray_training.simulate.plan import Plan, Wants, make_plan
from stillray_training.simulate.stage import Stage
from stillray_training.simulate.viewpoint import find_path, require_open
from stillray_training.simulate.world import World
from stillray_training.simulate.xml_scene import open_xml

_PREVIEW_SPP = 4
_STALE = 600.0  # seconds after which an unfinished file belongs to a run that was killed
RECORD = "sequence.json"  # written last: a sequence without it is not finished
_LAYERS = {
    "color": ("R", "G", "B"),
    "color_b": ("color_b.R", "color_b.G", "color_b.B"),
    "albedo": ("albedo.R", "albedo.G", "albedo.B"),
    "normal": ("normal.X", "normal.Y", "normal.Z"),
    "depth": ("depth.Z",),
    "motion": ("motion.X", "motion.Y"),
    "roughness": ("roughness.Y",),
    "specular_albedo": ("specular_albedo.R", "specular_albedo.G", "specular_albedo.B"),
}
_FULL = ("depth.Z", "motion.X", "motion.Y")  # written as float: half rounds 500 pixels to 0.25
_JITTERS = 1024  # Halton points that a sequence may begin at
_SPEEDS = ([0.3, 1.0, 2.0], [0.25, 0.45, 0.3])  # factors on the speed and their probabilities
_MOVE_ODDS = (0.12, 0.3, 0.28, 0.3)  # of MOVES, where none is asked for


@dataclass(frozen=True, kw_only=True)
class SequenceOptions:
    """What to render."""

    frames: int = 8  # 1 or more
    first: int = 0  # frames before it are not rendered, 0 to frames - 1
    height: int = 256  # pixels, 1 or more
    width: int = 256  # pixels, 1 or more
    spp: int = 1  # samples a pixel of the noisy frames, 1 or more
    reference_spp: int = 256  # samples a pixel of the references, 1 or more
    blocks: tuple[int, ...] = ()  # samples of further, independent blocks of the last frame
    # Bounds between which what one contribution of indirect light may have is drawn, as production
    # renderers limit it: times what a display shows as white. None: any.
    clamp: tuple[float, float] | None = None
    references: int = 1  # the last so many frames have a reference, 0 to frames
    depth: int | None = None  # path vertices, 1 or more; None: what the effects ask for
    reference_scale: int = 1  # references are so many times as wide and high: 1 or 2
    speed: float = 0.008  # camera move a frame, as a fraction of the distance looked at, 0 or more
    move: str | None = None  # of `paths.MOVES`; None: drawn
    second_color: bool = False  # an independent second colour, color_b
    guides: tuple[str, ...] = ()  # further features: roughness, specular_albedo
    reference_features: int = 0  # samples of the references' own features, 0: they have none
    jitter: bool = False  # sub-pixel offset of the image plane, Halton 2 and 3
    # Part of their pixel that samples of noisy frames fill: 1 as offline renderers do, 0 all at its
    # jittered centre as real-time renderers do, whose samples then say where they lie.
    spread: float = 1.0
    origin: tuple[float, float, float] | None = None  # of the camera, metres; None: drawn
    target: tuple[float, float, float] | None = None  # what the camera at origin looks at
    fov: float = 60.0  # horizontal field of view of the camera at origin, degrees, 1 to 170
    cameras: str | None = None  # JSON file of a camera a frame, see `paths.recorded_path`
    assets: str | None = None  # folder of objects that some generators place, see `assets`
    seed: int = 0  # 0 or more

    def __post_init__(self) -> None:
        for name in ("frames", "height", "width", "spp", "reference_spp"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be 1 or more, got {getattr(self, name)}")
        if not 0 <= self.spread <= 1:
            raise InputError(f"spread must be 0 to 1, got {self.spread}")
        if self.reference_features < 0:
            raise InputError(f"reference_features must be 0 or more, got {self.reference_features}")
        if any(count < 1 for count in self.blocks):
            raise InputError(f"blocks must be of 1 sample or more, got {self.blocks}")
        if self.clamp is not None and not 0 < self.clamp[0] <= self.clamp[-1]:
            raise InputError(f"clamp must be two bounds above 0, got {self.clamp}")
        for name in ("speed", "seed"):
            if not getattr(self, name) >= 0:
                raise InputError(f"{name} must be 0 or more, got {getattr(self, name)}")
        if not 0 <= self.first < self.frames:
            raise InputError(f"first must be 0 to frames - 1 ({self.frames - 1}), got {self.first}")
        if not 0 <= self.references <= self.frames:
            raise InputError(
                f"references must be 0 to frames ({self.frames}), got {self.references}"
            )
        if self.move is not None and self.move not in MOVES:
            raise InputError(f"move must be of {', '.join(MOVES)}, got {self.move}")
        if (self.origin is None) != (self.target is None):
            raise InputError("origin and target must be given together, got one of them")
        if self.origin is not None and self.origin == self.target:
            raise InputError(f"target must differ from origin, got {self.target} for both")
        if self.cameras is not None and (self.origin is not None or self.move is not None):
            raise InputError("cameras must be given without origin and move, got both")
        if not 1 <= self.fov <= 170:
            raise InputError(f"fov must be 1 to 170 degrees, got {self.fov:g}")
        self.wants()

    def wants(self) -> Wants:
        """The buffers on demand."""
        return Wants(
            second_color=self.second_color,
            guides=self.guides,
            jitter=self.jitter,
            reference_scale=self.reference_scale,
            depth=self.depth,
        )


def open_world(mi: Any, name: str, seed: int, assets: str | None = None) -> World:
    """A scene by name: one of the generators, or the path of a Mitsuba XML file.

    ``assets`` is a folder of objects for generators that place some; None: they build their own.

    Raises
    ------
    InputError
        There is no such generator or file, or Mitsuba cannot read it.
    """
    if name in GENERATORS:
        return generate(name, seed, Library(Path(assets)) if assets else None)
    path = Path(name)
    if not path.is_file():
        known = ", ".join(GENERATORS)
        raise InputError(f"scene must be of {known} or a Mitsuba XML file, got {name}")
    return open_xml(mi, path, seed)


def plan_scene(
    mi: Any, name: str, seed: int, effects: Iterable[str] | None, options: SequenceOptions
) -> Plan:
    """Open a scene and decide what is simulated in it; see `make_plan`."""
    return make_plan(open_world(mi, name, seed, options.assets), effects, options.wants())


def is_complete(folder: Path) -> bool:
    """Whether a sequence was rendered to its end."""
    return (folder / RECORD).is_file()


def render_sequence(
    stage: Stage,
    folder: Path,
    options: SequenceOptions,
    *,
    on_frame: Callable[[], None] = lambda: None,
) -> None:
    """Render a sequence; files that are already there are kept, so a killed run resumes.

    Parameters
    ----------
    stage
        The loaded scene; any number of sequences may be rendered on it one after the other.
    folder
        Where the files go; made if missing.
    options
        Sizes, counts and the seed: the same seed gives the same pixels on the same variant.
    on_frame
        Called after each frame.

    Raises
    ------
    InputError
        The camera asked for is inside geometry, or the scene has no place for one.
    """
    if is_complete(folder):
        return
    rng = np.random.default_rng([options.seed, 77])
    move = options.move or str(rng.choice(MOVES, p=_MOVE_ODDS))
    if options.cameras is not None:
        move = "recorded"
    speed = (
        options.speed
        if options.move
        else options.speed * float(rng.choice(_SPEEDS[0], p=_SPEEDS[1]))
    )
    path, distance = _path(stage, rng, options, move, speed)
    focus = stage.plan.world.lens.focus * distance
    folder.mkdir(parents=True, exist_ok=True)
    _sweep(folder)
    jitters = jitters_of(options)
    last = buffers.Moment(frame=options.frames - 1, path=path, focus=focus, jitter=np.zeros(2))
    clamp = _clamp(stage, options, last)
    for frame in range(options.first, options.frames):
        moment = buffers.Moment(
            frame=frame,
            path=path,
            focus=focus,
            jitter=jitters[frame],
            clamp=clamp,
            spread=options.spread,
        )
        _render_frame(stage, folder, options, moment)
        on_frame()
    record = {
        "scene": stage.plan.world.label,
        "effects": list(stage.plan.effects),
        "variant": stage.mi.variant(),
        "integrator": {"plugin": stage.plan.integrator.plugin, **stage.plan.integrator.params},
        "move": move,
        "moving": stage.groups,
        "assets": [asdict(credit) for credit in stage.plan.world.credits],
        "shutter": stage.plan.shutter,
        "clamp": clamp,
        "options": asdict(options),
        "cameras": [
            {
                "camera_to_world": path(float(frame)).to_world.tolist(),
                "fov_x_deg": path(float(frame)).fov_x,
                "jitter": jitters[frame].tolist(),
            }
            for frame in range(options.frames)
        ],
    }
    with atomic_path(folder / RECORD) as temporary:
        temporary.write_text(json.dumps(record, indent=1))


def _path(
    stage: Stage, rng: np.random.Generator, options: SequenceOptions, move: str, speed: float
) -> tuple[CameraPath, float]:
    if options.cameras is not None:
        if stage.plan.shutter:
            raise InputError("cameras must go without motion_blur: they are known at whole frames")
        recorded = recorded_path(Path(options.cameras), options.frames)
        return recorded, require_open(stage, recorded, options.frames)
    if options.origin is None or options.target is None:
        return find_path(stage, rng, frames=options.frames, move=move, speed=speed)
    origin, target = np.array(options.origin, float), np.array(options.target, float)
    forward = (target - origin) / np.linalg.norm(target - origin)
    up = np.array([0, 1.0, 0]) if abs(forward[1]) < 0.99 else np.array([0, 0, 1.0])
    start = Camera(to_world=look_at(origin, target, up), fov_x=options.fov)
    path = camera_path(move, rng, start, float(np.linalg.norm(target - origin)), speed=speed)
    return path, require_open(stage, path, options.frames)


def _render_frame(
    stage: Stage, folder: Path, options: SequenceOptions, moment: buffers.Moment
) -> None:
    # launches take consecutive seeds, and Mitsuba's are of 32 bits
    is_last = moment.frame == options.frames - 1
    extra = options.blocks if is_last else ()
    states = np.random.SeedSequence([options.seed, moment.frame]).generate_state(3 + len(extra))
    seeds = states >> 1
    noisy, second, exact, *others = (int(seed) for seed in seeds)
    target = folder / f"frame_{moment.frame:04d}.exr"
    if not target.is_file():
        layers = buffers.render_noisy(stage, moment, spp=options.spp, seed=noisy)
        if options.second_color:
            layers["color_b"] = buffers.render_second(stage, moment, spp=options.spp, seed=second)
        said = {JITTER_ATTRIBUTE: jitter_text(moment.jitter)} if options.jitter else None
        write(target, layers, said)
    for index, (spp, seed) in enumerate(zip(extra, others, strict=True)):
        target = folder / f"block_{moment.frame:04d}_{index:02d}.exr"
        if not target.is_file():
            write(target, buffers.render_noisy(stage, moment, spp=spp, seed=seed))
    target = folder / f"ref_{moment.frame:04d}.exr"
    if moment.frame >= options.frames - options.references and not target.is_file():
        reference = buffers.render_reference(stage, moment, spp=options.reference_spp, seed=exact)
        layers = {"color": reference}
        if options.reference_features:
            layers |= buffers.render_reference_features(
                stage, moment, spp=options.reference_features, seed=exact + 1
            )
        write(target, layers)


def _clamp(stage: Stage, options: SequenceOptions, moment: buffers.Moment) -> float | None:
    """Radiance that one contribution of indirect light may have."""
    if options.clamp is None:
        return None
    low, high = options.clamp
    drawn = np.random.default_rng([options.seed, 78]).uniform(np.log(low), np.log(high))
    seen = buffers.render_noisy(stage, moment, spp=_PREVIEW_SPP, seed=options.seed)["color"]
    # a preview of few samples is made of fireflies: blocks of pixels tell what is usual
    light = cv2.resize(seen.mean(axis=-1), None, fx=1 / 8, fy=1 / 8, interpolation=cv2.INTER_AREA)
    lit = light[light > 0]
    return float(np.exp(drawn) / DISPLAY_MEDIAN * np.median(lit)) if lit.size else None


def write(
    path: Path,
    layers: dict[str, np.ndarray],
    attributes: dict[str, str] | None = None,
    full: Collection[str] = _FULL,
) -> None:
    """Write layers under their channel names, complete or not at all; in half but for some."""
    channels = {}
    for layer, names in _LAYERS.items():
        if layer in layers:
            planes = np.atleast_3d(layers[layer])
            channels.update({name: planes[..., i] for i, name in enumerate(names)})
    formats = {name: "float" for name in full if name in channels}
    write_channels(path, channels, formats=formats, attributes=attributes)


def _sweep(folder: Path) -> None:
    """Delete what killed runs were writing; a worker beside this one writes for moments only."""
    for part in folder.glob(".*.part"):
        if time.time() - part.stat().st_mtime > _STALE:
            part.unlink(missing_ok=True)


def jitters_of(options: SequenceOptions) -> list[np.ndarray]:
    """Offsets of the samples of each frame, pixels, in [-0.5, 0.5); 0 without jitter.

    Halton points of bases 2 and 3, the usual choice for upscaling. They begin anywhere, as the seed
    has it, so that a network meets others than the first dozen; but where cameras are recorded,
    whose frames are those of a film, at the first.
    """
    if not options.jitter:
        return [np.zeros(2)] * options.frames
    first = 0
    if options.cameras is None:
        first = int(np.random.default_rng([options.seed, 78]).integers(_JITTERS))
    points = qmc.Halton(d=2, scramble=False)
    points.fast_forward(first + 1)  # the one before is a corner of the pixel
    return list(points.random(options.frames) - 0.5)

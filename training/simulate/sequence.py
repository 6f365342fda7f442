"""A rendered sequence on disk: ``frame_0000.exr ...``, ``ref_0007.exr`` and ``sequence.json``."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray.exr import atomic_path, write_channels
from stillray.training.simulate import buffers
from stillray.training.simulate.camera import Camera, look_at, smooth_path
from stillray.training.simulate.room import Room

ROOM = "room"  # the scene name that stands for the procedural room
SENSOR_CLEARANCE = 0.12  # of the median depth: nearest surface around a camera
RECORD = "sequence.json"  # written last: a sequence without it is not finished
_LAYERS = {
    "color": ("R", "G", "B"),
    "albedo": ("albedo.R", "albedo.G", "albedo.B"),
    "normal": ("normal.X", "normal.Y", "normal.Z"),
    "depth": ("depth.Z",),
    "motion": ("motion.X", "motion.Y"),
}


@dataclass(frozen=True, kw_only=True)
class SequenceOptions:
    """What to render."""

    frames: int = 8  # 1 or more
    height: int = 256  # pixels
    width: int = 256  # pixels
    spp: int = 1  # samples a pixel of the noisy frames, 1 or more
    reference_spp: int = 256  # samples a pixel of the references, 1 or more
    references: int = 1  # the last so many frames have a reference, 0 to frames
    max_depth: int = 8  # path length, 1 or more
    speed: float = 0.008  # camera move a frame, as a fraction of the distance looked at
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("frames", "height", "width", "spp", "reference_spp", "max_depth"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be 1 or more, got {getattr(self, name)}")
        if not 0 <= self.references <= self.frames:
            raise InputError(
                f"references must be 0 to frames ({self.frames}), got {self.references}"
            )


@dataclass(frozen=True, kw_only=True)
class OpenScene:
    """A loaded scene, and how to draw a camera in it."""

    label: str
    scene: Any
    draw_camera: Callable[[np.random.Generator], Camera]


def open_scene(mi: Any, name: str, seed: int, height: int, width: int) -> OpenScene:
    """Load a scene once, for any number of views.

    Parameters
    ----------
    mi
        The Mitsuba module with its variant set.
    name
        ``"room"`` for the procedural room, or the path of a Mitsuba XML file.
    seed
        Which room; an XML file has one likeness only.
    height, width
        Size of the pictures in pixels.

    Raises
    ------
    InputError
        The scene file is missing or Mitsuba cannot load it.
    """
    if name == ROOM:
        room = Room(mi, seed)
        scene = mi.load_dict({**room.scene, "sensor": _sensor(height, width)})
        return OpenScene(label=ROOM, scene=scene, draw_camera=lambda rng: _room_camera(room, rng))
    path = Path(name)
    if not path.is_file():
        raise InputError(f"scene must be 'room' or a Mitsuba XML file, got {name}")
    try:
        scene = mi.load_file(str(path), resx=width, resy=height)
    except RuntimeError as error:
        raise InputError(f"{path}: Mitsuba cannot load it: {str(error).splitlines()[-1]}") from None
    parameters = mi.traverse(scene.sensors()[0])
    home = Camera(
        to_world=np.array(parameters["to_world"].matrix, np.float64).reshape(4, 4),
        fov_x=float(np.array(parameters["x_fov"]).ravel()[0]),
    )
    distance = _distances(mi, scene, home)[1]
    return OpenScene(
        label=path.resolve().parent.name,
        scene=scene,
        draw_camera=lambda rng: _orbit_camera(home, distance, rng),
    )


def is_complete(folder: Path) -> bool:
    """Whether a sequence was rendered to its end."""
    return (folder / RECORD).is_file()


def render_sequence(mi: Any, source: OpenScene, folder: Path, options: SequenceOptions) -> None:
    """Render a sequence; frames that are already there are kept, so a killed run resumes.

    Parameters
    ----------
    mi
        The Mitsuba module with its variant set.
    source
        The loaded scene.
    folder
        Where the files go; made if missing.
    options
        Sizes, counts and the seed: the same seed gives the same pixels on the same variant.
    """
    if is_complete(folder):
        return
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng([options.seed, 77])
    scene = source.scene
    start, distance = _search_camera(mi, source, rng)
    speed = options.speed * rng.choice([0.0, 0.3, 1.0, 2.0], p=[0.1, 0.2, 0.4, 0.3])
    path = smooth_path(rng, start, distance, options.frames, speed=float(speed))
    for frame, camera in enumerate(path):
        # passes of a reference take consecutive seeds; Mitsuba's are of 32 bits
        seed = int(np.random.SeedSequence([options.seed, frame]).generate_state(1)[0] >> 1)
        target = folder / f"frame_{frame:04d}.exr"
        if not target.is_file():
            layers = buffers.render_noisy(
                mi,
                scene,
                camera,
                path[max(frame - 1, 0)],
                spp=options.spp,
                seed=seed,
                max_depth=options.max_depth,
            )
            write_channels(target, _channels(layers))
        target = folder / f"ref_{frame:04d}.exr"
        if frame >= options.frames - options.references and not target.is_file():
            reference = buffers.render_reference(
                mi,
                scene,
                camera,
                spp=options.reference_spp,
                seed=seed + 1,
                max_depth=options.max_depth,
            )
            write_channels(target, _channels({"color": reference}))
    record = {
        "scene": source.label,
        "options": asdict(options),
        "cameras": [
            {"camera_to_world": camera.to_world.tolist(), "fov_x_deg": camera.fov_x}
            for camera in path
        ],
    }
    with atomic_path(folder / RECORD) as temporary:
        temporary.write_text(json.dumps(record, indent=1))


def _channels(layers: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    channels = {}
    for layer, names in _LAYERS.items():
        if layer in layers:
            planes = np.atleast_3d(layers[layer])
            channels.update({name: planes[..., i] for i, name in enumerate(names)})
    return channels


def _sensor(height: int, width: int) -> dict[str, Any]:
    return {
        "type": "perspective",
        "fov": 60.0,
        "fov_axis": "x",
        "near_clip": 0.01,
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "pixel_format": "rgb",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent"},
    }


def _room_camera(room: Room, rng: np.random.Generator) -> Camera:
    x, y, z = room.size / 2
    origin = rng.uniform([-x + 0.3, 0.5, -z + 0.3], [x - 0.3, 2 * y - 0.4, z - 0.3])
    target = rng.uniform([-x, 0.2, -z], [x, 1.4, z])
    roll = np.array([rng.normal() * 0.03, 1.0, 0.0])
    return Camera(to_world=look_at(origin, target, roll), fov_x=float(rng.uniform(25, 80)))


def _orbit_camera(home: Camera, distance: float, rng: np.random.Generator) -> Camera:
    """The file's own camera, carried around and towards what it looks at."""
    left, up, forward = home.to_world[:3, :3].T
    pivot = home.to_world[:3, 3] + forward * distance
    around, above = np.radians(rng.uniform(-35, 35)), np.radians(rng.uniform(-12, 18))
    back = -(forward * np.cos(around) + left * np.sin(around)) * np.cos(above) + up * np.sin(above)
    origin = pivot + back * distance * rng.uniform(0.4, 1.05)
    target = pivot + (left * rng.normal() + up * rng.normal()) * 0.2 * distance
    fov = float(np.clip(home.fov_x * rng.uniform(0.5, 1.1), 12, 90))
    return Camera(to_world=look_at(origin, target, up), fov_x=fov)


def _search_camera(mi: Any, source: OpenScene, rng: np.random.Generator) -> tuple[Camera, float]:
    """Draw until the camera is clear of geometry and sees something; keep the best of 40.

    Returns the camera and the median distance to what it sees.
    """
    best: tuple[float, Camera, float] | None = None
    for _ in range(40):
        camera = source.draw_camera(rng)
        nearest, middle, seen = _distances(mi, source.scene, camera)
        score = min(nearest / max(middle, 1e-9), SENSOR_CLEARANCE) * seen
        if best is None or score > best[0]:
            best = (score, camera, middle)
        if nearest > SENSOR_CLEARANCE * middle and seen > 0.6:
            break
    assert best is not None
    return best[1], best[2]


def _distances(mi: Any, scene: Any, camera: Camera) -> tuple[float, float, float]:
    """Nearest and median distance along a grid of camera rays, and the part that hits."""
    import drjit as dr

    grid = np.linspace(-0.95, 0.95, 9) * np.tan(np.radians(camera.fov_x) / 2)
    x, y = (plane.ravel() for plane in np.meshgrid(grid, grid))
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    rays = (rays / np.linalg.norm(rays, axis=-1, keepdims=True)) @ camera.to_world[:3, :3].T
    origin = camera.to_world[:3, 3]
    if "scalar" in mi.variant():
        distances = np.array(
            [scene.ray_intersect(mi.Ray3f(origin.tolist(), ray.tolist())).t for ray in rays]
        )
    else:
        hit = scene.ray_intersect(
            mi.Ray3f(mi.Point3f(*origin.tolist()), mi.Vector3f(*rays.T.astype(np.float32)))
        )
        distances = np.array(dr.select(hit.is_valid(), hit.t, np.inf))
    finite = distances[np.isfinite(distances)]
    if finite.size == 0:
        return 0.0, 1.0, 0.0
    return float(finite.min()), float(np.median(finite)), finite.size / distances.size

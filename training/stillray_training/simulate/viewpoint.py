"""Finding cameras that stand in the open: never inside geometry, never behind it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillray.errors import InputError
from stillray_training.simulate.camera import Camera, look_at
from stillray_training.simulate.paths import CameraPath, camera_path
from stillray_training.simulate.stage import HULL, Stage
from stillray_training.simulate.world import World

CLEARANCE = 0.12  # of the median distance seen: nearest surface in view
_NEAR = 0.04  # of the median distance seen: nearest surface in any direction
_BACK_FACES = 0.12  # part of the view that may be back faces
_DRAWS = 60
_GRID = 11  # rays a side of the picture
_KINDS = 12  # shapes in view that make a view as varied as any


@dataclass(frozen=True, kw_only=True)
class View:
    """What a camera sees along a grid of rays."""

    nearest: float  # metres
    middle: float  # median distance, metres
    hits: float  # part of the rays that hit something
    backs: float  # part of the hits that are back faces
    kinds: int  # different shapes in view

    def score(self) -> float:
        """1 where the camera stands well, less where it is cramped or sees little."""
        room = min(self.nearest / max(CLEARANCE * self.middle, 1e-9), 1.0)
        fair = 1.0 if self.backs <= _BACK_FACES else 0.1
        variety = 0.4 + 0.6 * min(self.kinds / _KINDS, 1.0)
        return room * min(self.hits / 0.5, 1.0) * fair * variety


def look(stage: Stage, cameras: list[Camera]) -> list[View]:
    """What each camera sees."""
    grid = np.linspace(-0.95, 0.95, _GRID)
    x, y = (plane.ravel() for plane in np.meshgrid(grid, grid))
    aspect = stage.height / stage.width
    views = []
    origins, rays = [], []
    for camera in cameras:
        half = np.tan(np.radians(camera.fov_x) / 2)
        local = np.stack([x * half, y * half * aspect, np.ones_like(x)], axis=-1)
        local /= np.linalg.norm(local, axis=-1, keepdims=True)
        rays.append(local @ camera.to_world[:3, :3].T)
        origins.append(np.broadcast_to(camera.to_world[:3, 3], rays[-1].shape))
    found = cast(stage, np.concatenate(origins), np.concatenate(rays))
    for d, f, shape in zip(*(part.reshape(len(cameras), -1) for part in found), strict=True):
        hit = np.isfinite(d)
        if not hit.any():
            views.append(View(nearest=np.inf, middle=1.0, hits=0.0, backs=0.0, kinds=0))
            continue
        views.append(
            View(
                nearest=float(d[hit].min()),
                middle=float(np.median(d[hit])),
                hits=float(hit.mean()),
                # files have surfaces that face every way
                backs=0.0 if stage.plan.world.file else float((f[hit] > 0).mean()),
                kinds=len(np.unique(shape[hit])),
            )
        )
    return views


def cast(stage: Stage, origins: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, ...]:
    """First hits of ``(n, 3)`` rays.

    Returns
    -------
    distance, facing, shape
        Infinite where nothing is hit; ray . normal, above 0 on back faces; a number that differs
        from shape to shape.
    """
    mi = stage.mi
    if "scalar" in mi.variant():
        found = [
            stage.scene.ray_intersect(mi.Ray3f(o.tolist(), r.tolist()))
            for o, r in zip(origins, rays, strict=True)
        ]
        distance = np.array([si.t if si.is_valid() and si.shape.id() != HULL else np.inf
                             for si in found])  # fmt: skip
        normal = np.array([np.array(si.n) for si in found])
        shape = np.array([hash(si.shape.id()) if si.is_valid() else 0 for si in found])
        return distance, (rays * normal).sum(-1), shape
    import drjit as dr

    hit = stage.scene.ray_intersect(
        mi.Ray3f(mi.Point3f(*origins.T.astype(np.float32)), mi.Vector3f(*rays.T.astype(np.float32)))
    )
    valid = hit.is_valid()
    for shape in stage.scene.shapes():
        if shape.id() == HULL:
            valid &= hit.shape != mi.ShapePtr(shape)
    distance = np.where(np.array(valid), np.array(hit.t, np.float64), np.inf)
    shape = np.array(dr.reinterpret_array(mi.UInt32, hit.shape))
    return distance, (rays * np.array(hit.n, np.float64).T).sum(-1), shape


def draw_camera(world: World, rng: np.random.Generator, distance: float) -> Camera:
    """A random camera of the world; ``distance`` is what its home camera looks across."""
    if world.home is not None:
        return _around(world.home, distance, rng)
    assert world.space is not None
    assert world.gaze is not None
    origin, target = rng.uniform(*world.space), rng.uniform(*world.gaze)
    roll = np.array([rng.normal() * 0.03, 1.0, 0.0])
    return Camera(to_world=look_at(origin, target, roll), fov_x=float(rng.uniform(28, 85)))


def find_path(
    stage: Stage, rng: np.random.Generator, *, frames: int, move: str, speed: float
) -> tuple[CameraPath, float]:
    """A camera move that stays in the open, and the distance it looks across.

    Raises
    ------
    InputError
        None of many draws has room: the scene has no place for a camera.
    """
    world = stage.plan.world
    distance = look(stage, [world.home])[0].middle if world.home else 1.0
    stage.pose(0.0)
    cameras = [draw_camera(world, rng, distance) for _ in range(_DRAWS)]
    views = look(stage, cameras)
    # the best first; among good ones the first drawn, so that no kind of view is favoured
    order = np.argsort([-round(view.score(), 1) for view in views], kind="stable")
    for index in order:
        view = views[index]
        if view.score() <= 0.1:
            break
        for slower in (1.0, 0.5, 0.2, 0.0):
            path = camera_path(move, rng, cameras[index], view.middle, speed=speed * slower)
            if is_open(stage, path, frames):
                return path, view.middle
    raise InputError(f"scene {world.label} has no open place for a camera in {_DRAWS} draws")


def is_open(stage: Stage, path: CameraPath, frames: int) -> bool:
    """Whether a camera has room at every frame, and nothing in its way from each to the next."""
    cameras = [path(float(frame)) for frame in range(frames)]
    views = []
    for frame, camera in enumerate(cameras):
        if stage.groups or frame == 0:
            stage.pose(float(frame))
        views += look(stage, [camera])
    if any(view.nearest < 0.5 * CLEARANCE * view.middle or view.hits < 0.2 for view in views):
        return False
    if any(inside(stage, camera, view.middle) for camera, view in zip(cameras, views, strict=True)):
        return False
    places = np.array([camera.to_world[:3, 3] for camera in cameras])
    steps = np.diff(places, axis=0)
    length = np.linalg.norm(steps, axis=1)
    moving = length > 1e-9
    if not moving.any():
        return True
    distance, _, _ = cast(stage, places[:-1][moving], steps[moving] / length[moving, None])
    return bool((distance > length[moving]).all())


def inside(stage: Stage, camera: Camera, scale: float) -> bool:
    """Whether a camera is inside geometry or behind it.

    Inside a closed body every direction ends on a back face; a surface almost at the lens is no
    better. Files whose surfaces face every way are told by nearness alone.
    """
    rays = _directions()
    distance, facing, _ = cast(stage, np.broadcast_to(camera.to_world[:3, 3], rays.shape), rays)
    hit = np.isfinite(distance)
    if not hit.any():
        return False
    if distance[hit].min() < _NEAR * scale * 0.25:
        return True
    return stage.plan.world.file is None and float((facing[hit] > 0).mean()) > 0.5


def require_open(stage: Stage, path: CameraPath, frames: int) -> float:
    """The distance a camera given by the user looks across.

    Raises
    ------
    InputError
        It starts inside geometry or behind it, sees nothing, or its way leads through something.
    """
    camera = path(0.0)
    origin = ", ".join(f"{v:g}" for v in camera.to_world[:3, 3])
    stage.pose(0.0)
    view = look(stage, [camera])[0]
    if inside(stage, camera, view.middle) or view.backs > 0.5:
        raise InputError(f"origin must be in the open, got {origin}: inside or behind geometry")
    if view.hits == 0:
        raise InputError(f"target must lie in the scene, got a view from {origin} on nothing")
    if not is_open(stage, path, frames):
        raise InputError(
            f"origin must leave room for the camera's move, got {origin}: use a slower or still one"
        )
    return view.middle


def _directions() -> np.ndarray:
    """26 unit directions: a cube's faces, edges and corners."""
    grid = np.array(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3)).reshape(3, -1).T
    grid = grid[np.any(grid != 0, axis=1)]
    return np.asarray(grid / np.linalg.norm(grid, axis=1, keepdims=True))


def _around(home: Camera, distance: float, rng: np.random.Generator) -> Camera:
    """The home camera, carried around and towards what it looks at."""
    left, up, forward = home.to_world[:3, :3].T
    pivot = home.to_world[:3, 3] + forward * distance
    around, above = np.radians(rng.uniform(-35, 35)), np.radians(rng.uniform(-12, 18))
    back = -(forward * np.cos(around) + left * np.sin(around)) * np.cos(above) + up * np.sin(above)
    origin = pivot + back * distance * rng.uniform(0.4, 1.05)
    target = pivot + (left * rng.normal() + up * rng.normal()) * 0.2 * distance
    fov = float(np.clip(home.fov_x * rng.uniform(0.5, 1.1), 12, 90))
    return Camera(to_world=look_at(origin, target, up), fov_x=fov)

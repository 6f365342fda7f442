"""Mitsuba XML files as worlds: what they show by themselves, and what can be added to them."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray_training.simulate.camera import Camera
from stillray_training.simulate.mesh import rotation, translation
from stillray_training.simulate.world import File, Fog, Motion, Sky, Sun, World

# Which plugins mean that a file shows an effect by itself.
_SHOWS = {
    "texture": ("bitmap", "checkerboard", "mesh_attribute", "volume"),
    "glossy": ("roughplastic", "roughconductor", "roughdielectric", "principled", "plastic",
               "principledthin", "measured", "hair", "pplastic"),
    "mirror_glass": ("conductor", "dielectric", "thindielectric"),
    "soft_shadow": ("area", "directionalarea"),
    "environment": ("envmap", "constant", "sunsky", "timed_sunsky"),
    "sun": ("directional", "sunsky", "timed_sunsky"),
    "medium": ("homogeneous", "heterogeneous"),
}  # fmt: skip
_NOT_OURS = {"scene", "path", "volpath", "perspective", "thinlens", "hdrfilm", "independent",
             "merge", "box", "gaussian", "multijitter", "aov", "tent", "stratified"}  # fmt: skip


def open_xml(mi: Any, path: Path, seed: int) -> World:
    """Load a Mitsuba XML file and list what it shows.

    The file's materials and lights stay as they are. Effects that it does not show by itself can
    be added if they concern light from infinity, the lens, the shutter, a medium, or its smaller
    meshes in motion; their parameters are drawn from the seed.

    Raises
    ------
    InputError
        The file cannot be parsed, has no perspective camera, or names a file that is missing.
    """
    config = mi.parser.ParserConfig(mi.variant())
    try:
        state = mi.parser.parse_file(config, str(path))
        mi.parser.transform_all(config, state)
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: Mitsuba cannot read it: {reason}") from None
    counts: Counter[str] = Counter()
    for node in state.nodes:
        plugin = node.props.plugin_name()
        counts[plugin] += plugin not in _NOT_OURS
        named = node.props.get("filename", None)
        if named and not (path.parent / str(named)).is_file():
            raise InputError(f"{path}: names a file that is missing: {named}")
    shows = tuple(
        effect for effect, plugins in _SHOWS.items() if any(counts[plugin] for plugin in plugins)
    )
    try:
        scene = mi.load_file(str(path))
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: Mitsuba cannot load it: {reason}") from None
    extent = _extents(scene.bbox()).max()
    rng = np.random.default_rng([seed, 5])
    azimuth = rng.uniform(0, 2 * np.pi)
    down = float(-np.tan(np.radians(rng.uniform(20, 60))))
    return World(
        label=path.resolve().parent.name,
        sky=Sky(kind=str(rng.choice(["clear", "cloudy", "studio"])), seed=seed),
        sun=Sun(direction=(float(np.cos(azimuth)), down, float(np.sin(azimuth))),
                irradiance=(4.0, 3.7, 3.2)),
        fog=Fog(extinction=float(rng.uniform(0.2, 2.0) / extent)),
        shutter=float(rng.uniform(0.3, 1.0)),
        moving=_moving(mi, scene, rng),
        home=_home(mi, path),
        effects=shows,
        file=File(path=path, scene=scene, plugins=dict(+counts), effects=shows),
    )  # fmt: skip


def _extents(box: Any) -> np.ndarray:
    return np.array(box.max, float).ravel() - np.array(box.min, float).ravel()


def _moving(mi: Any, scene: Any, rng: np.random.Generator) -> dict[str, Motion]:
    """One mesh of the file that is neither tiny nor a part of the building, if there is one."""
    extent = _extents(scene.bbox()).max()
    able = [
        (f"file{index}", shape)
        for index, shape in enumerate(scene.shapes())
        if shape.is_mesh() and 0.02 * extent < _extents(shape.bbox()).max() < 0.35 * extent
    ]
    heading, speed = rng.uniform(0, 2 * np.pi), extent * rng.uniform(0.002, 0.01)
    spin, chosen = float(rng.normal() * 3), int(rng.integers(1 << 16))
    if not able:
        return {}
    name, shape = able[chosen % len(able)]
    box = shape.bbox()
    centre = (np.array(box.min, float).ravel() + np.array(box.max, float).ravel()) / 2
    step = speed * np.array([np.cos(heading), 0.0, np.sin(heading)])

    def pose(time: float) -> np.ndarray:
        turn = rotation([0, 1, 0], spin * time)
        return translation(centre + step * time) @ turn @ translation(-centre)

    return {name: pose}


def _home(mi: Any, path: Path) -> Camera:
    config = mi.parser.ParserConfig(mi.variant())
    state = mi.parser.parse_file(config, str(path))
    cameras = [n for n in state.nodes if n.props.plugin_name() in ("perspective", "thinlens")]
    if not cameras:
        raise InputError(f"{path}: must have a perspective camera, it has none")
    properties = cameras[0].props
    description = {name: properties[name] for name in properties.keys()  # noqa: SIM118
                   if name in ("fov", "fov_axis", "focal_length", "to_world")}  # fmt: skip
    sensor = mi.load_dict({"type": "perspective", **description})
    parameters = mi.traverse(sensor)
    return Camera(
        to_world=np.array(parameters["to_world"].matrix, np.float64).reshape(4, 4),
        fov_x=float(np.array(parameters["x_fov"]).ravel()[0]),
    )

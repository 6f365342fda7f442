"""One frame's buffers from a Mitsuba scene: colour, albedo, normal, depth, motion, reference."""

from __future__ import annotations

from typing import Any

import numpy as np

from stillray.training.simulate.camera import Camera

# The AOV plugin appends these to R, G, B in this order.
_AOVS = "albedo:albedo,normal:sh_normal,position:position"


def aim(mi: Any, scene: Any, camera: Camera) -> None:
    """Move the scene's first sensor, so that the compiled kernels are used again."""
    parameters = mi.traverse(scene.sensors()[0])
    parameters["to_world"] = mi.ScalarTransform4f(camera.to_world.tolist())
    parameters["x_fov"] = camera.fov_x
    parameters.update()


def render_noisy(
    mi: Any,
    scene: Any,
    camera: Camera,
    previous: Camera,
    *,
    spp: int,
    seed: int,
    max_depth: int,
) -> dict[str, np.ndarray]:
    """Render one noisy frame and its features, all from the same camera samples.

    Returns
    -------
    dict
        ``color``, ``albedo``, ``normal`` ``(h, w, 3)``, ``depth`` ``(h, w)`` camera z with 0 where
        nothing was hit, ``motion`` ``(h, w, 2)`` previous minus current position in pixels
        (the background moves as a point at infinity does).
    """
    aim(mi, scene, camera)
    integrator = mi.load_dict(
        {"type": "aov", "aovs": _AOVS, "img": {"type": "path", "max_depth": max_depth}}
    )
    pixels = np.array(mi.render(scene, integrator=integrator, spp=spp, seed=seed), np.float32)
    color, albedo, normal, position = np.split(pixels[..., :12], 4, axis=-1)
    height, width = color.shape[:2]
    hit = np.any(normal != 0, axis=-1)
    # several samples average the normal; the direction is what a guide needs
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    position = np.where(hit[..., None], position, camera.far_points(height, width))
    x, y, depth = camera.project(position.astype(np.float64), height, width)
    was_x, was_y, _ = previous.project(position.astype(np.float64), height, width)
    motion = np.stack([was_x - x, was_y - y], axis=-1)
    return {
        "color": color,
        "albedo": np.clip(albedo, 0, 1) * hit[..., None],
        "normal": normal,
        "depth": np.where(hit, depth, 0).astype(np.float32),
        "motion": motion.astype(np.float32),
    }


def render_reference(
    mi: Any, scene: Any, camera: Camera, *, spp: int, seed: int, max_depth: int
) -> np.ndarray:
    """Render the ``(h, w, 3)`` reference radiance, in passes that bound the memory."""
    aim(mi, scene, camera)
    integrator = mi.load_dict({"type": "path", "max_depth": max_depth})
    passes = max(1, spp // 64)
    total: np.ndarray | None = None
    for index in range(passes):
        part = np.array(
            mi.render(scene, integrator=integrator, spp=max(1, spp // passes), seed=seed + index),
            np.float64,
        )[..., :3]
        total = part if total is None else total + part
    assert total is not None
    return (total / passes).astype(np.float32)

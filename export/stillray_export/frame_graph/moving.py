"""A short sequence with all that a frame graph must follow: a camera that moves over curved ground,
a nearer thing that moves otherwise, a mirror that shows what is farther away, sky, a lamp that is
switched on, a cut, and values that no renderer should write."""

from __future__ import annotations

import numpy as np

from stillray.frame import Frame

#: Frames at which a lamp is switched on, and after which all is elsewhere.
LAMP, CUT = 3, 5


def sequence(count: int, height: int, width: int, *, broken: bool = True) -> list[Frame]:
    """``count`` frames; with ``broken`` some pixels are NaN, infinite or negative."""
    rng = np.random.default_rng(height * width)
    return [_frame(i, height, width, rng, broken=broken) for i in range(count)]


def _texture(u: np.ndarray, v: np.ndarray, phase: float) -> np.ndarray:
    return 0.5 + 0.4 * np.sin(u / 7 + phase) * np.cos(v / 5 - phase)


def _frame(index: int, height: int, width: int, rng: np.random.Generator, *, broken: bool) -> Frame:
    time = index if index < CUT else index + 40
    y, x = np.mgrid[:height, :width].astype(np.float64)
    u, v = x + 1.3 * time, y + 0.4 * time
    depth = 10 + 2 * np.sin(u / 40) + 1.5 * np.cos(v / 33)
    motion = np.stack([13 / depth, 4 / depth], -1)
    albedo = np.stack([_texture(u, v, phase) for phase in (0, 1, 2)], -1)
    normal = np.stack([0.3 * np.sin(u / 40), 0.3 * np.cos(v / 33), np.ones_like(u)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    light = 1 + 0.5 * np.sin(u / 50)
    if index == LAMP:
        light *= np.where(x > width / 2, 4, 1)
    middle = width * 0.3 + 3.1 * time % (width * 0.5)
    thing = (abs(x - middle) < width / 8) & (abs(y - height / 2) < height / 6)
    mirror = (x > width * 0.6) & (y > height * 0.55) & ~thing
    depth[thing], motion[thing] = 4, (-3.1, 0)
    albedo[thing], normal[thing] = (0.8, 0.2, 0.1), (0, 0, 1)
    albedo[mirror] = 0
    sky = y < height * 0.08
    depth[sky] = 0
    normal[sky] = albedo[sky] = 0
    color = light[..., None] * np.where(albedo.max(-1, keepdims=True) < 1e-3, 1, albedo)
    color[mirror] *= (0.5 + 0.5 * _texture(u + 0.6 * time, v, 1))[mirror][:, None]
    color *= rng.gamma(1.0, 1.0, (height, width, 1))
    color[rng.random(depth.shape) < 0.002] *= 100
    if broken:
        for array, share, value in (
            (color, 0.003, np.nan),
            (color, 0.001, np.inf),
            (color, 0.002, -0.1),
            (depth, 0.001, np.inf),
            (motion, 0.001, np.nan),
            (normal, 0.001, np.nan),
        ):
            array[rng.random(depth.shape) < share] = value
    buffers = {"albedo": albedo, "normal": normal, "depth": depth, "motion": motion}
    return Frame(
        color=color.astype(np.float32),
        **{name: array.astype(np.float32) for name, array in buffers.items()},
    )

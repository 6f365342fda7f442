"""Plants: stems, leaves, trees; foliage is what occludes by many small bits."""

from __future__ import annotations

import numpy as np

from stillray_training.simulate.generators.build import Builder, lift
from stillray_training.simulate.mesh import Mesh, join, lathe, rotation, tube
from stillray_training.simulate.world import Surface


def plant(b: Builder, at: np.ndarray, height: float, group: str = "") -> None:
    """A plant in a pot, ``height`` metres of leaves above it."""
    if b.stand_in("plant", at, [0.36 * height, height, 0.36 * height]):
        return
    r = height * b.between(0.15, 0.3)
    profile = [
        (0, 0),
        (0.75 * r, 0),
        (r, 1.4 * r),
        (0.92 * r, 1.4 * r),
        (0.9 * r, 1.2 * r),
        (0, 1.2 * r),
    ]
    b.add(lathe(profile), b.plain(gloss=0.4), at=at, group=group)
    top = at @ lift(0, 1.2 * r, 0)
    style = b.pick("bush", "blades", "palm")
    leaf = Surface(color=_green(b), two_sided=True, roughness=0.3 if b.chance(0.4) else None)
    stem = Surface(color=(0.12, 0.1, 0.05))
    if style == "blades":
        blades = [
            _blade(b, height * b.between(0.6, 1.1), height * 0.04)
            for _ in range(b.rng.integers(8, 20))
        ]
        b.add(join(blades), leaf, at=top, group=group)
        return
    stems, places = [], []
    for _ in range(int(b.rng.integers(4, 10))):
        lean = b.rng.normal(size=2) * (0.45 if style == "bush" else 0.3)
        t = np.linspace(0, 1, 8)[:, None]
        line = height * b.between(0.5, 1.0) * np.hstack([lean[0] * t**1.5, t, lean[1] * t**1.5])
        stems.append(tube(line, height * 0.008, sides=5))
        start = 2 if style == "bush" else 6
        for point in line[start:]:
            places += [point] * int(b.rng.integers(2, 5))
    b.add(join(stems), stem, at=top, group=group)
    b.add(_leaves(b, np.array(places), 0.1 * height, 0.24 * height), leaf, at=top, group=group)


def tree(b: Builder, at: np.ndarray, height: float) -> None:
    """A trunk, branches, and a crown of leaves."""
    bark = Surface(
        color=(0.16, 0.11, 0.07),
        texture=b.texture("noise", (0.08, 0.05, 0.03), (0.25, 0.18, 0.12), 0.5),
    )
    leaf = Surface(color=_green(b), two_sided=True)
    wood, places = [], []
    trunk = np.array([[0, 0, 0], [0.03, 0.25, 0.01], [0.0, 0.5, 0.03]]) * height
    wood.append(tube(trunk, 0.025 * height, sides=10))
    for _ in range(int(b.rng.integers(8, 16))):
        start = trunk[-1] * b.between(0.7, 1.0)
        heading = b.rng.normal(size=3) * [1, 0.4, 1] + [0, 0.7, 0]
        heading *= height * b.between(0.2, 0.4) / np.linalg.norm(heading)
        t = np.linspace(0, 1, 5)[:, None]
        line = start + heading * t + [0, 0.06 * height, 0] * np.sin(np.pi * t / 2)
        wood.append(tube(line, 0.008 * height, sides=6))
        for point in line[2:]:
            count = int(b.rng.integers(20, 60))
            places.append(point + b.rng.normal(size=(count, 3)) * 0.07 * height)
    b.add(join(wood), bark, at=at)
    crown = _leaves(b, np.concatenate(places), 0.02 * height, 0.05 * height)
    b.add(crown, leaf, at=at)


def _green(b: Builder) -> tuple[float, float, float]:
    light = b.between(0.15, 0.5)
    return (light * b.between(0.3, 0.9), light, light * b.between(0.1, 0.5))


def _leaves(b: Builder, points: np.ndarray, low: float, high: float) -> Mesh:
    """Pointed leaves, folded along their middle, one at each of ``(n, 3)`` points, all ways."""
    n = len(points)
    long = b.rng.uniform(low, high, n)
    wide, fold = long * b.rng.uniform(0.3, 0.6, n), long * 0.08
    zero = np.zeros(n)
    corners = np.stack([
        np.stack([zero, zero, zero], -1), np.stack([wide / 2, fold, long / 2], -1),
        np.stack([zero, zero, long], -1), np.stack([-wide / 2, fold, long / 2], -1),
    ], axis=1)  # fmt: skip
    turn = _turns(1, b.rng.uniform(0, 360, n)) @ _turns(0, b.rng.uniform(-60, 50, n))
    turn = turn @ _turns(2, b.rng.uniform(-40, 40, n))
    placed = corners @ turn.transpose(0, 2, 1) + points[:, None]
    faces = np.array([[0, 2, 1], [0, 3, 2]]) + 4 * np.arange(n)[:, None, None]
    return Mesh(
        vertices=placed.reshape(-1, 3),
        normals=np.repeat(turn[:, :, 1], 4, axis=0),
        uvs=corners[..., [0, 2]].reshape(-1, 2),
        faces=faces.reshape(-1, 3),
    )


def _turns(axis: int, degrees: np.ndarray) -> np.ndarray:
    """``(n, 3, 3)`` right-handed rotations about one coordinate axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    u, v = (axis + 1) % 3, (axis + 2) % 3
    turns = np.zeros((len(degrees), 3, 3))
    turns[:, axis, axis] = 1
    turns[:, u, u], turns[:, v, v], turns[:, v, u], turns[:, u, v] = c, c, s, -s
    return turns


def _blade(b: Builder, height: float, width: float) -> Mesh:
    """A long bent blade of grass."""
    t = np.linspace(0, 1, 7)
    bend = b.between(0.1, 0.8)
    middle = np.stack([0 * t, height * t * (1 - 0.3 * bend * t), height * bend * t**2], 1)
    half = (width / 2 * np.sqrt(np.clip(1 - t, 0.02, 1)))[:, None] * [1.0, 0, 0]
    vertices = np.concatenate([middle - half, middle + half])
    slope = np.gradient(middle, axis=0)
    normal = np.cross(slope, [1.0, 0, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    low = np.arange(6)
    faces = np.concatenate(
        [np.stack([low, low + 1, low + 7], 1), np.stack([low + 1, low + 8, low + 7], 1)]
    )
    mesh = Mesh(
        vertices=vertices,
        normals=np.concatenate([normal, normal]),
        uvs=vertices[:, :2],
        faces=faces,
    )
    # wound the way the normals point
    a, c, d = (mesh.vertices[mesh.faces[0, i]] for i in range(3))
    if np.cross(c - a, d - a) @ mesh.normals[mesh.faces[0, 0]] < 0:
        mesh = Mesh(
            vertices=mesh.vertices, normals=mesh.normals, uvs=mesh.uvs, faces=mesh.faces[:, ::-1]
        )
    foot = lift(*(b.rng.normal(size=2) @ np.array([[1, 0, 0], [0, 0, 1]]) * 0.03 * height))
    return mesh.moved(foot @ rotation([0, 1, 0], b.between(0, 360)))

"""Triangle meshes as arrays: the few shapes that rooms and their contents are built of.

All are closed or thin, wound counter-clockwise seen from outside, with their own normals.
Texture coordinates are in metres along the surface, so a texture keeps its size on any piece.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Vector = Sequence[float] | np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """A triangle mesh with a normal and a texture coordinate at each vertex."""

    vertices: np.ndarray  # (n, 3) metres, y up
    normals: np.ndarray  # (n, 3) unit
    uvs: np.ndarray  # (n, 2) metres along the surface
    faces: np.ndarray  # (m, 3) indices, counter-clockwise from outside

    def moved(self, matrix: np.ndarray) -> Mesh:
        """The mesh under a ``(4, 4)`` transform, mirrored ones included."""
        linear = matrix[:3, :3]
        normals = self.normals @ np.linalg.inv(linear)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        flipped = np.linalg.det(linear) < 0
        return Mesh(
            vertices=self.vertices @ linear.T + matrix[:3, 3],
            normals=normals / np.maximum(length, 1e-12),
            uvs=self.uvs,
            faces=self.faces[:, ::-1] if flipped else self.faces,
        )

    def area(self) -> float:
        """Surface area in square metres."""
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def join(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes as one."""
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    return Mesh(
        vertices=np.concatenate([mesh.vertices for mesh in meshes]),
        normals=np.concatenate([mesh.normals for mesh in meshes]),
        uvs=np.concatenate([mesh.uvs for mesh in meshes]),
        faces=np.concatenate([m.faces + s for m, s in zip(meshes, starts, strict=True)]),
    )


def translation(offset: Vector) -> np.ndarray:
    """``(4, 4)`` translation."""
    matrix = np.eye(4)
    matrix[:3, 3] = offset
    return matrix


def rotation(axis: Vector, degrees: float) -> np.ndarray:
    """``(4, 4)`` right-handed rotation about an axis through the origin (Rodrigues)."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    matrix = np.eye(4)
    matrix[:3, :3] += np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return matrix


def quad(corner: Vector, along_u: Vector, along_v: Vector) -> Mesh:
    """A parallelogram that faces ``along_u x along_v``."""
    corner, u, v = (np.asarray(a, float) for a in (corner, along_u, along_v))
    normal = np.cross(u, v)
    normal /= np.linalg.norm(normal)
    width, height = np.linalg.norm(u), np.linalg.norm(v)
    return Mesh(
        vertices=np.array([corner, corner + u, corner + u + v, corner + v]),
        normals=np.tile(normal, (4, 1)),
        uvs=np.array([[0, 0], [width, 0], [width, height], [0, height]]),
        faces=np.array([[0, 1, 2], [0, 2, 3]]),
    )


def box(centre: Vector, size: Vector) -> Mesh:
    """An axis-aligned box of ``size`` metres around ``centre``."""
    half = np.asarray(size, float) / 2
    sides = []
    for axis in range(3):
        u_axis, v_axis = (axis + 1) % 3, (axis + 2) % 3
        # the longer side runs along v, as planks and fabrics do
        for sign in (-1.0, 1.0):
            corner = -half * np.ones(3)
            corner[axis] = sign * half[axis]
            u, v = np.zeros(3), np.zeros(3)
            u[u_axis], v[v_axis] = 2 * half[u_axis], 2 * half[v_axis]
            if sign < 0:
                u, v = v, u
            sides.append(quad(corner, u, v))
    return join(sides).moved(translation(centre))


def lathe(profile: Sequence[Vector] | np.ndarray, *, segments: int = 24) -> Mesh:
    """A surface of revolution about y.

    Parameters
    ----------
    profile
        ``(radius, height)`` points in metres; the outside lies to the right of the way they go
        (upwards along the outside). Corners sharper than 40 degrees stay sharp.
    segments
        Points around the axis, 3 or more.
    """
    points = np.asarray(profile, float)
    steps = np.diff(points, axis=0)
    length = np.linalg.norm(steps, axis=1)
    points = points[np.concatenate([[True], length > 1e-9])]
    steps, length = steps[length > 1e-9], length[length > 1e-9]
    outward = np.stack([steps[:, 1], -steps[:, 0]], axis=1) / length[:, None]
    angle = np.linspace(0, 2 * np.pi, segments + 1)
    turn = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    along = np.concatenate([[0], np.cumsum(length)])
    bands = []
    for i in range(len(steps)):
        ends = []
        for end, other in ((i, i - 1), (i + 1, i + 1)):
            normal = outward[i]
            if 0 <= other < len(steps) and outward[i] @ outward[other] > np.cos(np.radians(40)):
                normal = outward[i] + outward[other]
            ends.append((points[end], normal / np.linalg.norm(normal), along[end]))
        bands.append(_band(ends, turn, angle))
    return join(bands)


def _band(ends: list[tuple], turn: np.ndarray, angle: np.ndarray) -> Mesh:
    vertices, normals, uvs = [], [], []
    radius = max(ends[0][0][0], ends[1][0][0])
    for point, normal, along in ends:
        flat = np.full(len(turn), 1.0)
        vertices.append(
            np.stack([point[0] * turn[:, 0], point[1] * flat, point[0] * turn[:, 1]], 1)
        )
        normals.append(
            np.stack([normal[0] * turn[:, 0], normal[1] * flat, normal[0] * turn[:, 1]], 1)
        )
        uvs.append(np.stack([angle * radius, along * flat], 1))
    n = len(turn)
    low = np.arange(n - 1)
    faces = np.concatenate(
        [np.stack([low, low + n, low + 1], 1), np.stack([low + 1, low + n, low + n + 1], 1)]
    )
    return Mesh(
        vertices=np.concatenate(vertices),
        normals=np.concatenate(normals),
        uvs=np.concatenate(uvs),
        faces=faces,
    )


def cylinder(foot: Vector, radius: float, height: float, *, segments: int = 20) -> Mesh:
    """An upright closed cylinder that stands on ``foot``."""
    profile = [(0, 0), (radius, 0), (radius, height), (0, height)]
    return lathe(profile, segments=segments).moved(translation(foot))


def sphere(centre: Vector, radius: float, *, rings: int = 16) -> Mesh:
    """A sphere, its poles on y."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    profile = np.stack([np.cos(angle), np.sin(angle)], 1) * radius
    profile[[0, -1], 0] = 0
    return lathe(profile, segments=2 * rings).moved(translation(centre))


def tube(points: Sequence[Vector] | np.ndarray, radius: float, *, sides: int = 8) -> Mesh:
    """A round rod along a polyline: cables, rails, stems, branches."""
    line = np.asarray(points, float)
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    helper = np.array([0, 0, 1.0]) if abs(tangent[0, 1]) > 0.9 else np.array([0, 1.0, 0])
    first, second = np.zeros_like(line), np.zeros_like(line)
    for i, t in enumerate(tangent):  # the frame is carried along, so that it does not twist
        helper = helper - (helper @ t) * t
        helper /= np.linalg.norm(helper)
        first[i], second[i] = helper, np.cross(t, helper)
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    ring = np.cos(angle)[None, :, None] * first[:, None] + (
        np.sin(angle)[None, :, None] * second[:, None]
    )
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    uvs = np.stack(np.broadcast_arrays(angle[None] * radius, along[:, None]), axis=-1)
    return _grid(line[:, None] + radius * ring, ring, uvs)


def sheet(heights: np.ndarray, width: float, height: float) -> Mesh:
    """A relief over the x-y plane that faces +z: curtains, towels, ground.

    Parameters
    ----------
    heights : (rows, columns)
        Displacement along z in metres; row 0 lies at y = 0.
    width, height
        Extent along x and y in metres.
    """
    rows, columns = heights.shape
    y, x = np.mgrid[0:rows, 0:columns].astype(float)
    x, y = x * width / (columns - 1), y * height / (rows - 1)
    dy, dx = np.gradient(heights, height / (rows - 1), width / (columns - 1))
    normals = np.stack([-dx, -dy, np.ones_like(dx)], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return _grid(np.stack([x, y, heights], -1), normals, np.stack([x, y], -1))


def _grid(vertices: np.ndarray, normals: np.ndarray, uvs: np.ndarray) -> Mesh:
    rows, columns = vertices.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    )
    return Mesh(
        vertices=vertices.reshape(-1, 3),
        normals=normals.reshape(-1, 3),
        uvs=uvs.reshape(-1, 2),
        faces=faces,
    )

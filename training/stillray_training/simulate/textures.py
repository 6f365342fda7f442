"""Procedural pictures: reflectance patterns, roughness maps, skies."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

KINDS = (
    "checker", "planks", "wood", "marble", "noise", "tiles", "brick", "weave", "stripes", "print",
    "painting", "terrazzo", "parquet", "plaid", "damask", "carpet", "plaster", "panels", "moulding",
    "ribs", "quilt", "louvres", "scenery",
)  # fmt: skip
_FONTS = (cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_COMPLEX, cv2.FONT_HERSHEY_TRIPLEX)


@dataclass(frozen=True, kw_only=True)
class Texture:
    """A seeded picture of reflectances: nothing is computed until it is asked for."""

    kind: str  # one of KINDS
    seed: int
    low: tuple[float, float, float]  # reflectance where the pattern is 0
    high: tuple[float, float, float]  # reflectance where the pattern is 1
    size: float = 1.0  # metres on the surface that the picture spans
    pixels: int = 256

    def pattern(self) -> np.ndarray:
        """``(pixels, pixels)`` in [0, 1]."""
        return pattern(self.kind, np.random.default_rng(self.seed), self.pixels)

    def image(self) -> np.ndarray:
        """``(pixels, pixels, 3)`` float32 reflectances, linear."""
        if self.kind == "painting":
            return painting(np.random.default_rng(self.seed), self.pixels)
        if self.kind == "scenery":
            return scenery(np.random.default_rng(self.seed), self.pixels)
        low, high = np.array(self.low, np.float32), np.array(self.high, np.float32)
        return low + (high - low) * self.pattern()[..., None]


@dataclass(frozen=True, kw_only=True)
class Relief:
    """Heights that only normals show: those of a picture's pattern.

    With the ``Texture`` that is a surface's reflectance the two lie on one another: joints are dark
    and deep.
    """

    picture: Texture  # its pattern: 0 lies ``depth`` below 1
    depth: float = 0.002  # metres, above 0
    bevel: float = 1.2  # Gaussian that rounds the edges, standard deviation in pixels

    def normals(self) -> np.ndarray:
        """``(pixels, pixels, 3)`` float32: x right, y up, z out, each as (n + 1) / 2."""
        height = cv2.GaussianBlur(self.picture.pattern(), (0, 0), self.bevel) * self.depth
        step = 2 * self.picture.size / self.picture.pixels
        slope_x = (np.roll(height, -1, axis=1) - np.roll(height, 1, axis=1)) / step
        slope_y = (np.roll(height, 1, axis=0) - np.roll(height, -1, axis=0)) / step
        normal = np.stack([-slope_x, -slope_y, np.ones_like(height)], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        return np.asarray((normal + 1) / 2, np.float32)


def pattern(kind: str, rng: np.random.Generator, size: int = 256) -> np.ndarray:
    """A seeded ``(size, size)`` float32 pattern that fills [0, 1]."""
    row, column = np.mgrid[0:size, 0:size].astype(np.float32) / size
    soft, fine = noise(rng, size, int(rng.choice([4, 8, 16]))), noise(rng, size, size // 4)
    if kind == "checker":
        n = 2 * int(rng.integers(1, 6))
        plane = ((row * n).astype(int) + (column * n).astype(int)) % 2 + 0.15 * soft
    elif kind == "planks":
        n = int(rng.integers(4, 10))
        board = (row * n).astype(int)
        shift = (column + rng.random(n)[board]) % 1.0
        seam = ((row * n) % 1 < 0.03) | (np.abs(shift - 0.5) < 0.003)
        grain = cv2.blur(noise(rng, size, size // 3), (size // 8 | 1, 1))
        plane = np.where(seam, 0, 0.35 + 0.4 * rng.random(n)[board] + 0.6 * (grain - 0.5))
    elif kind == "wood":
        rings = row * int(rng.integers(3, 10)) + 0.7 * cv2.blur(soft, (size // 4 | 1, 1))
        grain = cv2.blur(fine, (size // 10 | 1, 1))
        plane = 0.6 * np.abs((rings % 1) - 0.5) * 2 + 0.5 * grain
    elif kind == "marble":
        rough = sum(noise(rng, size, 4 * 2**i) / 2**i for i in range(5))
        plane = np.abs(np.sin(rng.uniform(3, 9) * (column + row * rng.uniform(-1, 1) + rough)))
        plane = plane ** rng.uniform(0.2, 0.6)
    elif kind == "noise":
        plane = sum(noise(rng, size, 4 * 2**i) / 1.6**i for i in range(6))
    elif kind == "terrazzo":
        chips = cv2.GaussianBlur(rng.random((size, size)).astype(np.float32), (0, 0), 3)
        plane = np.digitize(chips, np.quantile(chips, [0.6, 0.75, 0.9])) / 3 + 0.1 * fine
    elif kind in ("tiles", "brick"):
        n, wide = int(rng.integers(3, 12)), 2 if kind == "brick" else 1
        y = row * n * wide
        x = column * n + (0.5 * (y.astype(int) % 2) if kind == "brick" else 0)
        joint = (y % 1 < 0.05 * wide) | (x % 1 < 0.05)
        shade = rng.random((n * wide + 1, n + 1))[y.astype(int), x.astype(int)]
        plane = np.where(joint, 0, 0.55 + 0.3 * shade + 0.15 * fine)
    elif kind == "weave":
        n = int(rng.integers(24, 64))
        over = ((row * n).astype(int) + (column * n).astype(int)) % 2
        thread = np.where(over, np.sin(np.pi * ((row * n) % 1)), np.sin(np.pi * ((column * n) % 1)))
        plane = 0.7 * thread + 0.3 * over + 0.3 * soft
    elif kind == "stripes":
        edges = np.sort(rng.random(int(rng.integers(4, 24))))
        band = np.searchsorted(edges, column[0])
        plane = np.broadcast_to(rng.random(len(edges) + 1)[band], (size, size)) + 0.1 * fine
    elif kind == "scenery":
        plane = scenery(rng, size).mean(axis=-1)
    elif kind in ("print", "painting"):
        plane = _print(rng, size)
    elif kind in _FURTHER:
        plane = _FURTHER[kind](rng, row, column)
    else:
        raise ValueError(kind)
    low, high = float(plane.min()), float(plane.max())
    return np.asarray((plane - low) / max(high - low, 1e-6), np.float32)


def _parquet(rng: np.random.Generator, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Squares of staves that lie across and along in turn."""
    n, staves = int(rng.integers(2, 5)), int(rng.integers(3, 6))
    across = ((row * n).astype(int) + (column * n).astype(int)) % 2 > 0
    along, over = np.where(across, row, column) * n % 1, np.where(across, column, row) * n % 1
    stave = (over * staves).astype(int)
    cell = ((row * n).astype(int) * n + (column * n).astype(int)) * staves + stave
    size = len(row)
    grain = noise(rng, size, size // 3)
    fibre = np.where(
        across, cv2.blur(grain, (1, size // 16 | 1)), cv2.blur(grain, (size // 16 | 1, 1))
    )
    seam = (over * staves % 1 < 0.06) | (along < 0.015)
    tone = 0.35 + 0.35 * rng.random(n * n * staves)[np.minimum(cell, n * n * staves - 1)]
    return np.where(seam, 0, tone + 0.8 * (fibre - 0.5))


def _plaid(rng: np.random.Generator, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Bands that cross, in a twill."""
    n = int(rng.integers(2, 5))
    edges, tone = np.sort(rng.random(6)), rng.random(7)
    bands = tone[np.searchsorted(edges, row * n % 1)] + tone[np.searchsorted(edges, column * n % 1)]
    return bands + 0.25 * (((row + column) * 96).astype(int) % 2)


def _damask(rng: np.random.Generator, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """A mirrored ornament that repeats, as wallpapers and brocades show."""
    n, size = int(rng.integers(2, 7)), len(row)
    tile = noise(rng, size, 12)
    u, v = np.abs(column * n % 1 - 0.5) * 2, (row * n + 0.5 * ((column * n).astype(int) % 2)) % 1
    ornament = tile[(v * (size - 1)).astype(int) // 2, (u * (size - 1)).astype(int) // 2]
    level = np.quantile(ornament, rng.uniform(0.4, 0.7))
    return (ornament > level) + 0.5 * (np.abs(ornament - level) < 0.03)


def _carpet(rng: np.random.Generator, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Pile: fine tufts, trodden in soft patches."""
    size = len(row)
    return (
        noise(rng, size, size // 2) + 0.5 * noise(rng, size, size // 6) + 0.4 * noise(rng, size, 6)
    )


def _plaster(rng: np.random.Generator, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Trowelled plaster: flat ridges in all ways, few fine grains."""
    size = len(row)
    turn = np.abs(noise(rng, size, 9) - 0.5) + np.abs(noise(rng, size, 17) - 0.5)
    return -turn + 0.5 * noise(rng, size, 40) + 0.15 * noise(rng, size, size // 3)


def _panels(rng: np.random.Generator, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Raised panels in a frame: doors, wainscots."""
    rows, columns = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    edge = _edge_distance(
        row * rows % 1, column * columns % 1, rows, columns, rng.uniform(0.05, 0.1)
    )
    groove = rng.uniform(0.012, 0.025)
    rise = np.clip((edge - groove) / (2 * groove), 0, 1)
    return np.where(edge < 0, 1, np.where(edge < groove, 0, 0.85 * rise * rise * (3 - 2 * rise)))


def _moulding(rng: np.random.Generator, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Thin raised frames on a flat wall."""
    edge = _edge_distance(row, column, 1, 1, rng.uniform(0.06, 0.12))
    width = rng.uniform(0.015, 0.035)
    bead = np.sin(np.pi * np.clip(edge / width, 0, 1))
    return bead + 0.5 * np.sin(np.pi * np.clip((edge - 0.4 * width) / (0.3 * width), 0, 1))


def _edge_distance(
    row: np.ndarray, column: np.ndarray, rows: int, columns: int, margin: float
) -> np.ndarray:
    """Distance into a panel from the inner edge of its frame, parts of the picture; < 0 on it."""
    down = np.minimum(row, 1 - row) / rows
    across = np.minimum(column, 1 - column) / columns
    return np.minimum(down, across) - margin / max(rows, columns)


def _ribs(rng: np.random.Generator, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Upright boards or flutes with a groove between them."""
    n = int(rng.integers(6, 20))
    along = column * n % 1
    if rng.random() < 0.5:
        return np.sqrt(np.clip(1 - (2 * along - 1) ** 2, 0, 1)) + 0 * row
    return np.clip(np.minimum(along, 1 - along) / 0.06, 0, 1) + 0 * row


def _quilt(rng: np.random.Generator, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Tufts between crossing seams: leather, mattresses."""
    n = int(rng.integers(4, 12))
    u, v = (row + column) * n % 1, (row - column) * n % 1
    return np.sqrt(np.sin(np.pi * u) * np.sin(np.pi * v)) + 0.03 * noise(
        rng, len(row), len(row) // 4
    )


def _louvres(rng: np.random.Generator, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Slanting slats in a frame."""
    n = int(rng.integers(12, 30))
    inside = (np.minimum(column, 1 - column) > 0.08) & (np.minimum(row, 1 - row) > 0.05)
    return np.where(inside, 0.9 * (row * n % 1), 1)


_FURTHER = {
    "parquet": _parquet, "plaid": _plaid, "damask": _damask, "carpet": _carpet, "plaster": _plaster,
    "panels": _panels, "moulding": _moulding, "ribs": _ribs, "quilt": _quilt, "louvres": _louvres,
}  # fmt: skip


def _print(rng: np.random.Generator, size: int) -> np.ndarray:
    """Lines of letters on paper, as books, labels and screens show."""
    page = np.full((size, size), 255, np.uint8)  # cv2 writes into bytes only
    scale = float(rng.uniform(0.25, 1.2)) * size / 384
    height = int(34 * scale) + 2
    letters = np.array(list("abcdefghiklmnoprstuvw     ABCDEHMNORST0123456789"))
    for y in range(height, size - height // 2, height):
        if rng.random() < 0.12:
            continue  # a paragraph ends
        text = "".join(rng.choice(letters, int(rng.integers(12, 90))))
        font = int(rng.choice(_FONTS))
        cv2.putText(page, text, (int(0.04 * size), y), font, scale, 0, 1, cv2.LINE_AA)
    if rng.random() < 0.5:
        left, top = (int(v) for v in rng.integers(size // 8, size // 2, 2))
        cv2.rectangle(page, (left, top), (left + size // 3, top + size // 4), 100, -1)
    return page.astype(np.float32)


def painting(rng: np.random.Generator, size: int) -> np.ndarray:
    """``(size, size, 3)`` float32: blots of colour in layers, as pictures and covers show."""
    canvas = np.tile(rng.uniform(0.1, 0.8, 3).astype(np.float32), (size, size, 1))
    for _ in range(int(rng.integers(6, 40))):
        color = [float(v) for v in np.clip(rng.beta(0.8, 1.0, 3), 0.02, 0.95)]
        x, y = (int(v) for v in rng.integers(0, size, 2))
        kind = rng.integers(4)
        if kind == 0:
            cv2.circle(canvas, (x, y), int(rng.integers(4, size // 4)), color, -1, cv2.LINE_AA)
        elif kind == 1:
            end = tuple(int(v) for v in rng.integers(0, size, 2))
            cv2.line(canvas, (x, y), end, color, int(rng.integers(1, size // 20)), cv2.LINE_AA)
        elif kind == 2:
            end = tuple(int(v) for v in rng.integers(0, size, 2))
            cv2.rectangle(canvas, (x, y), end, color, -1 if rng.random() < 0.6 else 3)
        else:
            axes = tuple(int(v) for v in rng.integers(4, size // 3, 2))
            turn = float(rng.uniform(0, 180))
            cv2.ellipse(canvas, (x, y), axes, turn, 0, 360, color, -1, cv2.LINE_AA)
    grain = noise(rng, size, size // 4)[..., None]
    return np.clip(canvas * (0.8 + 0.4 * grain), 0.02, 0.95)


def scenery(rng: np.random.Generator, size: int) -> np.ndarray:
    """``(size, size, 3)`` float32: hills under a sky, in haze, as photographs on walls show."""
    row = np.mgrid[0:size, 0:size][0].astype(np.float32) / size
    sky_tone, land = rng.uniform(0.4, 0.85, 3), rng.uniform(0.05, 0.4, 3) * [1.0, 1.05, 0.8]
    clouds = sum(noise(rng, size, 5 * 2**i) / 2**i for i in range(5))[..., None]
    image = sky_tone * (0.75 + 0.25 * row[..., None]) + 0.12 * (clouds - 1)
    ridges = int(rng.integers(2, 6))
    for index in range(ridges):
        near = (index + 1) / ridges
        crest = noise(rng, size, int(rng.integers(3, 8)))[0] + 0.25 * noise(rng, size, size // 8)[0]
        line = 0.35 + 0.5 * near - 0.22 * crest
        rough = 0.7 + 0.6 * noise(rng, size, size // 6)[..., None]
        tone = (land * near + sky_tone * (1 - near) * 0.8) * rough
        image = np.where((row > line[None])[..., None], tone, image)
    border = rng.random() < 0.4  # a passe-partout
    if border:
        edge = np.minimum(row, 1 - row)
        inside = np.minimum(edge, edge.T) > 0.12
        image = np.where(inside[..., None], image, 0.75)
    return np.clip(image, 0.02, 0.9).astype(np.float32)


def noise(rng: np.random.Generator, size: int, cells: int) -> np.ndarray:
    """``(size, size)`` float32 value noise in [0, 1] with that many cells a side."""
    cells = max(2, min(cells, size))
    grid = rng.random((cells, cells)).astype(np.float32)
    return np.clip(cv2.resize(grid, (size, size), interpolation=cv2.INTER_CUBIC), 0, 1)


def sky(kind: str, rng: np.random.Generator, height: int = 128) -> np.ndarray:
    """A ``(height, 2 height, 3)`` float32 equirectangular sky and ground, y up, mean about 1.

    Parameters
    ----------
    kind
        ``"clear"``, ``"cloudy"``, ``"dusk"``, ``"night"`` or ``"studio"``.
    rng
        Clouds, tints, the place of studio lights.
    height
        Rows; row 0 is the zenith.
    """
    elevation = np.linspace(np.pi / 2, -np.pi / 2, height, dtype=np.float32)[:, None, None]
    up = np.clip(np.sin(elevation), 0, 1)
    if kind == "studio":
        image = np.full((height, 2 * height, 3), 0.15, np.float32)
        for _ in range(int(rng.integers(1, 5))):
            x, y = int(rng.integers(2 * height)), int(rng.integers(height // 8, height // 2))
            w, h = (int(v) for v in rng.integers(height // 16, height // 4, 2))
            tint = np.exp(rng.normal(size=3) * 0.1) * rng.uniform(4, 20)
            image[max(y - h, 0) : y + h, max(x - w, 0) : x + w] = tint
        return image / image.mean()
    zenith, horizon = {
        "clear": ([0.25, 0.45, 1.0], [0.9, 1.0, 1.1]),
        "cloudy": ([0.9, 0.95, 1.0], [0.8, 0.8, 0.8]),
        "dusk": ([0.2, 0.25, 0.5], [1.6, 0.8, 0.4]),
        "night": ([0.3, 0.4, 0.8], [0.6, 0.5, 0.5]),
    }[kind]
    above, low = np.array(zenith, np.float32), np.array(horizon, np.float32)
    blend = (1 - up) ** rng.uniform(1.5, 4)
    image = np.tile(above * (1 - blend) + low * blend, (1, 2 * height, 1))
    clouds = sum(noise(rng, 2 * height, 4 * 2**i) / 2**i for i in range(5))[:height]
    cover = np.clip((clouds - np.quantile(clouds, rng.uniform(0.2, 0.9))) * 4, 0, 1)[..., None]
    image = image * (1 - cover) + np.array([1.2, 1.2, 1.25], np.float32) * low * cover
    ground = rng.uniform(0.1, 0.35) * np.exp(rng.normal(size=3) * 0.2)
    image = np.where(elevation < 0, ground, image)
    return np.asarray(image / image.mean(), np.float32)

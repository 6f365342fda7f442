"""Small things on tables, shelves and floors."""

from __future__ import annotations

import numpy as np

from stillray_training.simulate.generators.build import Builder, lift
from stillray_training.simulate.mesh import box, cylinder, join, lathe, quad, rotation, sphere, tube
from stillray_training.simulate.world import Surface

KINDS = (
    "vase",
    "bottle",
    "tumbler",
    "bowl",
    "fruit",
    "books",
    "plate",
    "mug",
    "candle",
    "box",
    "ball",
    "frame",
    "toy",
    "pot_plant",
    "cable",
    "pens",
    "can",
)


def thing(b: Builder, at: np.ndarray, *, scale: float = 1.0, kind: str | None = None) -> None:
    """One small thing that stands at the origin of a ``(4, 4)`` transform."""
    if kind is None and b.stand_in("thing", at, [0.25 * scale] * 3):
        return
    kind = kind or b.pick(*KINDS)
    size = np.diag([scale, scale, scale, 1.0])
    turned = at @ rotation([0, 1, 0], b.between(0, 360)) @ size
    group = b.can_move(f"{kind}{len(b.spots)}", at, "thing")
    _MAKERS[kind](b, turned, group)


def things(b: Builder, at: np.ndarray, width: float, depth: float, count: int) -> None:
    """Several things spread over a table top whose middle is the transform's origin."""
    spots: list[tuple[float, float]] = []
    for _ in range(count):
        for _ in range(8):
            x, z = b.between(-width / 2, width / 2) * 0.85, b.between(-depth / 2, depth / 2) * 0.85
            if all(np.hypot(x - u, z - v) > 0.16 for u, v in spots):
                spots.append((x, z))
                thing(b, at @ lift(x, 0, z), scale=b.between(0.8, 1.2))
                break


def _vase(b: Builder, at: np.ndarray, group: str) -> None:
    h = b.between(0.12, 0.35)
    y = np.linspace(0, h, 14)
    radius = 0.035 + 0.04 * np.sin(np.linspace(0.4, b.between(2.2, 3.4), 14)) ** 2
    outside = np.stack([radius, y], 1)
    inside = np.stack([radius[::-1] - 0.004, y[::-1]], 1)
    profile = [(0, 0), *outside, *inside[:-1], (0, 0.01)]
    surface = b.shiny() if b.chance(0.5) else b.accent()
    b.add(lathe(profile, segments=32), surface, at=at, group=group)
    if b.chance(0.5):
        _twigs(b, at @ lift(0, h * 0.6, 0), b.between(0.2, 0.4), group)


def _twigs(b: Builder, at: np.ndarray, height: float, group: str) -> None:
    stem = Surface(color=(0.15, 0.12, 0.06))
    bloom = b.accent()
    stems, blooms = [], []
    for _ in range(int(b.rng.integers(3, 9))):
        lean = b.rng.normal(size=2) * 0.25
        t = np.linspace(0, 1, 6)[:, None]
        line = np.hstack([lean[0] * t**1.6, t, lean[1] * t**1.6]) * height * b.between(0.6, 1)
        stems.append(tube(line, 0.0025, sides=5))
        blooms.append(sphere(line[-1], b.between(0.008, 0.025), rings=6))
    b.add(join(stems), stem, at=at, group=group)
    b.add(join(blooms), bloom, at=at, group=group)


def _bottle(b: Builder, at: np.ndarray, group: str) -> None:
    r, h = b.between(0.025, 0.045), b.between(0.18, 0.32)
    profile = [
        (0, 0),
        (r, 0),
        (r, 0.6 * h),
        (0.9 * r, 0.68 * h),
        (0.35 * r, 0.8 * h),
        (0.33 * r, h),
        (0, h),
    ]
    b.add(lathe(profile), b.glass() if b.chance(0.6) else b.shiny(), at=at, group=group)
    label = b.printed(0.2, kind="print")
    b.add(lathe([(r + 0.001, 0.15 * h), (r + 0.001, 0.45 * h)]), label, at=at, group=group)
    b.add(cylinder([0, h, 0], 0.36 * r, 0.02), b.accent(), at=at, group=group)


def _tumbler(b: Builder, at: np.ndarray, group: str) -> None:
    r, h = b.between(0.028, 0.042), b.between(0.08, 0.15)
    wide = r * b.between(1, 1.25)
    profile = [(0, 0), (r, 0), (wide, h), (wide - 0.003, h), (r - 0.003, 0.008), (0, 0.008)]
    b.add(lathe(profile), b.glass(), at=at, group=group)


def _bowl(b: Builder, at: np.ndarray, group: str) -> None:
    r = b.between(0.07, 0.15)
    angle = np.linspace(0.25, 1.35, 9)
    outside = np.stack([r * np.sin(angle), r * (np.cos(0.25) - np.cos(angle))], 1)
    inside = outside[::-1] * 0.95 + [0, 0.008]
    b.add(
        lathe([(0, 0), *outside, *inside, (0, 0.01)]),
        b.shiny() if b.chance(0.3) else b.plain(),
        at=at,
        group=group,
    )
    peel = b.plain(b.color(vivid=True), gloss=0.7)
    for _ in range(int(b.rng.integers(0, 5))):
        x, z = b.rng.normal(size=2) * r * 0.3
        ball = sphere([x, 0.4 * r + 0.02, z], b.between(0.028, 0.04), rings=10)
        b.add(ball, peel, at=at, group=group)


def _fruit(b: Builder, at: np.ndarray, group: str) -> None:
    r = b.between(0.03, 0.05)
    t = np.linspace(0, np.pi, 14)
    profile = np.stack([r * np.sin(t) * (1 - 0.15 * np.cos(t)), r * (1 - 0.9 * np.cos(t))], 1)
    profile[[0, -1], 0] = 0
    color = b.color(vivid=True, light=0.5)
    b.add(lathe(profile), b.plain(color, gloss=0.8), at=at, group=group)
    stem = tube([[0, 1.8 * r, 0], [0.004, 2.1 * r, 0], [0.01, 2.4 * r, 0]], 0.002, sides=5)
    b.add(stem, Surface(color=(0.12, 0.08, 0.04)), at=at, group=group)


def _books(b: Builder, at: np.ndarray, group: str) -> None:
    y = 0.0
    for _ in range(int(b.rng.integers(1, 6))):
        h = b.between(0.012, 0.045)
        w, d = b.between(0.13, 0.18), b.between(0.18, 0.25)
        turn = at @ lift(0, y, 0) @ rotation([0, 1, 0], b.between(-15, 15))
        b.block(
            [0, h / 2, 0.002],
            [w - 0.006, h - 0.006, d - 0.004],
            Surface(color=(0.7, 0.66, 0.58)),
            at=turn,
            group=group,
        )
        cover = b.printed(0.3) if b.chance(0.4) else b.plain(b.color(vivid=True), gloss=0.3)
        for level in (0.0015, h - 0.0015):
            b.block([0, level, 0], [w, 0.003, d], cover, at=turn, group=group)
        b.block([-w / 2, h / 2, 0], [0.003, h, d], cover, at=turn, group=group)
        y += h


def _plate(b: Builder, at: np.ndarray, group: str) -> None:
    r = b.between(0.08, 0.14)
    profile = [(0, 0), (0.6 * r, 0), (r, 0.018), (r, 0.022), (0.62 * r, 0.006), (0, 0.006)]
    b.add(lathe(profile, segments=32), b.plain(b.color(light=0.7), gloss=0.8), at=at, group=group)


def _mug(b: Builder, at: np.ndarray, group: str) -> None:
    r, h = b.between(0.035, 0.045), b.between(0.08, 0.11)
    profile = [(0, 0), (r, 0), (r, h), (r - 0.004, h), (r - 0.004, 0.008), (0, 0.008)]
    surface = b.plain(b.color(vivid=True), gloss=0.8)
    b.add(lathe(profile), surface, at=at, group=group)
    t = np.linspace(-1.3, 1.3, 9)
    ring = np.stack([r + 0.025 * np.cos(t) - 0.006, h / 2 + 0.03 * np.sin(t), 0 * t], 1)
    b.add(tube(ring, 0.005), surface, at=at, group=group)


def _candle(b: Builder, at: np.ndarray, group: str) -> None:
    r, h = b.between(0.012, 0.035), b.between(0.08, 0.22)
    b.add(cylinder([0, 0, 0], r, h), b.plain(b.color(light=0.75)), at=at, group=group)
    b.add(
        lathe([(0, 0), (2.2 * r, 0), (2.4 * r, 0.012), (0, 0.006)]), b.metal(), at=at, group=group
    )
    if b.chance(0.3):
        flame = lathe(
            [(0, h + 0.006), (0.006, h + 0.015), (0.003, h + 0.03), (0, h + 0.036)], segments=10
        )
        b.shine(flame, (900, 420, 120), at=at, group=group, around=True)


def _box(b: Builder, at: np.ndarray, group: str) -> None:
    w, h, d = b.rng.uniform([0.06, 0.04, 0.06], [0.25, 0.2, 0.2])
    surface = [b.printed(0.3), b.wood(), b.accent(), b.fabric()][b.rng.integers(4)]
    b.block([0, h / 2, 0], [w, h, d], surface, at=at, group=group)


def _ball(b: Builder, at: np.ndarray, group: str) -> None:
    r = b.between(0.03, 0.1)
    b.add(sphere([0, r, 0], r, rings=20), b.shiny(), at=at, group=group)


def _frame(b: Builder, at: np.ndarray, group: str) -> None:
    w, h = b.between(0.1, 0.2), b.between(0.12, 0.25)
    lean = at @ rotation([1, 0, 0], -12)
    b.block(
        [0, h / 2, 0], [w, h, 0.012], b.metal() if b.chance(0.4) else b.wood(), at=lean, group=group
    )
    face = quad([-w * 0.42, 0.06 * h, 0.0065], [w * 0.84, 0, 0], [0, 0.88 * h, 0])
    b.add(face, b.printed(w), at=lean, group=group)


def _toy(b: Builder, at: np.ndarray, group: str) -> None:
    """A stack of blocks, or a ring of pegs."""
    y = 0.0
    for _ in range(int(b.rng.integers(2, 7))):
        s = b.between(0.03, 0.07)
        turn = at @ lift(0, y, 0) @ rotation([0, 1, 0], b.between(0, 90))
        b.block(
            [0, s / 2, 0],
            [s * b.between(0.8, 1.8), s, s],
            b.plain(b.color(vivid=True)),
            at=turn,
            group=group,
        )
        y += s


def _pot_plant(b: Builder, at: np.ndarray, group: str) -> None:
    from stillray_training.simulate.generators.plants import plant

    plant(b, at, b.between(0.15, 0.4), group)


def _cable(b: Builder, at: np.ndarray, group: str) -> None:
    t = np.linspace(0, 1, 40)
    wild = np.cumsum(np.cumsum(b.rng.normal(size=(40, 2)), axis=0), axis=0)
    wild = 0.25 * wild / np.abs(wild).max()
    line = np.stack([wild[:, 0] + 0.2 * t, np.full(40, 0.004), wild[:, 1]], 1)
    b.add(tube(line, b.between(0.002, 0.004), sides=6), b.plain(gloss=0.5), at=at, group=group)


def _pens(b: Builder, at: np.ndarray, group: str) -> None:
    r = 0.035
    profile = [(0, 0), (r, 0), (r, 0.1), (r - 0.002, 0.1), (r - 0.002, 0.004), (0, 0.004)]
    b.add(lathe(profile), b.metal() if b.chance(0.5) else b.accent(), at=at, group=group)
    for _ in range(int(b.rng.integers(2, 7))):
        foot, tip = b.rng.uniform(-0.015, 0.015, 2), b.rng.uniform(-0.045, 0.045, 2)
        ends = np.array([[foot[0], 0.006, foot[1]], [tip[0], b.between(0.13, 0.18), tip[1]]])
        b.add(tube(ends, 0.0035, sides=6), b.plain(b.color(vivid=True)), at=at, group=group)


def _can(b: Builder, at: np.ndarray, group: str) -> None:
    r, h = 0.033, b.between(0.09, 0.14)
    b.add(cylinder([0, 0, 0], r, h, segments=28), b.metal(), at=at, group=group)
    label = b.printed(0.2) if b.chance(0.6) else b.printed(0.2, kind="print")
    b.add(
        lathe([(r + 0.0006, 0.01), (r + 0.0006, h - 0.01)], segments=28), label, at=at, group=group
    )


_MAKERS = {
    "vase": _vase,
    "bottle": _bottle,
    "tumbler": _tumbler,
    "bowl": _bowl,
    "fruit": _fruit,
    "books": _books,
    "plate": _plate,
    "mug": _mug,
    "candle": _candle,
    "box": _box,
    "ball": _ball,
    "frame": _frame,
    "toy": _toy,
    "pot_plant": _pot_plant,
    "cable": _cable,
    "pens": _pens,
    "can": _can,
}


def row_of_books(b: Builder, at: np.ndarray, width: float, height: float, depth: float) -> None:
    """Upright books from left to right on a board, some leaning, with gaps."""
    x = 0.01
    covers = [b.plain(b.color(vivid=b.chance(0.6)), gloss=0.2) for _ in range(5)]
    while x < width - 0.06 and not b.chance(0.03):
        if b.chance(0.08):
            gap = b.between(0.05, 0.25)
            if gap > 0.12 and x + gap < width and height > 0.22:
                thing(b, at @ lift(x + gap / 2, 0, depth / 2), scale=0.8)
            x += gap
            continue
        thick, tall = b.between(0.012, 0.05), height * b.between(0.55, 0.95)
        long = depth * b.between(0.6, 0.9)
        lean = rotation([0, 0, 1], b.between(-9, 0)) if b.chance(0.1) else np.eye(4)
        spine = b.printed(0.25, kind="print") if b.chance(0.15) else covers[b.rng.integers(5)]
        body = box([thick / 2, tall / 2, long / 2], [thick, tall, long])
        b.add(body, spine, at=at @ lift(x, 0, 0) @ lean)
        x += thick + b.between(0.0005, 0.004)

"""Lamps, screens and other lights."""

from __future__ import annotations

import numpy as np

from stillray_training.simulate.generators.build import Builder, lift
from stillray_training.simulate.mesh import (
    Mesh,
    cylinder,
    join,
    lathe,
    quad,
    rotation,
    sphere,
    tube,
)
from stillray_training.simulate.textures import Texture


def _shade(b: Builder, top: float, bottom: float, height: float) -> Mesh:
    """An open shade, its rim at the origin, a wall 4 mm thick."""
    t = 0.004
    return lathe(
        [(bottom - t, 0), (bottom, 0), (top, height), (top - t, height), (bottom - t, 0)],
        segments=32,
    )


def pendant(b: Builder, at: np.ndarray, drop: float, power: float) -> None:
    """A lamp that hangs from the origin (on the ceiling) by a cable."""
    group = f"pendant{len(b.spots)}"
    b.can_move(group, at, "hanging")
    b.add(
        tube([[0, 0, 0], [0, -drop / 2, 0], [0, -drop, 0]], 0.004, sides=6),
        b.plain((0.04,) * 3),
        at=at,
        group=group,
    )
    low = at @ lift(0, -drop, 0)
    style = b.pick("shade", "ball", "cluster", p=[0.5, 0.3, 0.2])
    if style == "shade":
        wide, h = b.between(0.12, 0.3), b.between(0.12, 0.25)
        b.add(
            _shade(b, wide * b.between(0.15, 0.8), wide, h),
            b.metal() if b.chance(0.4) else b.plain(),
            at=low @ lift(0, -h, 0),
            group=group,
        )
        r = 0.045
        ball = sphere([0, -h * 0.6, 0], r, rings=10)
        b.shine(
            ball, b.light_color(power / (4 * np.pi**2 * r * r)), at=low, group=group, around=True
        )
    elif style == "ball":
        r = b.between(0.08, 0.2)
        b.shine(
            sphere([0, -r, 0], r, rings=14),
            b.light_color(power / (4 * np.pi**2 * r * r)),
            at=low,
            group=group,
            around=True,
        )
    else:
        for _ in range(int(b.rng.integers(3, 7))):
            x, y, z = b.rng.normal(size=3) * [0.15, 0.06, 0.15]
            r = 0.03
            arm = tube([[0, 0, 0], [x / 2, y / 2 + 0.05, z / 2], [x, y, z]], 0.004, sides=6)
            b.add(arm, b.metal(), at=low, group=group)
            b.shine(
                sphere([x, y - r, z], r, rings=8),
                b.light_color(power / 4 / (4 * np.pi**2 * r * r)),
                at=low,
                group=group,
                around=True,
            )


def standing(b: Builder, at: np.ndarray, height: float, power: float) -> None:
    """A floor or table lamp with a shade."""
    group = b.can_move(f"lamp{len(b.spots)}", at, "lamp")
    r = 0.09 * height + 0.06
    b.add(cylinder([0, 0, 0], r, 0.02, segments=28), b.metal(), at=at, group=group)
    b.add(
        tube([[0, 0.02, 0], [0, height / 2, 0], [0, height, 0]], 0.008 + 0.004 * height),
        b.metal() if b.chance(0.5) else b.wood(),
        at=at,
        group=group,
    )
    wide, h = b.between(1.0, 1.7) * r, b.between(0.8, 1.4) * r
    b.add(
        _shade(b, wide * b.between(0.5, 1.0), wide, h),
        b.fabric() if b.chance(0.6) else b.plain(),
        at=at @ lift(0, height - h * 0.6, 0),
        group=group,
    )
    bulb = 0.04
    ball = sphere([0, height - 0.1 * h, 0], bulb, rings=10)
    b.shine(ball, b.light_color(power / (4 * np.pi**2 * bulb**2)), at=at, group=group, around=True)


def desk_lamp(b: Builder, at: np.ndarray, power: float) -> None:
    """A jointed lamp with a cone that lights what lies before it."""
    group = b.can_move(f"lamp{len(b.spots)}", at, "lamp")
    metal = b.metal() if b.chance(0.5) else b.accent()
    b.add(cylinder([0, 0, 0], 0.08, 0.02), metal, at=at, group=group)
    elbow, head = np.array([-0.12, 0.28, 0]), np.array([0.12, 0.42, 0])
    arms = [
        tube([[0, 0, 0], elbow / 2, elbow], 0.007),
        tube([elbow, (elbow + head) / 2, head], 0.007),
    ]
    b.add(join(arms), metal, at=at, group=group)
    cone = at @ lift(*head) @ rotation([0, 0, 1], 25) @ lift(0, -0.1, 0)
    b.add(_shade(b, 0.025, 0.08, 0.12), metal, at=cone, group=group)
    b.shine(
        sphere([0, 0.05, 0], 0.025, rings=8),
        b.light_color(power / (4 * np.pi**2 * 0.025**2)),
        at=cone,
        group=group,
        around=True,
    )


def panel(b: Builder, at: np.ndarray, width: float, depth: float, power: float) -> None:
    """A ceiling panel that shines down; the origin lies on the ceiling."""
    face = quad([-width / 2, -0.012, -depth / 2], [width, 0, 0], [0, 0, depth])
    b.shine(face, b.light_color(power / (np.pi * width * depth)), at=at)
    rim = [
        tube([[x, -0.008, -depth / 2], [x, -0.008, 0], [x, -0.008, depth / 2]], 0.01, sides=4)
        for x in (-width / 2, width / 2)
    ]
    b.add(join(rim), b.metal(), at=at)


def spots(b: Builder, at: np.ndarray, length: float, power: float) -> None:
    """A rail of small bright spots under the ceiling, along x."""
    b.add(
        tube([[-length / 2, -0.05, 0], [0, -0.05, 0], [length / 2, -0.05, 0]], 0.012, sides=6),
        b.metal(),
        at=at,
    )
    count = int(b.rng.integers(3, 7))
    for x in np.linspace(-length / 2, length / 2, count):
        tilt = at @ lift(x, -0.1, 0) @ rotation([1, 0, 0], b.between(-50, 50))
        b.add(_shade(b, 0.03, 0.04, 0.1), b.metal(), at=tilt @ lift(0, -0.05, 0))
        face = quad([-0.025, 0.0, -0.025], [0.05, 0, 0], [0, 0, 0.05])
        b.shine(face, b.light_color(power / count / (np.pi * 0.05**2)), at=tilt)


def fairy_lights(b: Builder, start: np.ndarray, end: np.ndarray, power: float) -> None:
    """A sagging string of many small coloured lights."""
    t = np.linspace(0, 1, 30)
    line = start + (end - start) * t[:, None] - [0, 0.3, 0] * (np.sin(np.pi * t) ** 1.0)[:, None]
    b.add(tube(line, 0.003, sides=5), b.plain((0.03, 0.05, 0.03)))
    festive = b.chance(0.5)
    count = int(b.rng.integers(6, 14))
    for spot in line[np.linspace(1, 28, count).astype(int)]:
        color = np.exp(b.rng.normal(size=3) * (0.9 if festive else 0.1)) * [1, 0.8, 0.55]
        radiance = color / color.mean() * power / count / (4 * np.pi**2 * 0.015**2)
        b.shine(
            sphere(spot - [0, 0.02, 0], 0.015, rings=6),
            (float(radiance[0]), float(radiance[1]), float(radiance[2])),
            around=True,
        )


def screen(b: Builder, at: np.ndarray, width: float, power: float) -> None:
    """A screen that faces +z; its lower middle is at the origin."""
    h = width * 0.58
    b.block([0, h / 2, 0], [width, h, 0.03], b.plain((0.03,) * 3, gloss=1), at=at)
    shows = Texture(
        kind=b.pick("painting", "print"),
        seed=int(b.rng.integers(2**31)),
        low=(0.02,) * 3,
        high=(0.9, 0.92, 1.0),
        size=width,
    )
    face = quad([-width * 0.48, 0.03 * h, 0.0165], [width * 0.96, 0, 0], [0, h * 0.94, 0])
    b.shine(face, b.light_color(power / (np.pi * width * h)), at=at, picture=shows)

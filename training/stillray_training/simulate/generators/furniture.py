"""Furniture. Each stands on the origin with its back at z = 0 and faces +z, width along x."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from stillray_training.simulate.generators.build import Builder, lift
from stillray_training.simulate.generators.things import row_of_books, thing, things
from stillray_training.simulate.mesh import (
    Mesh,
    box,
    cylinder,
    join,
    lathe,
    quad,
    rotation,
    sheet,
    sphere,
    tube,
)


def table(
    b: Builder, at: np.ndarray, width: float, depth: float, height: float, clutter: int
) -> None:
    """A table in one of several designs, with things on it; its middle is at the origin."""
    if b.stand_in("table", at, [width, height, depth]):
        things(b, at @ lift(0, height + 0.004, 0), width, depth, clutter)
        return
    group = b.can_move(f"table{len(b.spots)}", at, "floor")
    top = b.pick("slab", "round", "glass", p=[0.65, 0.2, 0.15])
    wood, legs = b.wood(second=b.chance(0.4)), b.metal() if b.chance(0.35) else b.wood()
    thick = b.between(0.018, 0.05)
    if top == "round":
        r = min(width, depth) / 2
        b.add(cylinder([0, height - thick, 0], r, thick, segments=40), wood, at=at, group=group)
        b.add(cylinder([0, 0.02, 0], 0.04, height - thick - 0.02), legs, at=at, group=group)
        b.add(cylinder([0, 0, 0], 0.5 * r, 0.02, segments=32), legs, at=at, group=group)
        width = depth = 1.3 * r
    else:
        surface = b.glass() if top == "glass" else wood
        b.block([0, height - thick / 2, 0], [width, thick, depth], surface, at=at, group=group)
        inset = b.between(0.02, 0.1)
        lean = b.between(0, 0.12) if b.chance(0.3) else 0.0
        rods = []
        for x in (-1, 1):
            for z in (-1, 1):
                head = [x * (width / 2 - inset), height - thick, z * (depth / 2 - inset)]
                foot = [head[0] + x * lean * height, 0, head[2] + z * lean * height]
                rods.append(_leg(b, np.array(foot), np.array(head)))
        b.add(join(rods), legs, at=at, group=group)
        if b.chance(0.5):
            apron = [
                box(
                    [0, height - thick - 0.04, z * (depth / 2 - inset)],
                    [width - 2 * inset, 0.07, 0.015],
                )
                for z in (-1, 1)
            ]
            b.add(join(apron), wood, at=at, group=group)
    if clutter and b.chance(0.2):
        cloth = sheet(0.002 * b.rng.random((8, 24)), width * 0.5, depth * 0.9)
        lay = at @ lift(-width / 4, height + 0.001, depth * 0.45) @ rotation([1, 0, 0], -90)
        b.add(cloth, b.fabric(two_sided=True), at=lay, group=group)
    things(b, at @ lift(0, height + 0.003, 0), width, depth, clutter)


def _leg(b: Builder, foot: np.ndarray, head: np.ndarray) -> Mesh:
    thick = 0.016 + 0.01 * (head[1] > 0.6)
    return tube([foot, (foot + head) / 2, head], thick, sides=4 if b.chance(0.5) else 10)


def chair(b: Builder, at: np.ndarray) -> None:
    """A chair: frame of rods or slats, seat, back with bars."""
    if b.stand_in("chair", at):
        return
    group = b.can_move(f"chair{len(b.spots)}", at, "floor")
    w, d, seat, back = b.between(0.38, 0.46), b.between(0.38, 0.45), 0.45, b.between(0.8, 1.05)
    frame = b.metal() if b.chance(0.3) else b.wood(second=b.chance(0.5))
    soft = b.fabric() if b.chance(0.5) else frame
    r = b.between(0.008, 0.02)
    rods = []
    for x in (-w / 2, w / 2):
        rods.append(tube([[x, 0, d], [x, seat / 2, d], [x, seat, d]], r))
        rods.append(tube([[x, 0, 0.02], [x, seat, 0], [x, back, -0.06]], r))
    if b.chance(0.6):
        rods.append(tube([[-w / 2, 0.18, d / 2], [0, 0.18, d / 2], [w / 2, 0.18, d / 2]], 0.6 * r))
    style = b.pick("bars", "slats", "panel")
    if style == "bars":
        for x in np.linspace(-w / 2, w / 2, int(b.rng.integers(4, 9)))[1:-1]:
            rods.append(
                tube([[x, seat, 0], [x, (seat + back) / 2, -0.03], [x, back, -0.06]], 0.5 * r)
            )
    b.add(join(rods), frame, at=at, group=group)
    boards = [box([0, back - 0.02, -0.055], [w, 0.05, 0.016])]
    if style == "slats":
        boards += [
            box([0, y, -0.03], [w, 0.03, 0.012]) for y in np.arange(seat + 0.1, back - 0.05, 0.09)
        ]
    if style == "panel":
        boards.append(box([0, (seat + back) / 2 + 0.05, -0.04], [w, (back - seat) * 0.6, 0.016]))
    b.add(join(boards), frame if style != "panel" else soft, at=at, group=group)
    b.block([0, seat, d / 2], [w, b.between(0.02, 0.06), d], soft, at=at, group=group)


def sofa(b: Builder, at: np.ndarray, width: float) -> None:
    """A sofa or, if narrow, an armchair, with cushions."""
    if b.stand_in("sofa" if width > 1.4 else "armchair", at):
        return
    group = b.can_move(f"sofa{len(b.spots)}", at, "floor")
    cloth = b.fabric() if b.chance(0.75) else b.plain(gloss=0.9)
    d, seat, back, arm = b.between(0.8, 0.95), 0.4, b.between(0.7, 0.9), b.between(0.12, 0.22)
    body = [
        box([0, 0.2, d / 2], [width, 0.22, d]),
        box([0, (0.1 + back) / 2, 0.1], [width, back - 0.1, 0.2]),
        box([-width / 2 + arm / 2, 0.32, d / 2], [arm, 0.48, d]),
        box([width / 2 - arm / 2, 0.32, d / 2], [arm, 0.48, d]),
    ]
    b.add(join(body), cloth, at=at, group=group)
    count = max(1, round((width - 2 * arm) / 0.65))
    each = (width - 2 * arm) / count
    for i in range(count):
        x = -width / 2 + arm + (i + 0.5) * each
        b.add(
            _cushion([each - 0.02, 0.16, d - 0.25]),
            cloth,
            at=at @ lift(x, seat - 0.02, d / 2 + 0.1),
            group=group,
        )
    for _ in range(int(b.rng.integers(0, 4))):
        place = lift(b.between(-0.4, 0.4) * width, seat + 0.22, 0.3) @ rotation([1, 0, 0], -65)
        b.add(_cushion([0.4, 0.14, 0.38]), b.fabric(), at=at @ place, group=group)
    feet = [
        cylinder([x * (width / 2 - 0.08), 0, z], 0.02, 0.1, segments=8)
        for x in (-1, 1)
        for z in (0.08, d - 0.08)
    ]
    b.add(join(feet), b.wood(), at=at, group=group)


def _cushion(size: list[float]) -> Mesh:
    """A box that bulges: an ellipsoid raised to a power."""
    ball = sphere([0, 0, 0], 1.0, rings=14)
    shaped = np.sign(ball.vertices) * np.abs(ball.vertices) ** 0.55
    half = np.array(size) / 2
    normals = np.sign(ball.normals) * np.abs(ball.normals) ** 1.4 / half
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Mesh(vertices=shaped * half, normals=normals, uvs=ball.uvs * half[0], faces=ball.faces)


def bed(b: Builder, at: np.ndarray, width: float) -> None:
    """A bed with head board, mattress, blanket and pillows."""
    long = 2.0
    b.block([0, 0.17, long / 2], [width, 0.2, long], b.wood(), at=at)
    b.block(
        [0, b.between(0.4, 0.6), 0.03],
        [width, b.between(0.7, 1.0), 0.06],
        b.wood() if b.chance(0.6) else b.fabric(),
        at=at,
    )
    b.add(
        _cushion([width - 0.04, 0.28, long - 0.08]),
        b.fabric(),
        at=at @ lift(0, 0.36, long / 2 + 0.03),
    )
    waves = 0.015 * np.sin(np.linspace(0, 25, 30))[None] + 0.012 * b.rng.random((24, 30))
    lay = at @ lift(-width / 2 - 0.02, 0.515, long) @ rotation([1, 0, 0], -90)
    b.add(sheet(waves, width + 0.04, long * 0.7), b.fabric(two_sided=True), at=lay)
    for x in [0.0] if width < 1.2 else [-width / 4, width / 4]:
        b.add(_cushion([0.6, 0.16, 0.4]), b.fabric(), at=at @ lift(x, 0.57, 0.32))


def shelf(b: Builder, at: np.ndarray, width: float, height: float) -> None:
    """An open shelf full of books and things."""
    if b.stand_in("shelf", at, [width, height, 0.4]):
        return
    depth, thick = b.between(0.24, 0.34), b.between(0.015, 0.03)
    wood = b.wood(second=b.chance(0.3))
    sides = [
        box([x, height / 2, depth / 2], [thick, height, depth]) for x in (-width / 2, width / 2)
    ]
    levels = np.linspace(0.06, height - thick, max(2, int(height / b.between(0.3, 0.42))))
    boards = [box([0, y, depth / 2], [width, thick, depth]) for y in levels]
    if b.chance(0.6):
        boards.append(box([0, height / 2, 0.004], [width, height, 0.008]))
    b.add(join(sides + boards), wood, at=at)
    for low, high in pairwise(levels):
        start = at @ lift(-width / 2 + thick, low + thick / 2, 0.015)
        if b.chance(0.75):
            row_of_books(b, start, width - 2 * thick, high - low - thick, depth)
        else:
            middle = at @ lift(0, low + thick / 2, depth / 2)
            things(b, middle, width * 0.9, 0.1, int(b.rng.integers(1, 5)))


def cabinet(
    b: Builder, at: np.ndarray, width: float, height: float, depth: float, *, clutter: int = 0
) -> None:
    """Doors and drawers with handles; clutter stands on top."""
    if b.stand_in("cabinet", at, [width, height, depth]):
        things(b, at @ lift(0, height, depth / 2), width, depth, clutter)
        return
    body = b.wood(second=b.chance(0.5)) if b.chance(0.6) else b.plain(gloss=0.5)
    handle = b.metal()
    b.block([0, height / 2, depth / 2], [width, height, depth], body, at=at)
    columns = max(1, round(width / b.between(0.4, 0.7)))
    rows = 1 if b.chance(0.5) else int(b.rng.integers(2, 5))
    fronts, handles = [], []
    for i in range(columns):
        for j in range(rows):
            w, h = width / columns, (height - 0.08) / rows
            x, y = -width / 2 + (i + 0.5) * w, 0.06 + (j + 0.5) * h
            fronts.append(box([x, y, depth + 0.009], [w - 0.008, h - 0.008, 0.018]))
            if b.chance(0.7):
                tall = rows == 1
                ends = [
                    [
                        x + (w / 2 - 0.05 if tall else -0.06),
                        y - (0.06 if tall else 0),
                        depth + 0.04,
                    ],
                    [x + (w / 2 - 0.05 if tall else 0.06), y + (0.06 if tall else 0), depth + 0.04],
                ]
                handles.append(tube(ends, 0.006, sides=6))
            else:
                handles.append(sphere([x + w / 2 - 0.06, y, depth + 0.03], 0.014, rings=8))
    b.add(join(fronts), body, at=at)
    b.add(join(handles), handle, at=at)
    things(b, at @ lift(0, height, depth / 2), width, depth, clutter)


def counter(b: Builder, at: np.ndarray, width: float) -> None:
    """A kitchen counter: cupboards, a stone top, a sink and tap, a hanging row of cupboards."""
    cabinet(b, at, width, 0.86, 0.58)
    stone = b.stone(gloss=0.8)
    b.block([0, 0.88, 0.31], [width + 0.02, 0.04, 0.62], stone, at=at)
    tiles = b.texture("tiles", b.color(light=0.2), b.color(light=0.75), b.between(0.5, 1.0))
    from dataclasses import replace

    back = replace(b.plain(b.color(light=0.7), gloss=0.8), texture=tiles)
    b.add(quad([-width / 2, 0.9, 0.004], [width, 0, 0], [0, 0.55, 0]), back, at=at)
    x = b.between(-0.3, 0.3) * width
    tap = np.array(
        [[x, 0.9, 0.1], [x, 1.12, 0.1], [x, 1.2, 0.16], [x, 1.18, 0.27], [x, 1.12, 0.28]]
    )
    b.add(tube(tap, 0.013, sides=10), b.metal(0.06), at=at)
    b.block([x, 0.903, 0.34], [0.5, 0.006, 0.4], b.metal(0.15), at=at)
    things(b, at @ lift(0, 0.9, 0.32), width, 0.4, int(b.rng.integers(3, 9)))
    if b.chance(0.7):
        cabinet(b, at @ lift(0, 1.5, 0), width * b.between(0.5, 1.0), 0.65, 0.33)
    else:
        for y in (1.4, 1.75):
            b.block([0, y, 0.12], [width * 0.7, 0.025, 0.22], b.wood(), at=at)
            things(b, at @ lift(0, y + 0.013, 0.12), width * 0.7, 0.12, int(b.rng.integers(2, 7)))
    if b.chance(0.4):
        rail = at @ lift(-width / 3, 1.36, 0.05)
        b.add(
            tube([[0, 0, 0], [width / 3, 0, 0], [2 * width / 3, 0, 0]], 0.006), b.metal(), at=rail
        )
        for s in np.linspace(0.05, 2 * width / 3 - 0.05, int(b.rng.integers(3, 7))):
            hang = tube([[s, -0.01, 0], [s, -0.12, 0], [s, -0.2, 0]], 0.005, sides=6)
            b.add(hang, b.metal(), at=rail)
            b.add(
                lathe([(0, 0), (0.05, 0.01), (0.055, 0.03), (0.05, 0.012), (0, 0.004)]),
                b.metal(),
                at=rail @ lift(s, -0.26, 0) @ rotation([1, 0, 0], 90),
            )


def bath(b: Builder, at: np.ndarray, width: float) -> None:
    """A bath tub along the wall, with a tap and a glass screen."""
    d, h = 0.75, 0.56
    white = b.plain(b.color(light=0.78), gloss=1.0)
    rim = [
        box([0, h / 2, 0.03], [width, h, 0.06]),
        box([0, h / 2, d - 0.03], [width, h, 0.06]),
        box([-width / 2 + 0.03, h / 2, d / 2], [0.06, h, d]),
        box([width / 2 - 0.03, h / 2, d / 2], [0.06, h, d]),
        box([0, 0.1, d / 2], [width, 0.1, d]),
    ]
    b.add(join(rim), white, at=at)
    tap = np.array([[0, 0, 0], [0, 0.12, 0], [0, 0.16, 0.05], [0, 0.15, 0.12]])
    b.add(tube(tap, 0.014), b.metal(0.05), at=at @ lift(-width / 2 + 0.2, h, 0.05))
    if b.chance(0.5):
        b.block([width / 4, h + 0.7, d - 0.03], [width / 2, 1.4, 0.012], b.glass(), at=at)
    things(b, at @ lift(width / 2 - 0.12, h, 0.03), 0.1, 0.02, 2)


def basin(b: Builder, at: np.ndarray) -> None:
    """A wash basin under a mirror, with glass and bottles."""
    white = b.plain(b.color(light=0.78), gloss=1.0)
    angle = np.linspace(0.15, 1.4, 8)
    out = np.stack([0.24 * np.sin(angle), 0.18 - 0.18 * np.cos(angle)], 1)
    bowl = lathe([(0, 0), *out, *(out[::-1] * 0.92 + [0, 0.012]), (0, 0.02)], segments=40)
    cabinet(b, at, 0.7, 0.72, 0.45)
    b.add(bowl, white, at=at @ lift(0, 0.72, 0.25))
    tap = np.array([[0, 0, 0], [0, 0.22, 0], [0, 0.26, 0.04], [0, 0.25, 0.12]])
    b.add(tube(tap, 0.012), b.metal(0.05), at=at @ lift(0, 0.72, 0.03))
    thing(b, at @ lift(0.28, 0.72, 0.1), kind="tumbler")
    thing(b, at @ lift(-0.28, 0.72, 0.1), kind="bottle")
    mirror(b, at @ lift(0, 1.45, 0.01), b.between(0.5, 0.9), b.between(0.5, 0.9))


def mirror(b: Builder, at: np.ndarray, width: float, height: float) -> None:
    """A framed mirror whose middle is at the origin."""
    from stillray_training.simulate.world import Surface

    b.block([0, 0, 0.008], [width + 0.06, height + 0.06, 0.016], b.wood(second=True), at=at)
    silver = Surface(color=(0.92, 0.93, 0.92), special="mirror")
    b.add(quad([-width / 2, -height / 2, 0.018], [width, 0, 0], [0, height, 0]), silver, at=at)


def picture(b: Builder, at: np.ndarray, width: float, height: float) -> None:
    """A framed picture whose middle is at the origin."""
    b.block(
        [0, 0, 0.01],
        [width + 0.05, height + 0.05, 0.02],
        b.wood() if b.chance(0.6) else b.metal(),
        at=at,
    )
    b.add(
        quad([-width / 2, -height / 2, 0.022], [width, 0, 0], [0, height, 0]),
        b.printed(max(width, height)),
        at=at,
    )


def towel(b: Builder, at: np.ndarray) -> None:
    """A rail with towels, its middle at the origin."""
    w = b.between(0.5, 0.8)
    b.add(tube([[-w / 2, 0, 0.07], [0, 0, 0.07], [w / 2, 0, 0.07]], 0.008), b.metal(), at=at)
    for side in (-1, 1):
        if b.chance(0.75):
            folds = 0.012 * np.sin(np.linspace(0, b.between(8, 30), 40))[None] * np.ones((6, 1))
            long = b.between(0.3, 0.6)
            hang = lift(side * w / 4 - 0.15, -long, 0.09)
            b.add(sheet(folds, 0.3, long), b.fabric(two_sided=True), at=at @ hang)


def stairs(b: Builder, at: np.ndarray, width: float, height: float) -> None:
    """A flight of steps that climbs away along -z from the origin, with a railing."""
    count = round(height / 0.18)
    rise, run = height / count, 0.27
    wood = b.wood() if b.chance(0.6) else b.stone()
    closed = b.chance(0.5)
    steps = []
    for i in range(count):
        top, low = (i + 1) * rise, 0.0 if closed else (i + 1) * rise - 0.045
        steps.append(box([0, (top + low) / 2, -(i + 0.5) * run], [width, top - low, run * 1.05]))
    b.add(join(steps), wood, at=at)
    rail, bars = b.wood(second=True), b.metal()
    for x in (-width / 2 + 0.04, width / 2 - 0.04):
        posts = [
            tube(
                [
                    [x, (i + 1) * rise, -(i + 0.5) * run],
                    [x, (i + 1) * rise + 0.45, -(i + 0.5) * run],
                    [x, (i + 1) * rise + 0.9, -(i + 0.5) * run],
                ],
                0.011,
                sides=6,
            )
            for i in range(count)
        ]
        b.add(join(posts), bars, at=at)
        ends = np.array([[x, rise + 0.9, -0.5 * run], [x, height + 0.9, -(count - 0.5) * run]])
        b.add(tube([ends[0], ends.mean(axis=0), ends[1]], 0.028, sides=10), rail, at=at)

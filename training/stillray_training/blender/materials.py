"""Materials drawn at random: patterns, relief and gloss out of Blender's procedural textures."""

from __future__ import annotations

import colorsys
from random import Random
from typing import Any

from stillray_training.blender.parts import Color, Material, textile, wood

_PATTERNS = (
    "plain", "plain", "noise", "bricks", "tiles", "checks", "stripes", "cells", "marble", "wood",
    "planks", "cloth", "speckles",
)  # fmt: skip


def color(drawn: Random) -> Color:
    """A colour of things in rooms: mostly muted, some white, some dark, a few saturated."""
    saturation = drawn.betavariate(1.3, 3.0)
    value = drawn.choice((drawn.uniform(0.03, 0.3), drawn.uniform(0.2, 0.85), 0.8))
    return colorsys.hsv_to_rgb(drawn.random(), saturation, value)


def material(drawn: Random, *, grain: float = 1.0, opaque: bool = True) -> Material:
    """A material of one of a dozen patterns.

    Parameters
    ----------
    drawn
        Draws everything.
    grain
        How fine patterns are: the size of what bears it in metres, about.
    opaque
        Whether glass is out of the question: walls would let the light in.
    """
    kind = drawn.choice(_PATTERNS)
    first, second = color(drawn), color(drawn)
    if kind == "wood":
        return wood("wood", first, second)
    if kind == "planks":
        return wood("planks", first, second, plank=grain * drawn.uniform(0.04, 0.15))
    if kind == "cloth":
        return textile("cloth", first, second, threads=drawn.uniform(60, 400) / grain)
    made = Material(kind, first, **_gloss(drawn, opaque))
    if kind != "plain":
        pattern = _pattern(made, kind, drawn, grain)
        if drawn.random() < 0.9:
            made.paint(made.ramp(pattern, _stops(kind, first, second, drawn)))
        if drawn.random() < 0.5:
            made.emboss(pattern, grain * drawn.uniform(0.002, 0.02), drawn.uniform(0.3, 1.0))
    elif drawn.random() < 0.4:
        scale = drawn.uniform(5, 80) / grain
        noise = made.node("TexNoise", Vector=made.coordinates(), Scale=scale, Detail=3.0)
        made.emboss(noise.outputs[0], grain * drawn.uniform(0.001, 0.02))
    return made


def _gloss(drawn: Random, opaque: bool) -> dict[str, float]:
    roughness = drawn.choice((drawn.uniform(0.02, 0.25), drawn.uniform(0.2, 0.6), 0.8))
    chance = drawn.random()
    if chance < 0.15:
        return {"Metallic": 1.0, "Roughness": roughness}
    if chance < 0.23 and not opaque:
        return {"Transmission_Weight": 1.0, "Roughness": drawn.choice((0.0, 0.0, 0.15))}
    if chance < 0.3:
        return {"Roughness": roughness, "Coat_Weight": drawn.random()}
    if chance < 0.34:
        return {"Roughness": roughness, "Subsurface_Weight": drawn.uniform(0.1, 0.6)}
    if chance < 0.4:
        return {"Roughness": roughness, "Sheen_Weight": drawn.random()}
    return {"Roughness": roughness}


def _pattern(made: Material, kind: str, drawn: Random, grain: float) -> Any:
    """A factor in [0, 1] over the surface: an output."""
    turned = (0.0, 0.0, drawn.choice((0.0, 0.0, drawn.uniform(0, 3))))
    at = made.coordinates(rotation=turned)
    scale = drawn.uniform(2, 14) / grain
    if kind in ("bricks", "tiles"):
        square = kind == "tiles"
        bricks = made.node(
            "TexBrick", Vector=at, Scale=scale / 2, Color1=(1, 1, 1, 1),
            Color2=(drawn.uniform(0.4, 1),) * 3 + (1,), Mortar=(0, 0, 0, 1),
            Mortar_Size=drawn.uniform(0.004, 0.03), Brick_Width=0.5 if square else 1.0,
            Row_Height=0.5,
        )  # fmt: skip
        bricks.offset = 0.0 if square else 0.5
        return bricks.outputs["Color"]
    if kind == "checks":
        checks = made.node("TexChecker", Vector=at, Scale=scale)
        checks.inputs["Color1"].default_value = (1, 1, 1, 1)
        checks.inputs["Color2"].default_value = (0, 0, 0, 1)
        return checks.outputs["Color"]
    if kind == "stripes":
        wave = made.node("TexWave", Vector=at, Scale=scale, Distortion=drawn.choice((0, 0, 4.0)))
        wave.bands_direction = drawn.choice(("X", "Y", "Z", "DIAGONAL"))
        return wave.outputs[1]
    if kind == "cells":
        cells = made.node("TexVoronoi", Vector=at, Scale=scale)
        cells.feature = drawn.choice(("F1", "DISTANCE_TO_EDGE", "F2"))
        return cells.outputs["Distance"]
    if kind == "marble":
        wave = made.node(
            "TexWave", Vector=at, Scale=scale / 3, Distortion=drawn.uniform(5, 20), Detail=4.0
        )
        return wave.outputs[1]
    detail = 8.0 if kind == "noise" else 1.0
    fine = scale * (8 if kind == "speckles" else 1)
    return made.node("TexNoise", Vector=at, Scale=fine, Detail=detail).outputs[0]


def _stops(kind: str, first: Color, second: Color, drawn: Random) -> list[tuple[float, Color]]:
    """Where between two colours the pattern goes over: softly, or as an edge."""
    if kind in ("noise", "speckles", "marble"):
        middle = drawn.uniform(0.4, 0.6)
        width = drawn.choice((0.02, 0.1, 0.3))
        return [(middle - width, first), (middle + width, second)]
    return [(0.0, first), (drawn.choice((0.1, 0.5, 1.0)), second)]

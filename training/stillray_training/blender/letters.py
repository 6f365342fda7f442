"""Print: lines of letters, a pixel or two to some dozens high, on what a camera sees."""

from __future__ import annotations

import math
import string
from random import Random

import bpy
from mathutils import Matrix, Vector

from stillray_training.blender.log_uniform import log_uniform
from stillray_training.blender.materials import color
from stillray_training.blender.parts import Material, add, glowing, primitive, text
from stillray_training.blender.view import View

_PAGES = (2, 7)
_HIGH = (2.5, 30.0)  # of a line, pixels
_LINES, _LETTERS = (1, 14), (3, 40)
_PAPER = 0.6  # share of pages that have one
_LIT = 0.1  # share of prints that shine
_OFF = 1e-3  # of its distance: how far before a surface a page is


def paste(drawn: Random) -> None:
    """Put pages of print on what the camera of the scene sees."""
    view, size = View(), bpy.context.scene.render.resolution_x
    for point, normal, far in view.places(drawn, drawn.randint(*_PAGES)):
        high = far * view.width / size * log_uniform(drawn, *_HIGH)
        _page(drawn, _turned(drawn, point + _OFF * far * normal, normal), high, _OFF * far)


def _turned(drawn: Random, at: Vector, normal: Vector) -> Matrix:
    """From a page's coordinates, its normal along z, to the world's: upright, or any way round."""
    up = Vector((0, 0, 1)) if abs(normal.z) < 0.9 else Vector((0, 1, 0))
    right = up.cross(normal).normalized()
    turned = Matrix((right, normal.cross(right), normal)).transposed().to_4x4()
    turn = drawn.choice((0.0, 0.0, drawn.uniform(-math.pi, math.pi)))
    return Matrix.Translation(at) @ turned @ Matrix.Rotation(turn, 4, "Z")


def _page(drawn: Random, place: Matrix, high: float, off: float) -> None:
    letters = string.ascii_letters + string.digits + "      .,:"
    longest = drawn.randint(*_LETTERS)
    lines = [
        "".join(drawn.choices(letters, k=drawn.randint(longest // 2 + 1, longest)))
        for _ in range(drawn.randint(*_LINES))
    ]
    spaced = drawn.uniform(0.9, 1.6)
    ink = Material("ink", color(drawn), Roughness=drawn.uniform(0.1, 0.9))
    if drawn.random() < _LIT:
        ink = glowing(color(drawn), log_uniform(drawn, 0.3, 10))
    elif drawn.random() < 0.5:
        ink = Material("ink", (0.02, 0.02, 0.02), Roughness=0.7)
    thing = text("\n".join(lines), high, ink)
    curve = thing.data
    curve.align_x, curve.align_y = "CENTER", "CENTER"
    curve.space_line = spaced
    thing.matrix_world = place @ Matrix.Translation((0, 0, off))
    if drawn.random() < _PAPER:
        paper = Material("paper", color(drawn), Roughness=drawn.uniform(0.2, 0.9))
        sheet = add(primitive("grid", x_segments=1, y_segments=1, size=1.0), paper)
        half = high * Vector((0.3 * longest + 1, 0.6 * len(lines) * spaced + 0.5, 1))
        sheet.matrix_world = place @ Matrix.Diagonal((*half, 1.0))

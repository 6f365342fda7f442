"""A cube and its shadow move over a floor; of the shadow, motion vectors say nothing."""

from __future__ import annotations

from stillray_training.blender.parts import Material, background, box, camera, light


def build(frames: int) -> None:
    """The scene, keyed for frames -1 to ``frames``: about 4 pixels a frame at a width of 320."""
    floor = Material("floor", Roughness=0.6)
    tiles = floor.node(
        "TexBrick", Vector=floor.coordinates(), Scale=1.0, Color1=(0.62, 0.58, 0.5, 1),
        Color2=(0.45, 0.5, 0.52, 1), Mortar=(0.2, 0.2, 0.2, 1), Mortar_Size=0.015,
    )  # fmt: skip
    floor.paint(tiles.outputs["Color"])
    box((-6, -6, -0.1), (6, 6, 0), floor)
    cube = box((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5), Material("cube", (0.7, 0.16, 0.1)), bevel=0.03)
    for frame in range(-1, frames + 1):
        cube.location = (-1.2 + 0.11 * frame, -0.2 + 0.03 * frame, 1.1)
        cube.keyframe_insert("location", frame=frame)
    box((1.5, 0.9, 0), (2.1, 1.5, 1.4), Material("pillar", (0.2, 0.35, 0.6)), bevel=0.03)
    light("AREA", (-2.5, -2.0, 4.5), (0, 0, 0), 260, size=0.7)
    background((0.75, 0.85, 1.0), 0.25)
    camera((0.3, -6.2, 3.6), (0.1, 0, 0.35), 38)

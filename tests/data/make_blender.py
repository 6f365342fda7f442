"""Render the small Blender frames of ``tests/data/blender``: ``python make_blender.py FOLDER``.

Two as ``frame_*.exr``, and the same with all passes of light and colour as ``lights_*.exr``.

Needs ``bpy`` 5.0 from PyPI, which the tests do not: they read the committed files. The camera
pans and moves, one object moves and turns, so that neither sign of the vector pass is ambiguous.
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy

WIDTH, HEIGHT, SAMPLES = 49, 35, 4


def material(name: str, scale: float, first: tuple, second: tuple) -> bpy.types.Material:
    """A diffuse material with a checker texture: something for a warp to be wrong about."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    checker = nodes.new("ShaderNodeTexChecker")
    checker.inputs["Scale"].default_value = scale
    checker.inputs["Color1"].default_value = (*first, 1)
    checker.inputs["Color2"].default_value = (*second, 1)
    coordinates = nodes.new("ShaderNodeTexCoord")
    links.new(coordinates.outputs["Object"], checker.inputs["Vector"])
    links.new(checker.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
    return made


def keyed(thing: bpy.types.Object, name: str, first: tuple, last: tuple) -> None:
    for frame, value in ((-2, first), (5, last)):
        setattr(thing, name, value)
        thing.keyframe_insert(name, frame=frame)


def build() -> bpy.types.Scene:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_plane_add(size=30)
    bpy.context.object.data.materials.append(
        material("floor", 0.7, (0.7, 0.6, 0.5), (0.15, 0.2, 0.35))
    )
    bpy.ops.mesh.primitive_cube_add(size=1.6, location=(0, 0, 0.9))
    cube = bpy.context.object
    cube.data.materials.append(material("cube", 2.5, (0.8, 0.2, 0.1), (0.9, 0.8, 0.2)))
    keyed(cube, "location", (-0.6, 0.2, 0.8), (0.9, -0.3, 1.7))
    keyed(cube, "rotation_euler", (0.1, 0, 0.3), (0.2, 0, 0.75))
    bpy.ops.object.camera_add(location=(0, -6, 2.5))
    camera = scene.camera = bpy.context.object
    keyed(camera, "location", (-0.4, -6.0, 2.3), (0.4, -5.6, 2.7))
    keyed(camera, "rotation_euler", (1.22, 0, -0.04), (1.18, 0, 0.08))
    bpy.ops.object.light_add(type="AREA", location=(2, -2, 5))
    bpy.context.object.data.energy = 400
    return scene


def settings(scene: bpy.types.Scene) -> None:
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples = "CPU", SAMPLES
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    scene.render.resolution_percentage = 100
    layer = scene.view_layers[0]
    layer.use_pass_z = layer.use_pass_vector = True
    layer.use_pass_diffuse_direct = layer.use_pass_cryptomatte_object = True
    layer.pass_cryptomatte_depth = 2
    layer.cycles.denoising_store_passes = True
    image = scene.render.image_settings
    image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth, image.exr_codec = "OPEN_EXR_MULTILAYER", "16", "ZIP"


def light_passes(layer: bpy.types.ViewLayer) -> None:
    """All that adds up to the beauty, and no cryptomatte."""
    for kind in ("diffuse", "glossy", "transmission"):
        for part in ("direct", "indirect", "color"):
            setattr(layer, f"use_pass_{kind}_{part}", True)
    layer.use_pass_emit = layer.use_pass_environment = True
    layer.cycles.use_pass_volume_direct = layer.cycles.use_pass_volume_indirect = True
    layer.use_pass_cryptomatte_object = False


if __name__ == "__main__":
    folder = Path(sys.argv[-1]).resolve()
    scene = build()
    settings(scene)
    for name in ("frame", "lights"):
        if name == "lights":
            light_passes(scene.view_layers[0])
        for number in (1, 2):
            scene.frame_set(number)
            scene.render.filepath = str(folder / f"{name}_{number:04d}.exr")
            bpy.ops.render.render(write_still=True)

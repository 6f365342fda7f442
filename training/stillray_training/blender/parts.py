"""Meshes, materials and lights out of Blender's own primitives and procedural textures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, Self

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector

Color = tuple[float, float, float]
Point = tuple[float, float, float]


class Material:
    """A principled material whose inputs are set by name, and its node tree for more.

    Parameters
    ----------
    name
        Name in Blender's data.
    color
        Scene-linear base colour in [0, 1].
    inputs
        Other inputs of the Principled BSDF by name, such as ``{"Roughness": 0.3}``.
    """

    def __init__(self, name: str, color: Color = (0.8, 0.8, 0.8), **inputs: float) -> None:
        data = bpy.data.materials.new(name)
        data.use_nodes = True
        self._take(data)
        self.surface.inputs["Base Color"].default_value = (*color, 1)
        for key, value in inputs.items():
            self.surface.inputs[key.replace("_", " ")].default_value = value

    @classmethod
    def of(cls, data: Any) -> Self:
        """A material that Blender's data holds already, with a Principled BSDF."""
        made = cls.__new__(cls)
        made._take(data)
        return made

    def _take(self, data: Any) -> None:
        self.data = data
        self.nodes, self.links = data.node_tree.nodes, data.node_tree.links
        self.surface = self.nodes["Principled BSDF"]

    def node(self, kind: str, **inputs: Any) -> Any:
        """A node of ``ShaderNode<kind>``; inputs are values, or outputs of other nodes."""
        made = self.nodes.new(f"ShaderNode{kind}")
        for key, value in inputs.items():
            socket = made.inputs[key.replace("_", " ")]
            if isinstance(value, bpy.types.NodeSocket):
                self.links.new(value, socket)
            else:
                socket.default_value = value
        return made

    def coordinates(self, scale: Point = (1, 1, 1), rotation: Point = (0, 0, 0)) -> Any:
        """Coordinates of the object, in its own metres times ``scale``: an output."""
        given = self.node("TexCoord").outputs["Object"]
        mapping = self.node("Mapping", Vector=given, Scale=scale, Rotation=rotation)
        return mapping.outputs["Vector"]

    def ramp(self, factor: Any, stops: Sequence[tuple[float, Color]]) -> Any:
        """Colours along a factor in [0, 1]: an output."""
        ramp = self.node("ValToRGB", Fac=factor)
        elements = ramp.color_ramp.elements
        while len(elements) < len(stops):
            elements.new(0.5)
        for element, (place, color) in zip(elements, stops, strict=True):
            element.position, element.color = place, (*color, 1)
        return ramp.outputs["Color"]

    def paint(self, color: Any) -> None:
        """Take an output as the base colour."""
        self.links.new(color, self.surface.inputs["Base Color"])

    def vary(self, name: str, value: Any) -> None:
        """Take an output for any input of the surface."""
        self.links.new(value, self.surface.inputs[name])

    def mix(self, other: Any, share: float) -> None:
        """Let another shader, a node, have a share of the surface, [0, 1]."""
        mixed = self.node("MixShader", Fac=share)
        self.links.new(self.surface.outputs[0], mixed.inputs[1])
        self.links.new(other.outputs[0], mixed.inputs[2])
        self.links.new(mixed.outputs[0], self.nodes["Material Output"].inputs["Surface"])

    def scatter(self, **inputs: Any) -> None:
        """Have no surface, and scatter light within; inputs as `node` takes them."""
        self.nodes.remove(self.surface)
        within = self.node("VolumeScatter", **inputs)
        self.links.new(within.outputs[0], self.nodes["Material Output"].inputs["Volume"])

    def emboss(self, height: Any, distance: float, strength: float = 1.0) -> None:
        """Relief that only normals show: bump of ``height``, ``distance`` metres deep."""
        bump = self.node("Bump", Height=height, Distance=distance, Strength=strength)
        self.links.new(bump.outputs["Normal"], self.surface.inputs["Normal"])


def principled() -> Iterator[Material]:
    """The scene's materials with a Principled BSDF, by name."""
    for data in sorted(bpy.data.materials, key=lambda each: str(each.name)):
        if data.node_tree and data.node_tree.nodes.get("Principled BSDF"):
            yield Material.of(data)


def glowing(color: Color, strength: float) -> Material:
    """What shines, and scatters nothing; radiance is ``color`` times ``strength``."""
    made = Material("glow", (0, 0, 0), Emission_Strength=strength)
    made.surface.inputs["Emission Color"].default_value = (*color, 1)
    return made


def wood(name: str, dark: Color, light: Color, *, plank: float | None = None) -> Material:
    """Varnished wood with grain along x; in planks of ``plank`` metres width if given."""
    made = Material(name, Roughness=0.3)
    grain = made.node(
        "TexNoise", Vector=made.coordinates((1.5, 22, 22)), Scale=2.0, Detail=2.0, Distortion=0.6
    ).outputs[0]
    rings = made.node(
        "TexWave", Vector=made.coordinates((0.5, 6, 6)), Scale=1.0, Distortion=9.0, Detail=1.0
    ).outputs[1]
    both = made.node("Math")
    made.links.new(grain, both.inputs[0])
    made.links.new(rings, both.inputs[1])
    both.operation = "MULTIPLY"
    color = made.ramp(both.outputs[0], [(0.1, dark), (0.55, light)])
    height = grain
    if plank:
        bricks = made.node(
            "TexBrick", Vector=made.coordinates(), Scale=1.0, Color1=(1, 1, 1, 1),
            Color2=(0.55, 0.5, 0.45, 1), Mortar=(0.03, 0.02, 0.02, 1), Mortar_Size=0.004,
            Brick_Width=1.3, Row_Height=plank,
        )  # fmt: skip
        mixed = made.node("MixRGB", Fac=1.0, Color1=color, Color2=bricks.outputs["Color"])
        mixed.blend_type = "MULTIPLY"
        color = mixed.outputs["Color"]
        height = bricks.outputs["Color"]
    made.paint(color)
    rough = made.node("MapRange", Value=grain)
    rough.inputs["To Min"].default_value, rough.inputs["To Max"].default_value = 0.15, 0.4
    made.vary("Roughness", rough.outputs[0])
    made.emboss(height, 0.002, 0.6)
    return made


def textile(name: str, first: Color, second: Color, *, threads: float) -> Material:
    """Woven cloth: a checked pattern, and threads as relief, ``threads`` a metre."""
    made = Material(name, Roughness=0.9)
    checks = made.node("TexChecker", Vector=made.coordinates((1, 1, 1)), Scale=threads / 16)
    checks.inputs["Color1"].default_value = (*first, 1)
    checks.inputs["Color2"].default_value = (*second, 1)
    made.paint(checks.outputs["Color"])
    weave = made.node("TexWave", Vector=made.coordinates(), Scale=threads / 6.3, Distortion=1.0)
    weave.wave_type, weave.bands_direction = "BANDS", "DIAGONAL"
    made.emboss(weave.outputs[1], 0.001, 0.7)
    return made


def add(mesh: Any, material: Material | None, place: Point = (0, 0, 0)) -> Any:
    """A mesh in the scene."""
    if material:
        mesh.materials.append(material.data)
    return _link(mesh, place)


def _link(data: Any, place: Point) -> Any:
    # not by operators, each of which updates every object
    thing = bpy.data.objects.new(data.name, data)
    thing.location = place
    bpy.context.scene.collection.objects.link(thing)
    return thing


def primitive(kind: str, **options: Any) -> Any:
    """A mesh out of ``bmesh.ops.create_<kind>``."""
    shape = bmesh.new()
    getattr(bmesh.ops, f"create_{kind}")(shape, **options)
    mesh = bpy.data.meshes.new(kind)
    shape.to_mesh(mesh)
    shape.free()
    return mesh


def box(low: Point, high: Point, material: Material | None, *, bevel: float = 0.0) -> Any:
    """An axis-aligned box between two corners, edges rounded by ``bevel`` metres."""
    size = [b - a for a, b in zip(low, high, strict=True)]
    x, y, z = ((a + b) / 2 for a, b in zip(low, high, strict=True))
    # the scale is in the mesh, so that object coordinates are metres
    mesh = primitive("cube", size=1.0, matrix=Matrix.Diagonal((*size, 1.0)))
    thing = add(mesh, material, (x, y, z))
    if bevel:
        modifier = thing.modifiers.new("bevel", "BEVEL")
        modifier.width, modifier.segments = bevel, 3
    return thing


def rod(start: Point, end: Point, radius: float, material: Material | None) -> Any:
    """A cylinder from one point to another."""
    along = Vector(end) - Vector(start)
    mesh = primitive(
        "cone", cap_ends=True, segments=20, radius1=radius, radius2=radius, depth=along.length
    )
    mesh.shade_smooth()
    mesh.set_sharp_from_angle(angle=math.radians(40))
    thing = add(mesh, material, (Vector(start) + Vector(end)) / 2)
    thing.rotation_euler = along.to_track_quat("Z", "Y").to_euler()
    return thing


def ball(center: Point, radius: float, material: Material | None) -> Any:
    """A sphere with smooth normals."""
    mesh = primitive("uvsphere", u_segments=48, v_segments=24, radius=radius)
    mesh.shade_smooth()
    return add(mesh, material, center)


def torus(center: Point, major: float, minor: float, material: Material | None) -> Any:
    """A ring around z of radius ``major`` to the middle of its tube of radius ``minor``."""
    steps = [2 * math.pi * step / 24 for step in range(25)]
    profile = [(major + minor * math.cos(turn), minor * math.sin(turn)) for turn in steps]
    return lathe(profile, center, material)


def lathe(profile: Sequence[tuple[float, float]], center: Point, material: Material | None) -> Any:
    """A surface of revolution about z through ``center``.

    Parameters
    ----------
    profile
        Radius and height of its points from bottom to top, metres.
    center
        What radius 0, height 0 is.
    material
        Its material.
    """
    count = 48
    points = [
        (r * math.cos(turn), r * math.sin(turn), z)
        for r, z in profile
        for turn in (2 * math.pi * step / count for step in range(count))
    ]
    faces = [
        (row * count + i, row * count + (i + 1) % count, (row + 1) * count + (i + 1) % count,
         (row + 1) * count + i)
        for row in range(len(profile) - 1)
        for i in range(count)
    ]  # fmt: skip
    mesh = bpy.data.meshes.new("lathe")
    mesh.from_pydata(points, [], faces)
    mesh.shade_smooth()
    return add(mesh, material, center)


def hair(paths: Any, radius: float, material: Material, place: Point = (0, 0, 0)) -> Any:
    """Hair in the scene, a fifth as thick at its tip.

    Parameters
    ----------
    paths : (hairs, steps, 3)
        Points of each from root to tip, of a NumPy array.
    radius
        At the root, metres.
    material
        Its material.
    place
        What point 0 is.
    """
    count, steps, _ = paths.shape
    data = bpy.data.hair_curves.new("hair")
    data.add_curves([steps] * count)
    data.attributes["position"].data.foreach_set("vector", paths.astype(np.float32).ravel())
    radii = data.attributes.get("radius") or data.attributes.new("radius", "FLOAT", "POINT")
    thinner = radius * np.linspace(1, 0.2, steps)
    radii.data.foreach_set("value", np.tile(thinner, count).astype(np.float32))
    return add(data, material, place)


def text(words: str, size: float, material: Material, place: Point = (0, 0, 0)) -> Any:
    """Flat letters in the scene, ``size`` metres from line to line; their curve is its ``data``."""
    data = bpy.data.curves.new("text", "FONT")
    data.body, data.size = words, size
    return add(data, material, place)


def key(
    thing: Any, step: Vector, frames: int, stands: float, turn: Sequence[float] = (0, 0, 0)
) -> None:
    """Key a thing for frames -1 to ``frames``, which moves and turns evenly.

    Parameters
    ----------
    thing
        Where it stands in frame ``stands``.
    step
        From frame to frame, metres.
    frames
        How many will be rendered.
    stands
        That frame, which may lie between two.
    turn
        From frame to frame, radians about each axis.
    """
    start, angles = thing.location.copy(), thing.rotation_euler.copy()
    for frame in range(-1, frames + 1):
        thing.location = start + step * (frame - stands)
        thing.rotation_euler = tuple(
            angle + part * (frame - stands) for angle, part in zip(angles, turn, strict=True)
        )
        thing.keyframe_insert("location", frame=frame)
        thing.keyframe_insert("rotation_euler", frame=frame)


def aim(thing: Any, target: Point) -> None:
    """Turn a camera or light so that it looks at a point."""
    direction = Vector(target) - thing.location
    thing.rotation_euler = direction.to_track_quat("-Z", "Y").to_euler()


def light(kind: str, place: Point, target: Point, power: float, **settings: Any) -> Any:
    """A lamp of ``kind`` (``AREA``, ``POINT``, ``SUN``) aimed at a point; W, or W/m^2 for SUN."""
    lamp = bpy.data.lights.new(kind, kind)
    lamp.energy = power
    thing = _link(lamp, place)
    for name, value in settings.items():
        setattr(thing.data, name, value)
    aim(thing, target)
    return thing


def camera(place: Point, target: Point, lens: float) -> Any:
    """The scene's camera, ``lens`` in millimetres on a sensor of 36."""
    thing = bpy.context.scene.camera = _link(bpy.data.cameras.new("camera"), place)
    thing.data.lens = lens
    aim(thing, target)
    return thing


def background(color: Color, strength: float) -> None:
    """Light of one colour from everywhere."""
    world = bpy.data.worlds.new("world")
    world.use_nodes = True
    shader = world.node_tree.nodes["Background"]
    shader.inputs["Color"].default_value = (*color, 1)
    shader.inputs["Strength"].default_value = strength
    bpy.context.scene.world = world


def sky(elevation: float, strength: float) -> None:
    """A sky to be looked at: it lights nothing, and its sun is a lamp; ``elevation`` in degrees."""
    world = bpy.data.worlds.new("world")
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    texture = nodes.new("ShaderNodeTexSky")
    texture.sun_disc, texture.sun_elevation = False, math.radians(elevation)
    nodes["Background"].inputs["Strength"].default_value = strength
    links.new(texture.outputs[0], nodes["Background"].inputs["Color"])
    bpy.context.scene.world = world
    world.cycles_visibility.diffuse = False

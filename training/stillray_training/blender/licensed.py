"""Objects out of a folder of assets, each a Mitsuba scene of shapes, with their texture maps."""

from __future__ import annotations

from pathlib import Path
from random import Random
from typing import Any
from xml.etree import ElementTree

import bpy
import numpy as np

from stillray_training.blender.parts import Material, Point, add

_NUMBERS = {"float": "<f4", "int": "<i4", "uint": "<u4", "uchar": "u1"}


def names(folder: Path) -> list[str]:
    """Assets of a folder, sorted."""
    return sorted(path.parent.name for path in folder.glob("*/asset.xml"))


def place(folder: Path, name: str, at: Point, drawn: Random, size: float | None = None) -> Any:
    """An asset that stands on a point, turned about the vertical; returns what holds its parts.

    Parameters
    ----------
    folder, name
        Which.
    at
        Where its foot is, metres.
    drawn
        Draws how it is turned.
    size
        Its longest side in metres; None for its own.
    """
    holder = bpy.data.objects.new(name, None)
    bpy.context.scene.collection.objects.link(holder)
    scene = ElementTree.parse(folder / name / "asset.xml").getroot()
    described = {bsdf.get("id"): bsdf for bsdf in scene.findall("bsdf")}
    longest = 0.0
    for shape in scene.findall("shape"):
        file = shape.find("string[@name='filename']")
        if file is None:
            continue
        mesh, extent = _mesh(folder / name / file.attrib["value"])
        longest = max(longest, extent)
        reference = shape.find("ref")
        bsdf = described.get(reference.get("id")) if reference is not None else shape.find("bsdf")
        thing = add(mesh, _surface(folder / name, bsdf))
        thing.parent = holder
    holder.location = at
    # files have y up
    holder.rotation_euler = (np.pi / 2, 0, drawn.uniform(0, 2 * np.pi))
    factor = 1.0 if size is None else size / max(longest, 1e-6)
    holder.scale = (factor,) * 3
    return holder


def _mesh(path: Path) -> tuple[Any, float]:
    """A PLY of triangles with normals and texture coordinates, and its longest side."""
    raw = path.read_bytes()
    end = raw.index(b"end_header\n") + len(b"end_header\n")
    counts: dict[str, int] = {}
    fields: list[tuple[str, str]] = []
    for words in (line.split() for line in raw[:end].decode().splitlines()):
        if words[0] == "element":
            counts[words[1]] = int(words[2])
        elif words[0] == "property" and words[1] != "list" and len(counts) == 1:
            fields.append((words[2], _NUMBERS[words[1]]))
        elif words[:2] == ["property", "list"]:
            faces = np.dtype([("n", _NUMBERS[words[2]]), ("corner", _NUMBERS[words[3]], 3)])
    vertices = np.frombuffer(raw, np.dtype(fields), counts["vertex"], end)
    known = {name for name, _ in fields}
    triangles = np.frombuffer(raw, faces, counts["face"], end + vertices.nbytes)["corner"]
    points = np.stack([vertices[axis] for axis in "xyz"], -1)
    mesh = bpy.data.meshes.new(path.stem)
    mesh.from_pydata(points.tolist(), [], triangles.tolist())
    mesh.shade_smooth()
    if "nx" in known:
        mesh.normals_split_custom_set_from_vertices(
            np.stack([vertices[axis] for axis in ("nx", "ny", "nz")], -1).tolist()
        )
    across, down = ("u", "v") if "u" in known else ("s", "t")
    if across in known:
        layer = mesh.uv_layers.new(name="uv")
        # files have v downwards
        uv = np.stack([vertices[across], 1 - vertices[down]], -1)[triangles.reshape(-1)]
        layer.data.foreach_set("uv", np.ascontiguousarray(uv, np.float32).reshape(-1))
    return mesh, float(np.ptp(points, axis=0).max())


def _surface(folder: Path, bsdf: Any) -> Material:
    """A principled material with the maps that a Mitsuba BSDF names."""
    made = Material("asset", (0.7, 0.7, 0.7), Roughness=0.5)
    if bsdf is None:
        return made
    kinds = {part.get("type") for part in bsdf.iter("bsdf")}
    if kinds & {"dielectric", "thindielectric", "roughdielectric"}:
        made.surface.inputs["Transmission Weight"].default_value = 1.0
        made.surface.inputs["Base Color"].default_value = (1, 1, 1, 1)
        made.surface.inputs["Roughness"].default_value = 0.0
        return made
    for role, socket in (
        ("base_color", "Base Color"), ("roughness", "Roughness"), ("metallic", "Metallic"),
        ("opacity", "Alpha"),
    ):  # fmt: skip
        _take(made, folder, bsdf, role, socket)
    if (relief := _map(folder, bsdf, "normalmap")) is not None:
        color = _image(made, relief, raw=True).outputs["Color"]
        if "_mirrored" in relief.name:
            # turned for Mitsuba, which does not see mirrored coordinates itself; Blender does
            turned = made.node("VectorMath")
            turned.operation = "MULTIPLY_ADD"
            made.links.new(color, turned.inputs[0])
            turned.inputs[1].default_value, turned.inputs[2].default_value = (1, -1, 1), (0, 1, 0)
            color = turned.outputs[0]
        bent = made.node("NormalMap", Color=color)
        made.vary("Normal", bent.outputs["Normal"])
    return made


def _take(made: Material, folder: Path, bsdf: Any, role: str, socket: str) -> None:
    if (path := _map(folder, bsdf, role)) is not None:
        made.vary(socket, _image(made, path, raw=role != "base_color").outputs["Color"])
        return
    for kind in ("float", "rgb"):
        given = bsdf.find(f".//{kind}[@name='{role}']")
        if given is not None:
            numbers = [float(part) for part in given.attrib["value"].replace(",", " ").split()]
            value = numbers[0] if kind == "float" else (*(numbers * 3)[:3], 1.0)
            made.surface.inputs[socket].default_value = value


def _map(folder: Path, bsdf: Any, role: str) -> Path | None:
    file = bsdf.find(f".//texture[@name='{role}']/string[@name='filename']")
    return None if file is None else folder / file.attrib["value"]


def _image(made: Material, path: Path, *, raw: bool) -> Any:
    node = made.node("TexImage")
    node.image = bpy.data.images.load(str(path), check_existing=True)
    node.image.colorspace_settings.name = "Non-Color" if raw else "sRGB"
    return node

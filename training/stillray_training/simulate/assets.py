"""Objects from a folder of assets: meshes, materials as Mitsuba files have them, credits.

A folder holds one folder an object: ``asset.xml`` (a Mitsuba scene of ``ply`` shapes and their
materials, metres, y up, standing on y = 0), the files it names, and ``asset.json`` (name, title,
kind, author, licence, source).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from stillray.errors import InputError
from stillray_training.simulate.mesh import Mesh
from stillray_training.simulate.node import Node, rgb
from stillray_training.simulate.world import Credit, Surface

ASSET = "asset"  # asks for the plugins of an asset's materials
_VERTEX = ("x", "y", "z", "nx", "ny", "nz", "u", "v")


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """A mesh of an asset and its material; ``emission`` where it shines."""

    mesh: Mesh
    surface: Surface
    emission: Node | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Asset:
    """An object: its parts, its box, and who made it."""

    name: str
    kind: str  # "furniture", "clutter", "plant", "lamp" ...
    parts: tuple[Part, ...]
    low: np.ndarray  # (3,) corner of its box, metres
    high: np.ndarray
    credit: Credit

    @property
    def size(self) -> np.ndarray:
        """``(3,)`` extent in metres."""
        return np.asarray(self.high - self.low)


class Library:
    """The assets of a folder, read when they are asked for.

    Parameters
    ----------
    folder
        Holds one folder an object.

    Raises
    ------
    InputError
        The folder holds no asset.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.names = sorted(path.parent.name for path in folder.glob("*/asset.xml"))
        if not self.names:
            raise InputError(f"assets must be a folder of */asset.xml, got {folder}")

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def get(self, name: str) -> Asset:
        """The asset of that name; the same object each time, so that its parts share materials."""
        return _read(self.folder / name)

    def kind(self, kind: str) -> list[str]:
        """Names of the assets of a kind."""
        return [name for name in self.names if _facts(self.folder / name)["kind"] == kind]


@cache
def _facts(folder: Path) -> dict[str, str]:
    try:
        facts = json.loads((folder / "asset.json").read_text(encoding="utf-8"))
        return {key: str(facts[key]) for key in
                ("name", "title", "kind", "author", "licence", "source")}  # fmt: skip
    except (OSError, ValueError, KeyError) as error:
        raise InputError(
            f"{folder / 'asset.json'} must hold name, title, kind, author, licence, source: {error}"
        ) from None


@cache
def _read(folder: Path) -> Asset:
    facts = dict(_facts(folder))
    try:
        root = ElementTree.parse(folder / "asset.xml").getroot()
        materials = {
            element.attrib["id"]: Surface(color=(0.5, 0.5, 0.5), material=_node(element, folder))
            for element in root.findall("bsdf")
        }
        parts = tuple(_part(shape, folder, materials) for shape in root.findall("shape"))
    except (OSError, ElementTree.ParseError, KeyError, ValueError, StopIteration) as error:
        raise InputError(f"{folder / 'asset.xml'} cannot be read: {error!r}") from None
    points = np.concatenate([part.mesh.vertices for part in parts])
    kind = facts.pop("kind")
    return Asset(
        name=facts["name"], kind=kind, parts=parts, low=points.min(axis=0),
        high=points.max(axis=0), credit=Credit(**facts),
    )  # fmt: skip


def _part(shape: ElementTree.Element, folder: Path, materials: dict[str, Surface]) -> Part:
    names = {child.attrib["name"]: child.attrib for child in shape if "name" in child.attrib}
    emitter = shape.find("emitter")
    return Part(
        mesh=_placed(read_ply(folder / names["filename"]["value"]), shape.find("transform")),
        surface=materials[names["bsdf"]["id"]],
        emission=None if emitter is None else _node(emitter, folder),
    )


def _node(element: ElementTree.Element, folder: Path) -> Node:
    """A plugin of a Mitsuba file with all below it."""
    params: dict[str, object] = {}
    for index, child in enumerate(element):
        name, value = child.attrib.get("name", f"nested{index}"), child.attrib.get("value", "")
        if child.tag in ("bsdf", "texture"):
            params[name] = _node(child, folder)
        elif child.tag == "float":
            params[name] = float(value)
        elif child.tag == "boolean":
            params[name] = value == "true"
        elif child.tag == "rgb":
            params[name] = rgb(tuple(float(v) for v in value.replace(",", " ").split()))
        elif child.tag == "string":
            params[name] = str(folder / value) if name == "filename" else value
        else:
            raise ValueError(f"unknown element {child.tag}")
    return Node(plugin=element.attrib["type"], asked_by=ASSET, params=params)


def _placed(mesh: Mesh, transform: ElementTree.Element | None) -> Mesh:
    """The mesh under a shape's ``<transform><matrix/></transform>``, where it has one."""
    if transform is None:
        return mesh
    if [step.tag for step in transform] != ["matrix"]:
        raise ValueError("a transform must be one matrix")
    values = [float(v) for v in transform[0].attrib["value"].split()]
    return mesh.moved(np.array(values).reshape(4, 4))


def read_ply(path: Path) -> Mesh:
    """A binary little-endian PLY of triangles with float positions, normals and texture places.

    Raises
    ------
    ValueError
        The file is laid out in another way.
    """
    data = path.read_bytes()
    head, _, body = data.partition(b"end_header\n")
    lines = [line.split() for line in head.decode("ascii").splitlines()]
    counts = {line[1]: int(line[2]) for line in lines if line[0] == "element"}
    columns = tuple(line[2] for line in lines if line[:2] == ["property", "float"])
    if ["format", "binary_little_endian", "1.0"] not in lines or columns != _VERTEX:
        raise ValueError(f"{path}: must be binary with {' '.join(_VERTEX)} as floats")
    vertices = np.frombuffer(body, "<f4", counts["vertex"] * 8).reshape(-1, 8).astype(float)
    face = np.dtype([("n", "u1"), ("index", "<i4", 3)])
    faces = np.frombuffer(body, face, counts["face"], offset=counts["vertex"] * 32)
    if (faces["n"] != 3).any():
        raise ValueError(f"{path}: must be of triangles")
    return Mesh(
        vertices=vertices[:, :3],
        normals=vertices[:, 3:6],
        uvs=vertices[:, 6:],
        faces=faces["index"].astype(int),
    )

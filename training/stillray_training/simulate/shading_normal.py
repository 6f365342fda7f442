"""The normal that a material shades with: the vertex normal, bent by normal and bump maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True, eq=False)
class BentShape:
    """A shape whose material bends its normals, and the texture that does."""

    shape: Any
    texture: Any
    kind: str  # "normalmap" or "bumpmap"
    scale: float = 1.0  # of a bump map's heights


def bent_shapes(mi: Any, shapes: list[Any]) -> list[BentShape]:
    """The shapes that a normal or bump map is on, however deep in their material it lies."""
    found: dict[Any, tuple[Any, str, float] | None] = {}
    bent = []
    for shape in shapes:
        bsdf = shape.bsdf()
        if bsdf is None:
            continue
        if bsdf not in found:
            found[bsdf] = _find(mi, bsdf)
        if (hit := found[bsdf]) is not None:
            bent.append(BentShape(shape=shape, texture=hit[0], kind=hit[1], scale=hit[2]))
    return bent


def shading_normal(mi: Any, bent: list[BentShape], si: Any, hit: Any) -> Any:
    """Unit normals in world space that the materials at ``si`` shade with, for every variant.

    Mitsuba's ``si.sh_frame.n`` is the vertex normal; its materials bend it by themselves and show
    the result to nobody. These are the formulas of its ``normalmap`` and ``bumpmap``.
    """
    normal = si.sh_frame.n
    if "scalar" in mi.variant():
        for one in bent:
            if hit and one.shape.id() == si.shape.id():
                return _bent(mi, one, si, True)
        return normal
    import drjit as dr

    for one in bent:
        mask = hit & (si.shape == mi.ShapePtr(one.shape))
        normal = dr.select(mask, _bent(mi, one, si, mask), normal)
    return normal


def _bent(mi: Any, one: BentShape, si: Any, mask: Any) -> Any:
    import drjit as dr

    if one.kind == "normalmap":
        local = mi.Normal3f(one.texture.eval_3(si, mask)) * 2 - 1
        return mi.Normal3f(dr.normalize(si.sh_frame.to_world(mi.Vector3f(dr.normalize(local)))))
    slope = one.scale * one.texture.eval_1_grad(si, mask)
    n = mi.Vector3f(si.sh_frame.n)
    along_u = si.dp_du + n * (slope[0] - dr.dot(n, si.dp_du))
    along_v = si.dp_dv + n * (slope[1] - dr.dot(n, si.dp_dv))
    bent = dr.normalize(dr.cross(along_u, along_v))
    # on the side of the surface that its geometry faces
    return mi.Normal3f(dr.select(dr.dot(mi.Vector3f(si.n), bent) < 0, -bent, bent))


def _find(mi: Any, bsdf: Any) -> tuple[Any, str, float] | None:
    """Texture, kind and scale of the outermost map in a material, or None."""

    class Children(mi.TraversalCallback):  # type: ignore[misc,name-defined]
        def __init__(self) -> None:
            super().__init__()
            self.objects: dict[str, Any] = {}

        def put(self, name: str, value: Any, flags: Any, cpptype: Any = None) -> None:
            if isinstance(value, mi.Object):
                self.objects[name] = value

    children = Children()
    bsdf.traverse(children)
    if bsdf.class_name() == "NormalMap":
        return children.objects["normalmap"], "normalmap", 1.0
    if bsdf.class_name() == "BumpMap":
        scale = float(mi.traverse(bsdf)["scale"])
        return children.objects["nested_texture"], "bumpmap", scale
    for child in children.objects.values():
        if isinstance(child, mi.BSDF) and (found := _find(mi, child)):
            return found
    return None

"""A plan as a loaded Mitsuba scene that can be posed and aimed without compiling anew."""

from __future__ import annotations

from typing import Any

import numpy as np

from stillray_training.simulate.assets import ASSET
from stillray_training.simulate.camera import Camera
from stillray_training.simulate.mesh import Mesh
from stillray_training.simulate.node import Node, to_mitsuba
from stillray_training.simulate.plan import REFERENCE_ROULETTE, Plan
from stillray_training.simulate.shading_normal import bent_shapes

HULL = "medium_hull"  # the cube that holds a medium
_HULL_MARGIN = 0.5  # of the scene's extent, on every side


class Stage:
    """A loaded scene with a camera.

    Parameters
    ----------
    mi
        The Mitsuba module with its variant set.
    plan
        What to build.
    height, width
        Size of the noisy frames in pixels.

    Attributes
    ----------
    scene, integrator, sensor, reference_integrator, reference_sensor
        Mitsuba objects; those for references end paths sooner and have the references' size.
    groups : list of str
        What moves; a group's place in it plus 1 is its object index, 0 is what stands still.
    movers : list of (Mitsuba shape, int)
        Mitsuba shapes that move, and their object index.
    bent : list of BentShape
        Shapes whose material bends their normals.
    """

    def __init__(self, mi: Any, plan: Plan, height: int, width: int) -> None:
        self.mi, self.plan = mi, plan
        self.height, self.width = height, width
        self.groups = list(plan.motions)
        objects = self._file_objects()
        moving = {name: objects[name] for name in self.groups if name in objects}
        objects.update(self._meshes())
        objects.update({name: to_mitsuba(mi, node) for name, node in plan.lights.items()})
        self.medium = mi.load_dict(to_mitsuba(mi, plan.medium)) if plan.medium else None
        if self.medium is not None:
            objects[HULL] = self._hull(self.medium)
        self.scene = mi.load_dict({"type": "scene", **objects})
        self.bent = bent_shapes(mi, self.scene.shapes())
        self.integrator = mi.load_dict(to_mitsuba(mi, plan.integrator))
        self.reference_integrator = mi.load_dict(
            {**to_mitsuba(mi, plan.integrator), "rr_depth": REFERENCE_ROULETTE}
        )
        scale = plan.wants.reference_scale
        self.sensor = self._sensor(1)
        self.reference_sensor = self.sensor if scale == 1 else self._sensor(scale)
        self._sensors = {id(s): s for s in (self.sensor, self.reference_sensor)}.values()
        self._posed: float | None = None
        self._parameters = mi.traverse(self.scene) if self.groups else None
        self.movers = [
            (shape, self.groups.index(plan.shapes[shape.id()].group) + 1)
            for shape in self.scene.shapes()
            if shape.id() in plan.shapes and plan.shapes[shape.id()].group
        ]
        self.movers += [(shape, self.groups.index(name) + 1) for name, shape in moving.items()]
        self._file_points = {
            name: np.array(mi.traverse(shape)["vertex_positions"], float).reshape(-1, 3)
            for name, shape in moving.items()
        }

    def matrices(self, time: float) -> dict[str, np.ndarray]:
        """World transforms of the moving groups at a time in frames."""
        return {group: motion(time) for group, motion in self.plan.motions.items()}

    def pose(self, time: float) -> None:
        """Move every group to where it is at a time in frames."""
        if self._parameters is None or time == self._posed:
            return
        moved = {
            name: shape.mesh.moved(self.plan.motions[shape.group](time))
            for name, shape in self.plan.shapes.items()
            if shape.group
        }
        for name, mesh in moved.items():
            self._parameters[f"{name}.vertex_positions"] = _flat(mesh.vertices)
        for name, points in self._file_points.items():
            matrix = self.plan.motions[name](time)
            self._parameters[f"{name}.vertex_positions"] = _flat(
                points @ matrix[:3, :3].T + matrix[:3, 3]
            )
        for light, group in self.plan.light_groups.items():
            where = np.append(self.plan.lights[light].params["position"], 1.0)
            place = self.plan.motions[group](time) @ where
            self._parameters[f"{light}.position"] = self.mi.ScalarPoint3f(place[:3].tolist())
        self._parameters.update()
        # Mitsuba makes smooth normals of its own for moved vertices: ours are set after that
        for name, mesh in moved.items():
            self._parameters[f"{name}.vertex_normals"] = _flat(mesh.normals)
        self._parameters.update()
        self._posed = time

    def aim(self, camera: Camera, focus: float) -> None:
        """Put the camera somewhere; ``focus`` is the distance of the plane in focus, metres."""
        for sensor in self._sensors:
            parameters = self.mi.traverse(sensor)
            parameters["to_world"] = self.mi.ScalarTransform4f(camera.to_world.tolist())
            parameters["x_fov"] = camera.fov_x
            if self.plan.sensor.plugin == "thinlens":
                parameters["focus_distance"] = float(focus)
                parameters["aperture_radius"] = float(self.plan.world.lens.aperture * focus)
            parameters.update()

    def roughness(self) -> list[tuple[Any, Any]]:
        """GGX alpha of each shape: a number, or a Mitsuba texture."""
        table = []
        for shape in self.scene.shapes():
            planned = self.plan.shapes.get(shape.id())
            node = self.plan.materials[planned.material] if planned and planned.material else None
            if node is not None and node.asked_by == ASSET:
                value = _file_alpha(self.mi, shape.bsdf())
            elif node is not None:
                value = _alpha(node)
            else:
                value = 1.0 if planned is not None else _file_alpha(self.mi, shape.bsdf())
            if isinstance(value, Node):
                value = self.mi.load_dict(to_mitsuba(self.mi, value))
            table.append((shape, value))
        return table

    def _sensor(self, scale: int) -> Any:
        description: dict[str, Any] = {
            **to_mitsuba(self.mi, self.plan.sensor),
            "fov": 60.0,
            "fov_axis": "x",
            "near_clip": 1e-3,
            "far_clip": 1e5,
            "film": {
                "type": "hdrfilm",
                "width": self.width * scale,
                "height": self.height * scale,
                "pixel_format": "rgb",
                "component_format": "float32",
                "rfilter": {"type": "box"},
            },
            "sampler": {"type": "independent"},
        }
        if self.medium is not None:
            description["medium"] = self.medium
        return self.mi.load_dict(description)

    def _meshes(self) -> dict[str, Any]:
        materials = {
            key: self.mi.load_dict(to_mitsuba(self.mi, node))
            for key, node in self.plan.materials.items()
        }
        dark = None
        objects = {}
        for name, shape in self.plan.shapes.items():
            if shape.emitter is None:
                objects[name] = _mesh(self.mi, name, shape.mesh, materials[shape.material], None)
            else:
                dark = dark or self.mi.load_dict(
                    {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
                )
                objects[name] = _mesh(self.mi, name, shape.mesh, dark, shape.emitter)
        return objects

    def _file_objects(self) -> dict[str, Any]:
        if self.plan.world.file is None:
            return {}
        base = self.plan.world.file.scene
        objects = {f"file{index}": shape for index, shape in enumerate(base.shapes())}
        surface = self.mi.EmitterFlags.Surface  # those come with their shapes
        alone = [e for e in base.emitters() if not self.mi.has_flag(e.flags(), surface)]
        objects.update({f"file_light{index}": light for index, light in enumerate(alone)})
        return objects

    def _hull(self, medium: Any) -> dict[str, Any]:
        corners = [s.mesh.vertices for s in self.plan.shapes.values()]
        if self.plan.world.file:
            box = self.plan.world.file.scene.bbox()
            ends = np.array([box.min, box.max], float).reshape(2, 3)
            corners.append(ends)
            if self.plan.world.home:  # cameras orbit the scene, perhaps from outside of it
                middle = ends.mean(axis=0)
                reach = np.linalg.norm(self.plan.world.home.to_world[:3, 3] - middle)
                corners.append(middle + reach * np.array([[-1.0] * 3, [1.0] * 3]))
        if self.plan.world.space:
            corners.append(np.array(self.plan.world.space))
        points = np.concatenate(corners)
        low, high = points.min(axis=0), points.max(axis=0)
        margin = _HULL_MARGIN * float((high - low).max())
        to_world = np.diag([*((high - low) / 2 + margin), 1.0])
        to_world[:3, 3] = (low + high) / 2
        return {
            "type": "cube",
            "to_world": self.mi.ScalarTransform4f(to_world.tolist()),
            "bsdf": {"type": "null"},
            "interior": medium,
        }


def _mesh(mi: Any, name: str, mesh: Mesh, bsdf: Any, emitter: Node | None) -> Any:
    properties = mi.Properties()
    properties.set_id(name)
    properties["bsdf"] = bsdf
    if emitter is not None:
        properties["emitter"] = mi.load_dict(to_mitsuba(mi, emitter))
    made = mi.Mesh(
        name,
        len(mesh.vertices),
        len(mesh.faces),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
        props=properties,
    )
    parameters = mi.traverse(made)
    parameters["vertex_positions"] = _flat(mesh.vertices)
    parameters["faces"] = np.ascontiguousarray(mesh.faces, np.uint32).ravel()
    parameters["vertex_texcoords"] = _flat(mesh.uvs)
    parameters.update()
    # set last: an update of the positions makes smooth normals and would overwrite these
    parameters["vertex_normals"] = _flat(mesh.normals)
    parameters.update()
    made.set_id(name)
    return made


_SMOOTH = ("conductor", "dielectric", "thindielectric")


def _alpha(node: Node) -> Any:
    alphas = [n.params["alpha"] for n in node.walk() if "alpha" in n.params]
    if alphas:
        return alphas[0]
    return 0.0 if any(n.plugin in _SMOOTH for n in node.walk()) else 1.0


def _file_alpha(mi: Any, bsdf: Any) -> float:
    """Mean alpha of a loaded material; 1 for diffuse ones, 0 for smooth ones."""
    parameters = mi.traverse(bsdf)
    for name in parameters.keys():  # noqa: SIM118  not a dict: it has no iterator
        parts = name.split(".")
        if {"alpha", "alpha_u", "roughness"} & set(parts) and parts[-1] in (
            "alpha", "alpha_u", "roughness", "value", "data",
        ):  # fmt: skip
            values = np.array(parameters[name])
            mean = float(np.mean(values))
            if values.dtype.kind == "u":  # a picture of bytes is kept as it is
                mean /= np.iinfo(values.dtype).max
            # Disney's principled material squares what an artist sets
            return mean**2 if "roughness" in parts else mean
    smooth = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta)
    return 0.0 if smooth else 1.0


def _flat(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32).ravel()

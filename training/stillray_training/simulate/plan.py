"""What will be simulated, and which effect asked for it.

The plan is what ``--explain`` prints and what the stage builds and renders: there is no second
place that decides. It needs no Mitsuba.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from stillray.errors import InputError
from stillray_training.simulate.effects import EFFECTS, check_names
from stillray_training.simulate.effects.base import Buffer, Dimension, Effect
from stillray_training.simulate.mesh import Mesh, join
from stillray_training.simulate.node import BASE, Node, rgb
from stillray_training.simulate.world import Lamp, Motion, Surface, World

BASE_DEPTH = 8  # path vertices: what the validation scenes were rendered with
# Vertex from which Russian roulette may end a path. Noisy frames do what renderers commonly do, and
# what the validation scenes were rendered with; references end paths from the first hit on. From 2
# to 1, a room, a corridor, a court and a table top take 0.85, 0.97, 0.83 and 0.74 of the CPU time
# for the same samples and have 1.15, 1.12, 1.10 and 1.09 times the tone-mapped variance: as good a
# picture a second or better. From 5 to 2 it was a quarter to a third less time, and as good.
ROULETTE, REFERENCE_ROULETTE = 5, 1
FILE = "the file"  # asks for what an XML file brings along
OPTION = "option"
GUIDES = {"roughness": 1, "specular_albedo": 3}  # buffers on demand and their channels


@dataclass(frozen=True, kw_only=True)
class Wants:
    """Buffers on demand."""

    second_color: bool = False  # an independent second estimate
    guides: tuple[str, ...] = ()  # of GUIDES
    jitter: bool = False  # the image plane is shifted by a sub-pixel offset each frame
    reference_scale: int = 1  # references have so many times the width and height: 1 or 2
    depth: int | None = None  # path vertices, 1 or more; None: what the effects ask for

    def __post_init__(self) -> None:
        if self.depth is not None and self.depth < 1:
            raise InputError(f"depth must be 1 or more, got {self.depth}")
        if unknown := sorted(set(self.guides) - set(GUIDES)):
            raise InputError(f"guides must be of {', '.join(GUIDES)}, got {', '.join(unknown)}")
        if self.reference_scale not in (1, 2):
            raise InputError(f"reference_scale must be 1 or 2, got {self.reference_scale}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Shape:
    """One mesh of the scene: all still pieces of one surface, or one surface of a moving group."""

    mesh: Mesh
    material: str  # key of `Plan.materials`; "" for a lamp's black body
    emitter: Node | None = None
    group: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """Everything a stage needs, and who asked for it."""

    world: World
    effects: tuple[str, ...]
    wants: Wants
    shapes: dict[str, Shape]
    materials: dict[str, Node]
    lights: dict[str, Node]  # emitters without a mesh
    light_groups: dict[str, str]  # of the lights that move
    medium: Node | None
    sensor: Node
    integrator: Node
    depth: list[tuple[int, str]]  # path vertices, and who asked for them
    dimensions: list[Dimension]
    buffers: list[Buffer]
    motions: dict[str, Motion]
    shutter: float  # open part of the frame time; 0: every sample sees the middle of the frame

    def nodes(self) -> Iterator[Node]:
        """Every plugin of the scene but the meshes themselves."""
        roots: list[Node] = [*self.materials.values(), *self.lights.values()]
        roots += [shape.emitter for shape in self.shapes.values() if shape.emitter]
        roots += [self.medium] if self.medium else []
        for root in (*roots, self.sensor, self.integrator):
            yield from root.walk()

    def plugins(self) -> Counter[tuple[str, str]]:
        """How often each plugin is used, by plugin and by who asked for it."""
        counts = Counter((node.plugin, node.asked_by) for node in self.nodes())
        counts.update({("mesh", BASE): len([s for s in self.shapes.values() if not s.emitter])})
        for shape in self.shapes.values():
            if shape.emitter:
                counts[("mesh", shape.emitter.asked_by)] += 1
        if self.medium:  # the hull that holds the medium
            counts[("cube", self.medium.asked_by)] += 1
            counts[("null", self.medium.asked_by)] += 1
        if self.world.file:
            counts.update({(p, FILE): n for p, n in self.world.file.plugins.items()})
        return +counts


def make_plan(
    world: World, effects: Iterable[str] | None = None, wants: Wants | None = None
) -> Plan:
    """Decide what is simulated.

    Parameters
    ----------
    world
        The scene.
    effects
        Names of `EFFECTS`; None: those that the scene itself calls for.
    wants
        Buffers on demand.

    Raises
    ------
    InputError
        An effect is unknown, or asks for something that the scene does not have, or nothing
        would shine.
    """
    wants = wants or Wants()
    own = world.file.effects if world.file else ()
    names = check_names((*(world.effects if effects is None else effects), *own))
    active = [EFFECTS[name] for name in names]
    for effect in active:
        if effect.name not in own and (lack := effect.missing(world)):
            raise InputError(f"effect {effect.name} needs {lack}, and {world.label} has none")
    added = [effect for effect in active if effect.name not in own]
    motions = {g: m for effect in added for g, m in effect.motions(world).items()}
    materials, shapes = _surfaces(world, added, motions)
    lights, light_groups = _lamps(world, added, motions, shapes)
    for effect in added:
        lights.update(effect.lights(world))
    shapes, lights = _weighted(shapes, lights)
    shining = bool(lights) or any(shape.emitter for shape in shapes.values())
    if not shining and world.file is None:
        raise InputError(
            f"effects must let something shine in {world.label}: it has no lamp, so ask for "
            "environment or sun"
        )
    sensor = Node(plugin="perspective")
    media = [medium for effect in added if (medium := effect.medium(world))]
    for effect in added:
        sensor = effect.sensor(world, sensor)
    depth = [(BASE_DEPTH, BASE)]
    depth += [(effect.extra_depth, effect.name) for effect in active if effect.extra_depth]
    if wants.depth is not None:
        depth = [(wants.depth, OPTION)]
    volumetric = [effect.name for effect in active if effect.volumetric]
    integrator = Node(
        plugin="volpath" if volumetric else "path",
        asked_by=volumetric[0] if volumetric else BASE,
        params={"max_depth": sum(bounces for bounces, _ in depth), "rr_depth": ROULETTE},
    )
    return Plan(
        world=world,
        effects=names,
        wants=wants,
        shapes=shapes,
        materials=materials,
        lights=lights,
        light_groups=light_groups,
        medium=media[0] if media else None,
        sensor=sensor,
        integrator=integrator,
        depth=depth,
        dimensions=_dimensions(world, active),
        buffers=_buffers(world, added, wants),
        motions=motions,
        shutter=max((effect.shutter(world) for effect in added), default=0.0),
    )


def _surfaces(
    world: World, effects: list[Effect], motions: dict[str, Motion]
) -> tuple[dict[str, Node], dict[str, Shape]]:
    """Materials, and one mesh for all that is of one material and moves as one."""
    keys: dict[Surface, str] = {}
    members: dict[tuple[str, str], list[Mesh]] = {}
    for piece in world.pieces:
        if piece.surface.special == "pane" and not any(e.keeps(piece) for e in effects):
            continue  # a pane is there for what it shows; opaque it would shut the window
        key = keys.setdefault(piece.surface, f"material{len(keys)}")
        group = piece.group if piece.group in motions else ""
        members.setdefault((key, group), []).append(piece.mesh)
    materials = {key: material(surface, effects) for surface, key in keys.items()}
    shapes = {
        f"shape{index}": Shape(mesh=join(meshes), material=key, group=group)
        for index, ((key, group), meshes) in enumerate(members.items())
    }
    return materials, shapes


def material(surface: Surface, effects: list[Effect]) -> Node:
    """The BSDF of a surface under those effects."""
    if surface.material is not None:
        return surface.material
    reflectance: object = rgb(surface.color)
    for effect in effects:
        reflectance = effect.reflectance(surface, reflectance)
    node = Node(plugin="diffuse", params={"reflectance": reflectance})
    for effect in effects:
        node = effect.bsdf(surface, reflectance, node)
    if surface.two_sided and node.plugin not in ("dielectric", "thindielectric"):
        node = Node(plugin="twosided", params={"bsdf": node})
    return node


def _lamps(
    world: World, effects: list[Effect], motions: dict[str, Motion], shapes: dict[str, Shape]
) -> tuple[dict[str, Node], dict[str, str]]:
    lights: dict[str, Node] = {}
    groups: dict[str, str] = {}
    for index, lamp in enumerate(world.lamps):
        node: Node | None = point_light(lamp)
        for effect in effects:
            node = effect.emitter(lamp, node) if node else None
        if node is None:
            continue
        if lamp.emission is not None and node.plugin == "area":
            node = lamp.emission
        group = lamp.group if lamp.group in motions else ""
        if node.plugin == "area":
            shapes[f"lamp{index}"] = Shape(mesh=lamp.mesh, material="", emitter=node, group=group)
        else:
            lights[f"lamp{index}"] = node
            if group:
                groups[f"lamp{index}"] = group
    return lights, groups


def _weighted(
    shapes: dict[str, Shape], lights: dict[str, Node]
) -> tuple[dict[str, Shape], dict[str, Node]]:
    """The emitters with weights by which samples choose among them: root of the power.

    Light from infinity has no power that says how much of it comes in: a sky weighs as much as all
    lamps together, a sun half of that. Without weights each screen is asked as often as the sun.
    """
    power = {
        name: float(np.mean(_radiance(shape.emitter))) * shape.mesh.area() * np.pi
        for name, shape in shapes.items() if shape.emitter
    }  # fmt: skip
    for name, node in lights.items():
        if node.plugin == "point":
            power[name] = 4 * np.pi * float(np.mean(node.params["intensity"]["value"]))
    roots = {name: max(value, 1e-6) ** 0.5 for name, value in power.items()}
    total = sum(roots.values()) or 1.0
    weights = {name: max(root / total, 0.01) for name, root in roots.items()}
    weights |= {n: 1.0 if node.plugin == "envmap" else 0.5
                for n, node in lights.items() if n not in weights}  # fmt: skip
    return (
        {name: replace(shape, emitter=_with_weight(shape.emitter, weights[name]))
         if shape.emitter else shape for name, shape in shapes.items()},
        {name: _with_weight(node, weights[name]) for name, node in lights.items()},
    )  # fmt: skip


def _with_weight(node: Node, weight: float) -> Node:
    return replace(node, params={**node.params, "sampling_weight": weight})


def _radiance(node: Node) -> np.ndarray:
    value = node.params["radiance"]
    if isinstance(value, Node):
        return np.asarray(value.params.get("bitmap", 0.5))
    return np.asarray(value["value"])


def point_light(lamp: Lamp) -> Node:
    """A point of the lamp's power at its centre.

    A surface of area A and radiance L sends ``pi A L`` out; a point of intensity I ``4 pi I``.
    """
    intensity = np.array(lamp.radiance) * lamp.mesh.area() / 4
    centre = lamp.mesh.vertices.mean(axis=0)
    if not lamp.around:
        # a panel often lies in a wall: its light starts a little before it
        centre = centre + 0.02 * lamp.mesh.normals.mean(axis=0)
    params = {"position": [float(v) for v in centre], "intensity": rgb(tuple(intensity))}
    return Node(plugin="point", params=params)


def _dimensions(world: World, effects: list[Effect]) -> list[Dimension]:
    # what Mitsuba's path and volpath integrators take at each vertex
    base = [
        Dimension(name="pixel position", size=2, asked_by=BASE),
        Dimension(name="light and point on it", size=2, asked_by=BASE, per="bounce"),
        Dimension(name="material lobe and direction", size=3, asked_by=BASE, per="bounce"),
        Dimension(name="Russian roulette", size=1, asked_by=BASE, per="bounce"),
    ]
    return base + [d for effect in effects for d in effect.dimensions(world)]


def _buffers(world: World, effects: list[Effect], wants: Wants) -> list[Buffer]:
    base = {"color": 3, "albedo": 3, "normal": 3, "depth": 1, "motion": 2}
    buffers = [Buffer(name=name, channels=n, asked_by=BASE) for name, n in base.items()]
    buffers += [buffer for effect in effects for buffer in effect.buffers(world)]
    if wants.second_color:
        buffers.append(Buffer(name="color_b", channels=3, asked_by=OPTION))
    buffers += [Buffer(name=name, channels=GUIDES[name], asked_by=OPTION) for name in wants.guides]
    return buffers

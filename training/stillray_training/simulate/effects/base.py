"""What an effect may add to a scene. Each hook adds nothing unless an effect says otherwise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from stillray_training.simulate.node import Node
from stillray_training.simulate.world import Lamp, Motion, Piece, Surface, World


@dataclass(frozen=True, kw_only=True)
class Dimension:
    """Random numbers that one sample takes."""

    name: str
    size: int
    asked_by: str
    per: str = "sample"  # "sample", or "bounce": taken again at every vertex of a path


@dataclass(frozen=True, kw_only=True)
class Buffer:
    """A buffer that is rendered or an array that rendering keeps for one."""

    name: str
    channels: int
    asked_by: str


class Effect:
    """One effect, by its name.

    The plan asks each effect a scene names, in the order of the registry. Surfaces begin as
    ``diffuse`` of one colour, lamps as ``point``, the sensor as ``perspective``, the integrator as
    ``path``.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    extra_depth: ClassVar[int] = 0  # bounces that the effect needs on top of the base depth
    volumetric: ClassVar[bool] = False

    def missing(self, world: World) -> str | None:
        """What the effect needs and the world lacks, or None."""
        return None

    def keeps(self, piece: Piece) -> bool:
        """Whether a piece that only exists for some effect exists for this one."""
        return False

    def reflectance(self, surface: Surface, node: object) -> object:
        """The reflectance of a surface: a colour so far, or a texture node."""
        return node

    def bsdf(self, surface: Surface, reflectance: object, node: Node) -> Node:
        """The material of a surface."""
        return node

    def emitter(self, lamp: Lamp, node: Node) -> Node | None:
        """The light of a lamp; an ``area`` node makes its mesh shine; None: the lamp is off."""
        return node

    def lights(self, world: World) -> dict[str, Node]:
        """Further emitters of the scene."""
        return {}

    def medium(self, world: World) -> Node | None:
        """What fills the scene."""
        return None

    def sensor(self, world: World, node: Node) -> Node:
        """The camera."""
        return node

    def dimensions(self, world: World) -> tuple[Dimension, ...]:
        """Random numbers the effect takes on top of those of the base."""
        return ()

    def buffers(self, world: World) -> tuple[Buffer, ...]:
        """Arrays the effect needs on top of those of the base."""
        return ()

    def motions(self, world: World) -> dict[str, Motion]:
        """What moves, by group."""
        return {}

    def shutter(self, world: World) -> float:
        """Open part of the frame time."""
        return 0.0

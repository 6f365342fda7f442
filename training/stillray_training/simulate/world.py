"""What a scene is, before any effect: pieces, lamps, sky, fog, and the effects it calls for.

A `World` describes everything that effects could show. An effect that is not asked for leaves its
part of the description unread: see `stillray_training.simulate.plan`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stillray_training.simulate.camera import Camera
from stillray_training.simulate.mesh import Mesh
from stillray_training.simulate.node import Node
from stillray_training.simulate.textures import Relief, Texture

Color = tuple[float, float, float]
# The pose of a rigid body: time in frames to a (4, 4) world transform relative to where it stands.
Motion = Callable[[float], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Surface:
    """What a piece is made of. Only ``color`` is read where no effect asks for more."""

    color: Color  # diffuse reflectance, or a metal's specular one, 0 to 1
    texture: Texture | None = None  # read by the effect texture
    roughness: float | None = None  # GGX alpha, 0.02 to 1; read by the effect glossy
    roughness_texture: Texture | None = None  # grey alpha picture in place of the one alpha
    metal: bool = False  # glossy: a conductor
    special: str | None = None  # "mirror", "glass" or "pane"; read by the effect mirror_glass
    two_sided: bool = False  # thin: seen and lit from both sides
    relief: Relief | None = None  # a normal map; read by the effect relief
    material: Node | None = None  # an asset's own material: stands for all the above but color


@dataclass(frozen=True, kw_only=True, eq=False)
class Piece:
    """A mesh of one surface; pieces of one group move together."""

    mesh: Mesh
    surface: Surface
    group: str = ""  # "": part of the building, never moves


@dataclass(frozen=True, kw_only=True, eq=False)
class Lamp:
    """A light with an extent: a point of the same power where no effect asks for the extent."""

    mesh: Mesh  # emits along its normals
    radiance: Color  # W / (m^2 sr), each 0 or more
    picture: Texture | None = None  # what a screen shows: texture and soft_shadow together
    group: str = ""
    window: bool = False  # stands for the sky in a window: dark where a real sky is asked for
    around: bool = False  # closed body that shines all around, not a panel
    emission: Node | None = None  # an asset's own picture of radiances: in place of radiance


@dataclass(frozen=True, kw_only=True)
class Sky:
    """Light from infinity all around."""

    kind: str = "clear"  # of `textures.sky`
    seed: int = 0
    radiance: float = 1.0  # mean, W / (m^2 sr)
    facing: Color | None = None  # indoors: directions away from the windows are left out


@dataclass(frozen=True, kw_only=True)
class Sun:
    """Parallel light."""

    direction: Color  # the way the light travels
    irradiance: Color  # W / m^2 across the beam


@dataclass(frozen=True, kw_only=True)
class Fog:
    """A homogeneous medium that fills the scene."""

    extinction: float = 0.05  # 1 / m, above 0
    albedo: Color = (0.9, 0.9, 0.9)  # scattered part of the extinction, 0 to 1
    asymmetry: float = 0.0  # Henyey-Greenstein g, -1 to 1


@dataclass(frozen=True, kw_only=True)
class Lens:
    """A thin lens."""

    aperture: float = 0.02  # radius as a fraction of the focus distance, above 0
    focus: float = 1.0  # focus distance as a fraction of the distance looked at, above 0


@dataclass(frozen=True, kw_only=True)
class Credit:
    """Who made an asset, and on what terms it may be used."""

    name: str
    title: str
    author: str
    licence: str
    source: str


@dataclass(frozen=True, kw_only=True, eq=False)
class File:
    """A Mitsuba XML file as a part of a world."""

    path: Path
    scene: Any  # as Mitsuba has loaded it
    plugins: dict[str, int]  # how often it uses which plugin
    effects: tuple[str, ...]  # those it shows by itself: they cannot be left out


@dataclass(frozen=True, kw_only=True, eq=False)
class World:
    """A scene: what is there, and which effects it calls for."""

    label: str
    pieces: list[Piece] = field(default_factory=list)
    lamps: list[Lamp] = field(default_factory=list)
    sky: Sky | None = None
    sun: Sun | None = None
    fog: Fog | None = None
    lens: Lens = field(default_factory=Lens)
    shutter: float = 0.5  # open part of the frame time, 0 to 1; read by motion_blur
    moving: dict[str, Motion] = field(default_factory=dict)  # of groups; read by moving_object
    swinging: dict[str, Motion] = field(default_factory=dict)  # of groups; read by moving_light
    space: tuple[np.ndarray, np.ndarray] | None = None  # box that cameras stand in, metres
    gaze: tuple[np.ndarray, np.ndarray] | None = None  # box that cameras look at, metres
    home: Camera | None = None  # cameras are drawn around this one in place of the boxes
    effects: tuple[str, ...] = ()  # what the scene calls for by name
    file: File | None = None  # a Mitsuba XML file that all the above is added to
    credits: tuple[Credit, ...] = ()  # of the assets that stand in it

    def pieces_of(self, group: str) -> list[Piece]:
        """The pieces that move together under that name."""
        return [piece for piece in self.pieces if piece.group == group]

"""What all generators share: a seeded builder with a palette of materials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillray_training.simulate.mesh import Mesh, box, translation
from stillray_training.simulate.textures import Texture
from stillray_training.simulate.world import Color, Lamp, Piece, Surface

_WOODS: tuple[Color, ...] = (
    (0.5, 0.33, 0.18),
    (0.2, 0.11, 0.06),
    (0.62, 0.47, 0.3),
    (0.34, 0.17, 0.08),
    (0.05, 0.04, 0.035),
    (0.75, 0.7, 0.62),
)
_METALS: tuple[Color, ...] = (
    (0.9, 0.9, 0.88),
    (0.95, 0.76, 0.4),
    (0.93, 0.6, 0.45),
    (0.55, 0.55, 0.57),
    (0.25, 0.25, 0.26),
)


@dataclass(frozen=True, kw_only=True)
class Spot:
    """A mobile group and how it may move."""

    group: str
    centre: np.ndarray  # (3,) metres, what it turns about
    kind: str  # "floor" slides, "thing" slides and turns, "hanging" swings about its centre


class Builder:
    """Collects pieces and lamps; all randomness comes from one seed.

    Attributes
    ----------
    rng : numpy.random.Generator
    pieces, lamps : lists
    spots : list of Spot
        What could move.
    """

    def __init__(self, seed: Sequence[int]) -> None:
        self.rng = np.random.default_rng(seed)
        self.pieces: list[Piece] = []
        self.lamps: list[Lamp] = []
        self.spots: list[Spot] = []
        self._taken: list[tuple[float, float, float]] = []
        self._wood = self._grain(_WOODS[self.rng.integers(len(_WOODS))])
        self._second_wood = self._grain(_WOODS[self.rng.integers(len(_WOODS))])
        self._accents = [self.color(vivid=True) for _ in range(3)]
        self._metal = _METALS[self.rng.integers(len(_METALS))]

    # -- draws

    def chance(self, probability: float) -> bool:
        """True with that probability."""
        return bool(self.rng.random() < probability)

    def between(self, low: float, high: float) -> float:
        """A number between two."""
        return float(self.rng.uniform(low, high))

    def pick(self, *options: str, p: Sequence[float] | None = None) -> str:
        """One of the options."""
        return str(self.rng.choice(options, p=p))

    def color(self, *, vivid: bool = False, light: float | None = None) -> Color:
        """A reflectance: mostly muted, seldom saturated unless ``vivid``."""
        base = self.between(0.08, 0.75) if light is None else light
        tint = self.rng.normal(size=3) * (self.between(0.3, 1.0) if vivid else self.between(0, 0.2))
        value = np.clip(base * np.exp(tint - tint.max() * 0.5), 0.02, 0.9)
        return (float(value[0]), float(value[1]), float(value[2]))

    # -- materials

    def texture(self, kind: str, low: Color, high: Color, size: float) -> Texture:
        """A seeded picture."""
        return Texture(kind=kind, seed=int(self.rng.integers(2**31)), low=low, high=high, size=size)

    def plain(self, color: Color | None = None, *, gloss: float = 0.35) -> Surface:
        """Paint, plastic, ceramic: one colour, glossy with that probability."""
        rough = self.between(0.03, 0.35) if self.chance(gloss) else None
        return Surface(color=color or self.color(), roughness=rough)

    def accent(self) -> Surface:
        """One of the scene's few strong colours."""
        return self.plain(self._accents[self.rng.integers(3)], gloss=0.3)

    def wood(self, *, second: bool = False) -> Surface:
        """The scene's wood, or its other one."""
        return self._second_wood if second else self._wood

    def metal(self, rough: float | None = None) -> Surface:
        """The scene's metal, cast, brushed or worn."""
        alpha = self.between(0.05, 0.35) if rough is None else rough
        worn = None
        if self.chance(0.3):
            grey = (alpha * 0.4,) * 3
            worn = self.texture(self.pick("noise", "wood", "tiles"), grey, (alpha * 1.4,) * 3, 0.4)
        return Surface(color=self._metal, roughness=alpha, roughness_texture=worn, metal=True)

    def fabric(self, *, two_sided: bool = False) -> Surface:
        """Cloth: woven, striped, printed or plain."""
        color = self.color(vivid=self.chance(0.4))
        if self.chance(0.65):
            kind = self.pick("weave", "stripes", "noise", "checker", p=[0.5, 0.25, 0.15, 0.1])
            other = self.color(light=min(0.8, 1.7 * max(color)))
            return Surface(
                color=color,
                texture=self.texture(kind, color, other, self.between(0.15, 0.8)),
                two_sided=two_sided,
            )
        return Surface(color=color, two_sided=two_sided)

    def stone(self, *, gloss: float = 0.5) -> Surface:
        """Marble, terrazzo, tiles, plaster."""
        low, high = self.color(light=self.between(0.1, 0.5)), self.color(light=0.75)
        kind = self.pick(
            "marble", "terrazzo", "tiles", "noise", "checker", p=[0.2, 0.2, 0.35, 0.15, 0.1]
        )
        rough = self.between(0.03, 0.25) if self.chance(gloss) else None
        picture = self.texture(kind, low, high, self.between(0.8, 2.5))
        return Surface(color=_middle(low, high), texture=picture, roughness=rough)

    def planks(self) -> Surface:
        """A wooden floor."""
        tone = np.array(_WOODS[self.rng.integers(len(_WOODS))])
        low, high = tuple(tone * 0.5), tuple(np.minimum(tone * 1.3, 0.85))
        rough = self.between(0.05, 0.35) if self.chance(0.7) else None
        picture = self.texture("planks", low, high, self.between(0.8, 1.6))
        return Surface(color=_middle(low, high), texture=picture, roughness=rough)

    def wall(self) -> Surface:
        """Paint, plaster, wallpaper, brick."""
        color = self.color(light=self.between(0.45, 0.85))
        if self.chance(0.2):
            color = self.color(vivid=True, light=self.between(0.2, 0.6))
        if self.chance(0.35):
            kind = self.pick("noise", "stripes", "brick", "weave", p=[0.4, 0.25, 0.25, 0.1])
            other = tuple(np.array(color) * self.between(0.5, 0.85))
            return Surface(
                color=color, texture=self.texture(kind, other, color, self.between(0.8, 2))
            )
        return Surface(color=color)

    def printed(self, size: float, *, kind: str = "painting") -> Surface:
        """A picture, a cover, a page that spans that many metres."""
        picture = self.texture(kind, (0.06, 0.05, 0.05), (0.8, 0.78, 0.72), size)
        return Surface(color=(0.4, 0.38, 0.36), texture=picture)

    def shiny(self) -> Surface:
        """Something that catches the light: metal, mirror, glass, glaze."""
        kind = self.pick("metal", "mirror", "glass", "glaze", p=[0.3, 0.15, 0.3, 0.25])
        if kind == "metal":
            return self.metal()
        if kind == "mirror":
            return Surface(color=self._metal, special="mirror")
        if kind == "glass":
            return self.glass()
        return Surface(color=self.color(vivid=True), roughness=self.between(0.02, 0.12))

    def glass(self) -> Surface:
        """Clear or lightly tinted glass."""
        tint = np.exp(-np.abs(self.rng.normal(size=3)) * self.between(0, 0.25))
        return Surface(color=(float(tint[0]), float(tint[1]), float(tint[2])), special="glass")

    # -- placing

    def add(
        self, mesh: Mesh, surface: Surface, *, at: np.ndarray | None = None, group: str = ""
    ) -> None:
        """Add a piece, moved by a ``(4, 4)`` transform."""
        self.pieces.append(
            Piece(mesh=mesh if at is None else mesh.moved(at), surface=surface, group=group)
        )

    def block(
        self,
        centre: Sequence[float],
        size: Sequence[float],
        surface: Surface,
        *,
        at: np.ndarray | None = None,
        group: str = "",
    ) -> None:
        """Add a box."""
        self.add(box(centre, size), surface, at=at, group=group)

    def shine(
        self, mesh: Mesh, radiance: Color, *, at: np.ndarray | None = None, **rest: object
    ) -> None:
        """Add a lamp, moved by a ``(4, 4)`` transform."""
        self.lamps.append(
            Lamp(mesh=mesh if at is None else mesh.moved(at), radiance=radiance, **rest)  # type: ignore[arg-type]
        )

    def light_color(self, strength: float) -> Color:
        """Warm to cold white, seldom coloured, of that strength."""
        warmth = self.between(-0.3, 0.5)
        value = np.array([1 + 0.6 * warmth, 1.0, 1 - 0.7 * warmth])
        if self.chance(0.12):
            value = np.exp(self.rng.normal(size=3) * 0.8)
        value = strength * value / value.mean()
        return (float(value[0]), float(value[1]), float(value[2]))

    def can_move(self, group: str, at: np.ndarray, kind: str) -> str:
        """Note that a group could move; gives the group back."""
        self.spots.append(Spot(group=group, centre=at[:3, 3].copy(), kind=kind))
        return group

    def stand_in(self, kind: str, at: np.ndarray, size: Sequence[float] | None = None) -> bool:
        """Put something else where a generator would build that kind of thing; False: nothing."""
        return False

    def place(
        self, low: Sequence[float], high: Sequence[float], radius: float
    ) -> tuple[float, float] | None:
        """A free spot on the floor between two corners (x, z), and take it; None: no room."""
        for _ in range(12):
            x, z = self.rng.uniform(low, high)
            if self.free(x, z, radius):
                self.take(x, z, radius)
                return float(x), float(z)
        return None

    def free(self, x: float, z: float, radius: float) -> bool:
        """Whether nothing stands within a radius."""
        return all(np.hypot(x - u, z - v) > radius + r for u, v, r in self._taken)

    def take(self, x: float, z: float, radius: float) -> None:
        """Note that something stands here."""
        self._taken.append((float(x), float(z), radius))

    def _grain(self, tone: Color) -> Surface:
        low, high = tuple(np.array(tone) * 0.55), tuple(np.minimum(np.array(tone) * 1.25, 0.9))
        rough = self.between(0.06, 0.4) if self.chance(0.6) else None
        picture = self.texture("wood", low, high, self.between(0.5, 1.2))
        return Surface(color=tone, texture=picture, roughness=rough)


def _middle(low: Sequence[float], high: Sequence[float]) -> Color:
    value = (np.array(low) + np.array(high)) / 2
    return (float(value[0]), float(value[1]), float(value[2]))


def lift(x: float, y: float, z: float) -> np.ndarray:
    """A translation as a ``(4, 4)`` transform."""
    return translation([x, y, z])

"""A builder with the materials of lived-in rooms, and objects of an asset folder among them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stillray_training.simulate.assets import Asset, Library
from stillray_training.simulate.effects import check_names
from stillray_training.simulate.generators.build import Builder, lift
from stillray_training.simulate.mesh import Mesh, rotation
from stillray_training.simulate.textures import Relief, Texture
from stillray_training.simulate.world import Color, Credit, Lamp, Piece, Surface, World

# Reflectances of wood as photographs of rooms have them: light oak, oak, walnut, teak, stained.
_WOODS: tuple[Color, ...] = (
    (0.52, 0.39, 0.25), (0.4, 0.26, 0.15), (0.17, 0.1, 0.062), (0.33, 0.19, 0.095),
    (0.09, 0.062, 0.045), (0.62, 0.54, 0.43), (0.28, 0.2, 0.14), (0.68, 0.65, 0.6),
)  # fmt: skip
_METALS: tuple[Color, ...] = (
    (0.72, 0.72, 0.71), (0.55, 0.55, 0.56), (0.3, 0.29, 0.28), (0.72, 0.58, 0.35),
)  # fmt: skip
_PIXELS = 512  # of the pictures on large surfaces
_BRIGHTEST = 40.0  # radiance of a lamp: bulbs in rooms are frosted or behind something

# Assets that stand where a generator would build something of that kind.
_STAND_INS = {
    "chair": ("chair", "monobloc_chair", "painted_stool", "chair"),
    "armchair": ("modern_armchair",),
    "sofa": ("sofa_03",),
    "table": ("wooden_table_02",),
    "shelf": ("bookshelf_worn", "painted_cabinet_02"),
    "cabinet": ("painted_cabinet", "painted_cabinet_02"),
    "plant": ("tall_plant", "fern"),
}
_STRETCH = 1.8  # of one side of an asset against another, at most
_ODDS = 0.55  # that an asset stands in, where there is one
_NOT_SMALL = ("conveyor_belt",)  # clutter of halls, not of tables
_DEEP = ("sofa", "armchair", "chair", "shelf", "cabinet")  # their back at z = 0: others are centred


class Home(Builder):
    """Off-whites, woods, greys, few strong colours; relief; objects from a library.

    Attributes
    ----------
    library : Library or None
    credits : dict
        Of the assets that were placed, by name.
    """

    def __init__(self, seed: Sequence[int], library: Library | None) -> None:
        super().__init__(seed)
        self.library = library
        self.credits: dict[str, Credit] = {}
        self._wood = self._board(_WOODS[self.rng.integers(len(_WOODS))])
        self._second_wood = self._board(_WOODS[self.rng.integers(len(_WOODS))])
        self._metal = _METALS[self.rng.integers(len(_METALS))]

    # -- colours

    def color(self, *, vivid: bool = False, light: float | None = None) -> Color:
        """Greys and off-whites, warm rather than cold; ``vivid`` ones are dyed, not neon."""
        base = self.between(0.06, 0.7) if light is None else light
        spread = self.between(0.1, 0.45) if vivid and self.chance(0.6) else self.between(0, 0.06)
        warm = self.between(-0.02, 0.07) * np.array([1.0, 0.2, -1.2])
        value = base * np.exp(self.rng.normal(size=3) * spread + warm)
        return _color(np.clip(value * base / value.mean(), 0.03, 0.85))

    def off_white(self) -> Color:
        """Wall paint, ceilings, window frames."""
        return self.color(light=self.between(0.62, 0.82))

    # -- materials

    def relief(self, picture: Texture, depth: float, bevel: float = 1.2) -> Relief:
        """A relief of a picture's pattern."""
        return Relief(picture=picture, depth=depth, bevel=bevel)

    def sharp(self, kind: str, low: Color, high: Color, size: float) -> Texture:
        """A picture with the pixels that a wall or a floor needs."""
        return replace(self.texture(kind, low, high, size), pixels=_PIXELS)

    def plain(self, color: Color | None = None, *, gloss: float = 0.35) -> Surface:
        rough = self.between(0.09, 0.4) if self.chance(gloss) else None
        return Surface(color=color or self.color(), roughness=rough)

    def metal(self, rough: float | None = None) -> Surface:
        # smooth metal in a room throws caustics that nobody sees for the noise they are
        return Surface(
            color=self._metal, roughness=max(rough or 0, self.between(0.14, 0.4)), metal=True
        )

    def fabric(self, *, two_sided: bool = False) -> Surface:
        color = self.color(vivid=self.chance(0.5))
        kind = self.pick(
            "weave",
            "plaid",
            "stripes",
            "damask",
            "noise",
            "quilt",
            p=[0.4, 0.14, 0.12, 0.12, 0.12, 0.1],
        )
        other = self.color(light=float(np.clip(np.mean(color) * self.between(0.5, 1.9), 0.04, 0.8)))
        picture = self.texture(kind, color, other, self.between(0.12, 0.6))
        weave = picture if kind in ("weave", "quilt") else self.texture("weave", color, color, 0.15)
        depth = 0.006 if kind == "quilt" else self.between(0.0005, 0.0015)
        return Surface(
            color=color, texture=picture, two_sided=two_sided, relief=self.relief(weave, depth)
        )

    def carpet(self) -> Surface:
        """A floor of pile."""
        color = self.color(light=self.between(0.1, 0.5), vivid=self.chance(0.3))
        picture = self.sharp(
            "carpet", _shade(color, 0.6), _shade(color, 1.3), self.between(0.5, 1.0)
        )
        return Surface(color=color, texture=picture, relief=self.relief(picture, 0.003))

    def stone(self, *, gloss: float = 0.5) -> Surface:
        kind = self.pick("tiles", "marble", "terrazzo", "noise", p=[0.5, 0.2, 0.15, 0.15])
        high = self.color(light=self.between(0.25, 0.75))
        low = _shade(high, self.between(0.35, 0.7) if kind == "tiles" else self.between(0.5, 0.85))
        picture = self.sharp(kind, low, high, self.between(0.8, 2.2))
        rough = self.between(0.08, 0.3) if self.chance(gloss) else None
        relief = self.relief(picture, self.between(0.001, 0.003)) if kind == "tiles" else None
        return Surface(color=high, texture=picture, roughness=rough, relief=relief)

    def planks(self) -> Surface:
        tone = _WOODS[self.rng.integers(len(_WOODS))]
        kind = self.pick("planks", "parquet", p=[0.7, 0.3])
        picture = self.sharp(kind, _shade(tone, 0.45), _shade(tone, 1.35), self.between(0.9, 1.8))
        rough = self.between(0.09, 0.32) if self.chance(0.85) else None
        relief = self.relief(picture, self.between(0.001, 0.004))
        return Surface(color=tone, texture=picture, roughness=rough, relief=relief)

    def wall(self) -> Surface:
        color = self.off_white()
        if self.chance(0.25):
            color = self.color(vivid=True, light=self.between(0.15, 0.6))
        kind = self.pick(
            "plain",
            "plaster",
            "paper",
            "brick",
            "ribs",
            "tiles",
            p=[0.3, 0.3, 0.16, 0.12, 0.07, 0.05],
        )
        if kind == "plain":
            return Surface(color=color)
        if kind == "plaster":
            bumps = self.sharp("plaster", color, color, self.between(0.6, 1.5))
            return Surface(color=color, relief=self.relief(bumps, self.between(0.002, 0.008)))
        if kind == "paper":
            style = self.pick("damask", "stripes", "weave", "plaid")
            picture = self.sharp(
                style, _shade(color, self.between(0.7, 0.9)), color, self.between(0.4, 1.4)
            )
            return Surface(color=color, texture=picture, relief=self.relief(picture, 0.001))
        if kind == "brick":
            if self.chance(0.5):
                color = (0.34, 0.17, 0.11)
            picture = self.sharp("brick", _shade(color, 0.7), color, self.between(0.8, 1.4))
            return Surface(color=color, texture=picture, relief=self.relief(picture, 0.008))
        depth = 0.01 if kind == "ribs" else 0.003
        picture = self.sharp(kind, _shade(color, 0.8), color, self.between(0.6, 1.4))
        return Surface(color=color, texture=picture, roughness=self.between(0.15, 0.4),
                       relief=self.relief(picture, depth))  # fmt: skip

    def carved(self, kind: str, size: float, depth: float, color: Color | None = None) -> Surface:
        """Painted or stained wood with a relief: panels, mouldings, ribs, louvres, quilts."""
        ground = (
            self.plain(color or self.off_white(), gloss=0.6) if self.chance(0.65) else self.wood()
        )
        shape = self.sharp(kind, ground.color, ground.color, size)
        return replace(ground, relief=self.relief(shape, depth))

    def shiny(self) -> Surface:
        kind = self.pick("metal", "glass", "glaze", p=[0.35, 0.12, 0.53])
        if kind == "metal":
            return self.metal()
        if kind == "glass":
            return self.glass()
        return Surface(color=self.color(vivid=True), roughness=self.between(0.08, 0.2))

    def printed(self, size: float, *, kind: str = "painting") -> Surface:
        if kind == "painting":
            kind = self.pick("scenery", "print", "painting", p=[0.6, 0.25, 0.15])
        return super().printed(size, kind=kind)

    def light_color(self, strength: float) -> Color:
        warmth = self.between(-0.15, 0.35)
        value = np.array([1 + 0.5 * warmth, 1.0, 1 - 0.7 * warmth])
        return _color(strength * value / value.mean())

    # -- placing

    def shine(
        self, mesh: Mesh, radiance: Color, *, at: np.ndarray | None = None, **rest: object
    ) -> None:
        most = _BRIGHTEST / max(*radiance, _BRIGHTEST)
        super().shine(mesh, _color(np.array(radiance) * most), at=at, **rest)

    def stand_in(self, kind: str, at: np.ndarray, size: Sequence[float] | None = None) -> bool:
        if self.library is None:
            return False
        names = _STAND_INS.get(kind, ())
        if kind == "thing":
            names = (*self.library.kind("clutter"), *self.library.kind("figure"), "fern", "moss")
        names = tuple(name for name in names if name in self.library and name not in _NOT_SMALL)
        if not names or not self.chance(_ODDS):
            return False
        asset = self.library.get(str(self.rng.choice(names)))
        scale = np.ones(3)
        if size is not None:
            scale = _fit(kind, asset.size, np.asarray(size, float))
        if scale.max() > _STRETCH * scale.min():
            return False
        out = asset.size[2] * scale[2] / 2 if kind in _DEEP else 0.0
        turn = self.between(0, 360) if kind in ("thing", "plant") else 0.0
        move = "thing" if kind == "thing" else "floor"
        self.place_asset(asset, at @ lift(0, 0, out) @ rotation([0, 1, 0], turn), scale, move)
        return True

    def place_asset(
        self, asset: Asset, at: np.ndarray, scale: np.ndarray, move: str = "floor"
    ) -> str:
        """Place an asset; the group it moves in, named by ``move`` ("" for what never moves)."""
        group = self.can_move(f"{asset.name}{len(self.spots)}", at, move) if move else ""
        matrix = at @ np.diag([*scale, 1.0])
        self.credits[asset.name] = asset.credit
        for part in asset.parts:
            mesh = part.mesh.moved(matrix)
            if part.emission is None:
                self.pieces.append(Piece(mesh=mesh, surface=part.surface, group=group))
            else:
                self.lamps.append(
                    Lamp(mesh=mesh, radiance=(1.0, 1.0, 1.0), emission=part.emission, group=group)
                )
        return group

    def _board(self, tone: Color) -> Surface:
        picture = self.texture(
            "wood", _shade(tone, 0.6), _shade(tone, 1.25), self.between(0.5, 1.2)
        )
        rough = self.between(0.12, 0.4) if self.chance(0.7) else None
        picture = replace(picture, pixels=_PIXELS)
        return Surface(color=tone, texture=picture, roughness=rough,
                       relief=self.relief(picture, self.between(0.0003, 0.001)))  # fmt: skip


def of_home(b: Home, world: World, *, without: tuple[str, ...]) -> World:
    """A finished world with its credits, lamps that shine from their surface, no such effects."""
    names = {name for name in world.effects if name not in without}
    names |= {"soft_shadow"} if world.lamps else set()
    return replace(world, effects=check_names(names), credits=tuple(b.credits.values()))


def _fit(kind: str, own: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Factors ``(3,)`` that bring an asset to a size: exactly, or small things at most to it."""
    if kind == "thing":
        return np.full(3, min(1.0, 1.3 * size[0] / max(own[0], own[2])))
    if kind == "plant":
        return np.full(3, min(1.0, size[1] / own[1], 1.0 / max(own[0], own[2])))
    return np.asarray(size / own)


def _shade(color: Color, factor: float) -> Color:
    return _color(np.clip(np.array(color) * factor, 0.02, 0.85))


def _color(value: np.ndarray) -> Color:
    return (float(value[0]), float(value[1]), float(value[2]))

"""A procedural, seeded, furnished room: training and demo data that needs no files.

Only the first of the generators to come. What it wants to teach: surfaces lit indirectly through
a window or by small lamps, textures with fine detail, thin and round things, gloss, glass, mirrors.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

Dict = dict[str, Any]


class Room:
    """A seeded room as a Mitsuba scene dictionary.

    Parameters
    ----------
    mi
        The Mitsuba module with its variant set.
    seed
        Everything in the room follows from it.

    Attributes
    ----------
    scene : dict
        The Mitsuba scene dictionary, without a sensor.
    size : ndarray
        Extent of the room along x, y (up), z in metres; it stands on y = 0 around x = z = 0.
    """

    def __init__(self, mi: Any, seed: int) -> None:
        self._mi = mi
        self._rng = np.random.default_rng(seed)
        self._t = mi.ScalarTransform4f
        self.size = self._rng.uniform([4.0, 2.4, 4.0], [8.0, 3.6, 9.0])
        self.scene: Dict = {"type": "scene"}
        self._add_walls()
        self._add_lights()
        for index in range(self._rng.integers(4, 12)):
            self._add_furniture(f"piece{index}")
        self._add_shelf("shelf")
        self._add_pictures()

    def _uniform(self, low: Any, high: Any) -> Any:
        value = self._rng.uniform(low, high)
        return float(value) if np.ndim(value) == 0 else value  # Mitsuba takes no NumPy scalars

    def _chance(self, probability: float) -> bool:
        return bool(self._rng.random() < probability)

    def _color(self, saturation: float | None = None) -> list[float]:
        base = self._uniform(0.05, 0.9)
        tint = self._rng.normal(size=3) * (
            self._uniform(0, 0.4) if saturation is None else saturation
        )
        return np.clip(base * np.exp(tint), 0.02, 0.95).tolist()

    def _texture(self) -> Dict:
        pattern = procedural_texture(self._rng)
        low, high = np.array(self._color()), np.array(self._color())
        image = (low + (high - low) * pattern[..., None]).astype(np.float32)
        scale = float(self._rng.choice([1, 1, 2, 4]))
        return {
            "type": "bitmap",
            "bitmap": self._mi.Bitmap(image),
            "raw": True,
            "to_uv": self._t().scale([scale, scale, 1]),
        }

    def _reflectance(self, textured: float) -> Dict:
        if self._chance(textured):
            return self._texture()
        return {"type": "rgb", "value": self._color()}

    def _material(self, *, textured: float = 0.5, special: float = 0.25) -> Dict:
        if self._chance(special):
            kind = self._rng.choice(["metal", "mirror", "glass", "brushed"])
            if kind == "metal":
                return {
                    "type": "roughconductor",
                    "alpha": float(self._uniform(0.05, 0.4)),
                    "specular_reflectance": {"type": "rgb", "value": self._color()},
                }
            if kind == "mirror":
                return {"type": "conductor"}
            if kind == "glass":
                return {"type": "dielectric"}
            return {"type": "roughconductor", "alpha_u": 0.05, "alpha_v": 0.3}
        reflectance = self._reflectance(textured)
        if self._chance(0.4):
            return {
                "type": "roughplastic",
                "alpha": float(self._uniform(0.03, 0.4)),
                "diffuse_reflectance": reflectance,
            }
        return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}

    def _plane(self, name: str, to_world: Any, bsdf: Dict) -> None:
        self.scene[name] = {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}

    def _add_walls(self) -> None:
        x, y, z = self.size / 2
        T, wall = self._t, self._material(textured=0.3, special=0)
        floor = self._material(textured=0.8, special=0.05)
        self._plane("floor", T().rotate([1, 0, 0], -90).scale([x, z, 1]), floor)
        ceiling: Dict = {
            "type": "twosided",
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8] * 3}},
        }
        self._plane(
            "ceiling",
            T().translate([0, 2 * y, 0]).rotate([1, 0, 0], 90).scale([x, z, 1]),
            ceiling,
        )
        self._plane("left", T().translate([-x, y, 0]).rotate([0, 1, 0], 90).scale([z, y, 1]), wall)
        second = wall if self._chance(0.6) else self._material(textured=0.4, special=0)
        self._plane("back", T().translate([0, y, -z]).scale([x, y, 1]), second)
        self._plane("front", T().translate([0, y, z]).rotate([0, 1, 0], 180).scale([x, y, 1]), wall)
        # the right wall has an opening: four strips around a window
        self._window_low = self._uniform(0.3, 0.9)
        self._window_high = self._uniform(1.6, 2 * y - 0.2)
        self._window_half = self._uniform(0.4, 0.45 * z)
        centre = self._uniform(-0.4 * z, 0.4 * z)
        self._window_z = centre
        strips = {
            "below": (0, self._window_low, -z, z),
            "above": (self._window_high, 2 * y, -z, z),
            "before": (
                self._window_low,
                self._window_high,
                -z,
                max(-z, centre - self._window_half),
            ),
            "after": (self._window_low, self._window_high, min(z, centre + self._window_half), z),
        }
        for name, (low, high, near, far) in strips.items():
            if far - near > 1e-3:
                at = [x, (low + high) / 2, (near + far) / 2]
                self._plane(
                    f"right_{name}",
                    T()
                    .translate(at)
                    .rotate([0, 1, 0], -90)
                    .scale([(far - near) / 2, (high - low) / 2, 1]),
                    wall,
                )
        for bar in range(self._rng.integers(0, 4)):
            along = centre + self._window_half * self._uniform(-0.9, 0.9)
            self.scene[f"bar{bar}"] = {
                "type": "cube",
                "to_world": T()
                .translate([x, (self._window_low + self._window_high) / 2, along])
                .scale([0.03, (self._window_high - self._window_low) / 2, 0.025]),
                "bsdf": wall,
            }

    def _add_lights(self) -> None:
        x, y, z = self.size / 2
        style = self._rng.choice(["window", "lamps", "both", "ceiling"], p=[0.35, 0.2, 0.3, 0.15])
        tint = np.exp(self._rng.normal(size=3) * 0.15)
        if style in ("window", "both"):
            power = self._uniform(5, 40)
            height = self._window_high - self._window_low
            self.scene["sky"] = {
                "type": "rectangle",
                "to_world": self._t()
                .translate([x + 0.3, (self._window_low + self._window_high) / 2, self._window_z])
                .rotate([0, 1, 0], -90)
                .scale([self._window_half + 0.3, height / 2 + 0.3, 1]),
                "emitter": {
                    "type": "area",
                    "radiance": {"type": "rgb", "value": (tint * power).tolist()},
                },
            }
        else:
            self.scene["outside"] = {
                "type": "constant",
                "radiance": {"type": "rgb", "value": float(self._uniform(0.05, 1.5))},
            }
        if style in ("lamps", "both"):
            for lamp in range(self._rng.integers(1, 5)):
                radius = self._uniform(0.03, 0.15)
                at = self._uniform([-0.8 * x, 0.5, -0.8 * z], [0.8 * x, 2 * y - 0.3, 0.8 * z])
                self._emitter_sphere(f"lamp{lamp}", at, radius, 1.5 / radius**2)
        if style == "ceiling":
            for panel in range(self._rng.integers(1, 5)):
                half = self._uniform(0.1, 0.6)
                at = self._uniform([-0.7 * x, 0, -0.7 * z], [0.7 * x, 0, 0.7 * z])
                at[1] = 2 * y - 0.01
                self.scene[f"panel{panel}"] = {
                    "type": "rectangle",
                    "to_world": self._t().translate(at).rotate([1, 0, 0], 90).scale(half),
                    "emitter": {
                        "type": "area",
                        "radiance": {
                            "type": "rgb",
                            "value": (tint * self._uniform(1, 6) / half**2).tolist(),
                        },
                    },
                }

    def _emitter_sphere(self, name: str, at: np.ndarray, radius: float, power: float) -> None:
        color = np.exp(self._rng.normal(size=3) * 0.25) * power * self._uniform(0.2, 1.5)
        self.scene[name] = {
            "type": "sphere",
            "center": at.tolist(),
            "radius": float(radius),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": color.tolist()}},
        }

    def _add_furniture(self, name: str) -> None:
        x, _, z = self.size / 2
        width, height, depth = map(float, self._uniform([0.2, 0.2, 0.2], [1.2, 1.1, 1.0]))
        at = self._uniform([-x + 0.6, 0, -z + 0.6], [x - 0.6, 0, z - 0.6])
        turn = self._t().translate(at.tolist()).rotate([0, 1, 0], float(self._uniform(0, 360)))
        kind = self._rng.choice(["box", "table", "chair", "ball", "column"])
        material = self._material()
        if kind == "box":
            self._cube(name, turn, [0, height / 2, 0], [width / 2, height / 2, depth / 2], material)
        elif kind in ("table", "chair"):
            # a slab on four legs; a chair has a back
            self._cube(name, turn, [0, height, 0], [width / 2, 0.03, depth / 2], material)
            for side in (-1, 1):
                for end in (-1, 1):
                    leg = [side * (width / 2 - 0.03), height / 2, end * (depth / 2 - 0.03)]
                    self._cube(
                        f"{name}_leg{side + end * 3 + 4}",
                        turn,
                        leg,
                        [0.02, height / 2, 0.02],
                        material,
                    )
            if kind == "chair":
                self._cube(
                    f"{name}_back",
                    turn,
                    [0, 1.5 * height, -depth / 2 + 0.02],
                    [width / 2, height / 2, 0.02],
                    material,
                )
            for thing in range(self._rng.integers(0, 4)):
                radius = self._uniform(0.04, 0.14)
                spot = self._uniform([-width / 2, 0, -depth / 2], [width / 2, 0, depth / 2]) * 0.8
                spot[1] = height + 0.03 + radius
                self.scene[f"{name}_thing{thing}"] = {
                    "type": "sphere",
                    "to_world": turn.translate(spot.tolist()).scale(float(radius)),
                    "bsdf": self._material(special=0.4),
                }
        elif kind == "ball":
            self.scene[name] = {
                "type": "sphere",
                "to_world": turn.translate([0, width / 2, 0]).scale(width / 2),
                "bsdf": self._material(special=0.4),
            }
        else:
            self.scene[name] = {
                "type": "cylinder",
                "p0": [0, 0, 0],
                "p1": [0, 2.0 * height, 0],
                "radius": width / 4,
                "to_world": turn,
                "bsdf": material,
            }

    def _cube(self, name: str, turn: Any, at: list[float], half: list[float], bsdf: Dict) -> None:
        self.scene[name] = {
            "type": "cube",
            "to_world": turn.translate(at).scale(half),
            "bsdf": bsdf,
        }

    def _add_shelf(self, name: str) -> None:
        """Boards with books on the back wall: many thin upright edges."""
        x, _, z = self.size / 2
        width = self._uniform(0.8, 2.0)
        left = self._uniform(-x + 0.1, x - width - 0.1)
        board = self._material(special=0)
        still = self._t()
        for level in range(self._rng.integers(1, 5)):
            height = 0.4 + 0.4 * level
            at = [left + width / 2, height, -z + 0.15]
            self._cube(f"{name}{level}", still, at, [width / 2, 0.015, 0.15], board)
            cursor = left + 0.05
            while cursor < left + width - 0.1 and self._chance(0.93):
                thick, tall = self._uniform(0.015, 0.06), self._uniform(0.15, 0.33)
                self._cube(
                    f"{name}{level}_book{int(1000 * cursor) + 100000}",
                    still,
                    [cursor + thick, height + 0.015 + tall / 2, -z + 0.12],
                    [thick / 2, tall / 2, 0.1],
                    self._material(textured=0.15, special=0),
                )
                cursor += thick * self._uniform(1.05, 2.0)

    def _add_pictures(self) -> None:
        x, y, z = self.size / 2
        for index in range(self._rng.integers(0, 4)):
            half = self._uniform([0.15, 0.15], [0.6, 0.5])
            at = [-x + 0.02, self._uniform(1.0, 2 * y - 0.5), self._uniform(-z + 0.5, z - 0.5)]
            place = self._t().translate(at).rotate([0, 1, 0], 90)
            bsdf: Dict = (
                {"type": "conductor"}
                if self._chance(0.2)
                else {"type": "diffuse", "reflectance": self._texture()}
            )
            self._plane(f"picture{index}", place.scale([half[0], half[1], 1]), bsdf)
            rim = self._t().translate([-x + 0.01, at[1], at[2]]).rotate([0, 1, 0], 90)
            self.scene[f"frame{index}"] = {
                "type": "cube",
                "to_world": rim.scale([half[0] + 0.04, half[1] + 0.04, 0.009]),
                "bsdf": self._material(textured=0.2),
            }


def procedural_texture(rng: np.random.Generator, size: int = 512) -> np.ndarray:
    """A seeded ``(size, size)`` pattern in [0, 1]: checker, planks, marble, noise or print."""
    row, column = np.mgrid[0:size, 0:size] / size
    kind = rng.choice(["checker", "planks", "marble", "noise", "print", "tiles"])
    soft = _noise(rng, size, int(rng.choice([4, 8, 16])))
    fine = _noise(rng, size, 64)
    if kind == "checker":
        count = int(rng.integers(4, 24))
        pattern = ((row * count).astype(int) + (column * count).astype(int)) % 2 + 0.2 * fine
    elif kind == "planks":
        count = int(rng.integers(4, 12))
        shade = rng.random(count)[(row * count).astype(int)]
        grain = _noise(rng, size, 128)
        grain = cv2.blur(grain.astype(np.float32), (65, 1))
        seam = (row * count) % 1 < 0.04
        pattern = np.where(seam, 0, 0.5 * shade + 0.5 * grain)
    elif kind == "marble":
        pattern = 0.5 + 0.5 * np.sin(20 * (column + 0.4 * soft + 0.1 * fine))
    elif kind == "noise":
        pattern = 0.6 * soft + 0.4 * fine
    elif kind == "tiles":
        count = int(rng.integers(3, 16))
        joint = ((row * count) % 1 < 0.06) | ((column * count) % 1 < 0.06)
        shade = rng.random((count, count))[(row * count).astype(int), (column * count).astype(int)]
        pattern = np.where(joint, 0, 0.6 + 0.3 * shade + 0.1 * fine)
    else:  # lines of dark marks on light ground, as print has
        lines = int(rng.integers(12, 32))
        marks = rng.random((lines, 48)) < 0.6
        inside = (row * lines) % 1 < 0.6
        pattern = 1.0 - inside * marks[(row * lines).astype(int), (column * 48).astype(int)]
    low, high = float(pattern.min()), float(pattern.max())
    return (pattern - low) / max(high - low, 1e-6)


def _noise(rng: np.random.Generator, size: int, cells: int) -> np.ndarray:
    return np.clip(
        cv2.resize(
            rng.random((cells, cells)).astype(np.float32),
            (size, size),
            interpolation=cv2.INTER_CUBIC,
        ),
        0,
        1,
    )

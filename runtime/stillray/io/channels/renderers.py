"""The table of renderers, ``renderers.toml``, as rules: one a layer, in the order of the table."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any

from stillray.io.channels.motion_convention import MotionConvention

ROLES = (
    "color", "albedo", "normal", "depth", "motion", "samples", "roughness", "specular_albedo",
    "color_b",
)  # fmt: skip

_RENDERER_KEYS = {"name", "prefixed", "source", *ROLES}
_LAYER_KEYS = {
    *("layer", "parts", "any_prefix", "writes", "note"),
    *("signs", "unit", "stored", "proven"),
}


@dataclass(frozen=True, kw_only=True)
class Rule:
    """One layer of one renderer.

    Attributes
    ----------
    renderer, role, layer
        Whose, what for, and its name without components; ``""``: the components are channels.
    parts
        The components that may make it up, alternatives in order.
    prefixed
        Whether a view layer's name may come before it.
    any_prefix
        Whether that name is a buffer's and not a view layer's.
    writes
        The layer that takes the denoised picture instead of this one; may be empty.
    note
        What a user should know; may be empty.
    convention, proven
        For motion: what its vectors mean, and whether that is certain.
    """

    renderer: str
    role: str
    layer: str
    parts: tuple[tuple[str, ...], ...]
    prefixed: bool = False
    any_prefix: bool = False
    writes: str = ""
    note: str = ""
    convention: MotionConvention | None = None
    proven: bool = True


@dataclass(frozen=True)
class RendererTable:
    """All rules, in order; by role the components of layers and of files of one buffer.

    ``lights`` and ``never`` are patterns of names of layers that are light, and of those that are
    not for all that; ``colors`` are names of lights without the colour of surfaces, to those of the
    layers of that colour.
    """

    rules: tuple[Rule, ...]
    components: dict[str, tuple[tuple[str, ...], ...]]
    alone: dict[str, tuple[tuple[str, ...], ...]]
    lights: tuple[str, ...]
    never: tuple[str, ...]
    colors: Mapping[str, str]


@lru_cache(maxsize=1)
def renderer_table() -> RendererTable:
    """The table as it is packaged."""
    text = (resources.files("stillray.io.channels") / "renderers.toml").read_text(encoding="utf-8")
    return parse_table(text)


def parse_table(text: str) -> RendererTable:
    """Read a table of renderers.

    Raises
    ------
    ValueError
        The table is not TOML, or has a key that is not described at its head.
    """
    data = tomllib.loads(text)
    components = {role: _alternatives(data["components"][role]) for role in ROLES}
    alone = {role: _alternatives(lists) for role, lists in data["alone"].items()}
    rules: list[Rule] = []
    for renderer in data["renderer"]:
        _require_known(renderer, _RENDERER_KEYS)
        for role in ROLES:
            rules += [_rule(renderer, role, entry, components) for entry in renderer.get(role, ())]
    lights = data["lights"]
    return RendererTable(
        tuple(rules),
        components,
        alone,
        lights=tuple(lights["layers"]),
        never=tuple(lights["never"]),
        colors=lights["colors"],
    )


def _rule(renderer: dict[str, Any], role: str, entry: Any, components: dict[str, Any]) -> Rule:
    entry = {"layer": entry} if isinstance(entry, str) else entry
    _require_known(entry, _LAYER_KEYS)
    convention = None
    if role == "motion":
        x, y = entry["signs"]
        convention = MotionConvention(
            signs=(float(x), float(y)),
            unit=entry.get("unit", "pixels"),
            stored=entry.get("stored", "now"),
        )
    return Rule(
        renderer=renderer["name"],
        role=role,
        layer=entry["layer"],
        parts=(tuple(entry["parts"]),) if "parts" in entry else components[role],
        prefixed=renderer.get("prefixed", False) or entry.get("any_prefix", False),
        any_prefix=entry.get("any_prefix", False),
        writes=entry.get("writes", ""),
        note=entry.get("note", ""),
        convention=convention,
        proven=role != "motion" or entry.get("proven", False),
    )


def _alternatives(lists: list[list[str]]) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(parts) for parts in lists)


def _require_known(entry: dict[str, Any], known: set[str]) -> None:
    unknown = set(entry) - known
    if unknown:
        raise ValueError(f"unknown keys in the table of renderers: {', '.join(sorted(unknown))}")

"""Which channels of a renderer's file are color, albedo, normal, depth, motion and samples.

What renderers call them stands in ``renderers.toml``. Motion whose sign and unit are not certain is
found and reported, but not used until two frames have proven what it means
(`stillray.io.channels.motion_detection`), since history warped the wrong way is worse than none.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

import cv2
import numpy as np

from stillray.errors import InputError
from stillray.io.channels.motion_convention import MotionConvention
from stillray.io.channels.renderers import ROLES, Rule, renderer_table

__all__ = [
    "JITTER",
    "ROLES",
    "LayerMatch",
    "color_of_light",
    "find_alone",
    "find_layers",
    "find_light",
    "find_lights",
    "gather",
    "parse_overrides",
]

#: Said by an attribute of files, not by a layer; named beside layers, it can only be left out.
JITTER = "jitter"
_UNPROVEN = "sign and units of this motion are not verified: not used unless two frames prove them"
_SHORTEST_LOOSE_NAME = 3  # letters: shorter names, N and Z, must match exactly
_COUNTS = {
    "color": 3, "albedo": 3, "normal": 3, "depth": 1, "motion": 2, "samples": 1,
    "roughness": 1, "specular_albedo": 3, "color_b": 3,
}  # fmt: skip


@dataclass(frozen=True)
class LayerMatch:
    """Channels that were found to hold one buffer.

    Attributes
    ----------
    role
        One of `ROLES`.
    channels
        Channel names in the order of the buffer's axes.
    renderer
        Whose naming matched; ``"chosen"`` where a user named the layer.
    used
        Whether the buffer is used; ``note`` says why where it is not.
    note
        What a user should know about the match; may be empty.
    convention
        For motion: what its vectors mean, or are thought to mean while ``used`` is false.
    writes
        For color: the channels that take the denoised picture.
    """

    role: str
    channels: tuple[str, ...]
    renderer: str
    used: bool = True
    note: str = ""
    convention: MotionConvention | None = None
    writes: tuple[str, ...] = ()

    @property
    def signs(self) -> tuple[float, ...]:
        """What each channel is multiplied by to follow `Frame`'s convention, before its unit."""
        if self.convention is None:
            return (1.0,) * len(self.channels)
        signs = self.convention.signs
        return signs[::-1] if self.convention.swapped else signs

    def proven(self, convention: MotionConvention) -> LayerMatch:
        """This match of motion, used by a convention that was proven."""
        note = f"proven by warping: {convention}"
        return replace(self, used=True, convention=convention, note=note)


@dataclass(frozen=True)
class _Found:
    prefix: str  # the view layer's name and a dot, or ""
    rule: Rule
    layer: str
    parts: tuple[str, ...]
    exact: bool
    order: int

    @property
    def channels(self) -> tuple[str, ...]:
        return _channels_of(self.layer, self.parts)


def find_layers(
    channel_names: Iterable[str], chosen: Mapping[str, str] | None = None
) -> list[LayerMatch]:
    """Find the buffers among the channels of a file.

    Parameters
    ----------
    channel_names
        As `read_channels` names them.
    chosen
        Role to the layer that a user names for it, see `parse_overrides`.

    Returns
    -------
    list of LayerMatch
        At most one a role, in the order of ``ROLES``. Where a file holds several view layers,
        all buffers come from the one that holds most of them.

    Raises
    ------
    InputError
        A chosen layer is not in the file, or has not the components of its role.
    """
    names = list(dict.fromkeys(channel_names))
    chosen = chosen or {}
    layers = _layers_of(names)
    found: dict[str, list[_Found]] = {role: [] for role in ROLES}
    for order, rule in enumerate(renderer_table().rules):
        found[rule.role] += _all_of_rule(rule, order, layers)
    view_layer = _fullest_layer(found)
    matches = []
    for role in ROLES:
        if role in chosen:
            matches += _chosen_match(role, chosen[role], names)
            continue
        usable = [f for f in found[role] if f.prefix in (view_layer, "") or f.rule.any_prefix]
        if usable:
            best = min(usable, key=lambda f: (f.prefix != view_layer, not f.exact, f.order))
            others = {f.prefix for f in found[role] if f.prefix and f.prefix != best.prefix}
            matches.append(_match(best, others if role == "color" else set(), layers))
        elif role == "color":
            matches += _only_layer_with_alpha(names)
    return matches


def find_lights(
    channel_names: Iterable[str], chosen: Mapping[str, str] | None = None
) -> dict[str, tuple[str, ...]]:
    """Find layers of light beside the color: diffuse, specular, groups of lights.

    Parameters
    ----------
    channel_names, chosen
        As for `find_layers`.

    Returns
    -------
    dict of str to tuple of str
        Name of the layer to its channels, in the order of the file; those of the color's view
        layer, where it has one.
    """
    names = list(dict.fromkeys(channel_names))
    table = renderer_table()
    matches = find_layers(names, chosen)
    taken = {name for match in matches for name in (*match.channels, *match.writes)}
    color = [match for match in matches if match.role == "color"]
    view_layer = _split_prefix(color[0].channels[0].rpartition(".")[0])[0] if color else ""
    lights, never = (
        [_words(pattern) for pattern in patterns] for patterns in (table.lights, table.never)
    )
    found: dict[str, tuple[str, ...]] = {}
    for layer, parts in _layers_of(names).items():
        prefix, plain = _split_prefix(layer)
        words = _words(plain)
        if prefix != view_layer or not any(fnmatchcase(words, pattern) for pattern in lights):
            continue
        if any(fnmatchcase(words, pattern) for pattern in never):
            continue
        for alternative in table.components["color"]:
            if parts.issuperset(alternative):
                channels = _channels_of(layer, alternative)
                if not taken.intersection(channels):
                    found[layer] = channels
                break
    return found


def find_light(name: str, channel_names: Iterable[str]) -> tuple[str, ...]:
    """Channels of the layer that a user names for light; it need not be known to be light.

    Parameters
    ----------
    name
        Of the layer; without its view layer, where no other layer is called so.
    channel_names
        As for `find_layers`.

    Raises
    ------
    InputError
        No layer of three colours is called so, or several are: the message lists them.
    """
    names = list(dict.fromkeys(channel_names))
    found = _layers_named("color", name, names)
    if len(found) == 1:
        return next(iter(found.values()))
    if found:
        raise InputError(f"aovs must name one layer each, got {name}: of {', '.join(found)}")
    colors = [
        layer for layer in _layers_of(names) if layer and _layers_named("color", layer, names)
    ]
    raise InputError(
        f"aovs must name layers of three colours, got {name}; the file has "
        f"{', '.join(colors) or 'none'}"
    )


def color_of_light(light: str) -> str | None:
    """The layer of the colour that a layer of light is without; None if it is with its colour."""
    prefix, name = _split_prefix(light)
    color = renderer_table().colors.get(name)
    return None if color is None else prefix + color


def find_alone(
    role: str, channel_names: Iterable[str], chosen: Mapping[str, str] | None = None
) -> LayerMatch | None:
    """Find one buffer in a file that may hold nothing else, as plain R, G, B or X, Y, Z.

    Motion in such a file is taken in `Frame`'s own convention. A file of a second color is another
    rendering of the frame: its color is taken, whatever its renderer calls it.
    """
    names = list(channel_names)
    chosen = {role: chosen[role]} if chosen and role in chosen else {}
    matches = find_layers(names, chosen)
    if role == "color_b" and not any(match.role == role for match in matches):
        matches = [replace(m, role=role, writes=()) for m in matches if m.role == "color"]
    for match in matches:
        if match.role == role and match.used:
            return match
    convention = MotionConvention() if role == "motion" else None
    for parts in renderer_table().alone[role]:
        if set(parts) <= set(names):
            return LayerMatch(role, parts, "plain", convention=convention)
    if role == "depth" and len(names) == 1:
        return LayerMatch(role, (names[0],), "plain")
    return None


def parse_overrides(texts: Iterable[str]) -> dict[str, str]:
    """Layers that a user names, from texts as ``albedo=diffuse_filter``.

    After the sign of equality stands a layer's name, which may leave out its view layer where no
    other layer is called so; or channels with commas between them, as ``depth=Z`` and
    ``motion=vel.R,-vel.G``: a minus turns an axis of motion, and motion that is named by channels
    is taken in pixels and in `Frame`'s convention. ``none`` leaves the role out; ``jitter=none``
    an attribute, see `stillray.io.exr.jitter`.

    Raises
    ------
    InputError
        A text has no sign of equality or an unknown role, or a role comes twice; or it names a
        layer for jitter.
    """
    chosen: dict[str, str] = {}
    for text in texts:
        role, equals, name = text.partition("=")
        if role == JITTER and name != "none":
            raise InputError(f"layer jitter must be none, since no layer holds it, got {text}")
        if not equals or role not in (*ROLES, JITTER) or not name:
            raise InputError(
                f"layer must be ROLE=NAME with a role of {', '.join(ROLES)}, got {text}"
            )
        if role in chosen:
            raise InputError(f"layer must name {role} once, got {chosen[role]} and {name}")
        chosen[role] = name
    return chosen


def gather(match: LayerMatch, channels: Mapping[str, np.ndarray]) -> np.ndarray:
    """The buffer that a match describes: ``(h, w)`` for one channel, else ``(h, w, channels)``.

    Motion that is stored where surfaces were wants the channels of the previous frame's file.
    """
    planes = [channels[name] for name in match.channels]
    if _COUNTS[match.role] == 1:
        return planes[0]
    # a fifth of what np.stack takes
    stacked = cv2.merge([np.ascontiguousarray(plane) for plane in planes])
    stacked = stacked.reshape(*planes[0].shape, len(planes))  # also where there is one
    return stacked if match.convention is None else match.convention.motion(stacked)


def _layers_of(names: list[str]) -> dict[str, set[str]]:
    """Layer name to its components; each channel is also a layer with the component ``""``."""
    layers: dict[str, set[str]] = {}
    for name in names:
        layer, _, part = name.rpartition(".")
        layers.setdefault(layer, set()).add(part)
        layers.setdefault(name, set()).add("")
    return layers


def _all_of_rule(rule: Rule, order: int, layers: Mapping[str, set[str]]) -> list[_Found]:
    found = []
    wanted = _loose(rule.layer)
    for layer, parts in layers.items():
        prefix, name = _split_prefix(layer)
        if prefix and not rule.prefixed:
            continue
        exact = name == rule.layer
        if not exact and (len(wanted) < _SHORTEST_LOOSE_NAME or _loose(name) != wanted):
            continue
        for alternative in rule.parts:
            if parts.issuperset(alternative):
                found.append(_Found(prefix, rule, layer, alternative, exact, order))
                break
    return found


def _split_prefix(layer: str) -> tuple[str, str]:
    before, dot, name = layer.rpartition(".")
    return before + dot, name


def _loose(name: str) -> str:
    return re.sub(r"[\s_-]", "", name).lower()


def _words(name: str) -> str:
    return re.sub(r"[\s-]", "_", name).lower()


def _channels_of(layer: str, parts: Iterable[str]) -> tuple[str, ...]:
    return tuple(f"{layer}.{part}" if layer and part else layer or part for part in parts)


def _fullest_layer(found: Mapping[str, list[_Found]]) -> str:
    roles: dict[str, set[str]] = {}
    for role, entries in found.items():
        for entry in entries:
            if not entry.rule.any_prefix:
                roles.setdefault(entry.prefix, set()).add(role)
    shared = roles.get("", set())  # buffers outside of any layer go with every layer

    def fullness(prefix: str) -> tuple[bool, int, int]:
        own = roles[prefix]
        return "color" in own | shared, len(own | shared), len(own)

    # max keeps the table's order among equals
    return max(roles, key=fullness, default="")


def _match(found: _Found, others: set[str], layers: Mapping[str, set[str]]) -> LayerMatch:
    rule = found.rule
    notes = [rule.note] if rule.note else []
    if others:
        names = ", ".join(sorted(prefix.rstrip(".") for prefix in others))
        notes = [f"other layers are not used: {names}"]
    writes = found.channels
    if rule.writes and layers.get(found.prefix + rule.writes, set()).issuperset(found.parts):
        writes = _channels_of(found.prefix + rule.writes, found.parts)
        notes.append(f"the result replaces {rule.writes}")
    if not rule.proven:
        notes.append(_UNPROVEN)
    return LayerMatch(
        role=rule.role,
        channels=found.channels,
        renderer=rule.renderer,
        used=rule.proven,
        note="; ".join(notes),
        convention=rule.convention,
        writes=writes if rule.role == "color" else (),
    )


def _chosen_match(role: str, name: str, names: list[str]) -> list[LayerMatch]:
    if name == "none":
        return []
    listed = [part.strip() for part in name.split(",")]
    plain = [part.removeprefix("-") for part in listed]
    if set(plain) <= set(names) and len(plain) == _COUNTS[role]:
        signs = [-1.0 if part not in names else 1.0 for part in listed]
        if role != "motion" and min(signs) < 0:
            raise InputError(f"layer {role} must be named without a minus, got {name}")
        convention = MotionConvention((signs[0], signs[1])) if role == "motion" else None
        return [_as_chosen(role, tuple(plain), convention)]
    found = _layers_named(role, name, names)
    if len(found) > 1:
        raise InputError(f"layer {role}={name}: must name one layer, of {', '.join(found)}")
    for layer, channels in found.items():
        convention = _convention_of(layer) if role == "motion" else None
        match = _as_chosen(role, channels, convention)
        if role == "motion" and not _is_proven(layer):
            match = replace(match, used=False, note=_UNPROVEN)
        return [match]
    raise InputError(
        f"layer {role}={name}: must name a layer of the file or {_COUNTS[role]} of its channels, "
        f"which are {', '.join(names)}"
    )


def _layers_named(role: str, name: str, names: list[str]) -> dict[str, tuple[str, ...]]:
    """Layers that a user may mean and that can hold a role, and their channels.

    The one of that very name, else all that are called so after the name of a view layer: but for
    the shortest, which are those of components, as Z is.
    """
    layers = _layers_of(names)
    called = [name] if name in layers else []
    if not called and len(name) >= _SHORTEST_LOOSE_NAME:
        called = [layer for layer in layers if layer.endswith(f".{name}")]
    found = {}
    for layer in called:
        for alternative in renderer_table().components[role]:
            if layers[layer].issuperset(alternative):
                found[layer] = _channels_of(layer, alternative)
                break
    return found


def _as_chosen(
    role: str, channels: tuple[str, ...], convention: MotionConvention | None
) -> LayerMatch:
    writes = channels if role == "color" else ()
    return LayerMatch(role, channels, "chosen", convention=convention, writes=writes)


def _motion_rule(layer: str) -> Rule | None:
    name = _loose(_split_prefix(layer)[1])
    rules = [r for r in renderer_table().rules if r.role == "motion" and _loose(r.layer) == name]
    return rules[0] if rules else None


def _convention_of(layer: str) -> MotionConvention:
    rule = _motion_rule(layer)
    return rule.convention if rule and rule.convention else MotionConvention()


def _is_proven(layer: str) -> bool:
    rule = _motion_rule(layer)
    return rule is not None and rule.proven


def _only_layer_with_alpha(names: list[str]) -> list[LayerMatch]:
    # Mitsuba names the beauty after the user's nested integrator; only it carries alpha.
    components = ("R", "G", "B")
    layers = [name[:-2] for name in names if name.endswith(".A")]
    layers = [layer for layer in layers if all(f"{layer}.{c}" in names for c in components)]
    if len(layers) != 1:
        return []
    channels = _channels_of(layers[0], components)
    note = "the only layer with red, green, blue and alpha"
    return [LayerMatch("color", channels, "Mitsuba", note=note, writes=channels)]

"""Which channels of a renderer's file are color, albedo, normal, depth and motion.

The table below is all there is to know: one row a layer, the most certain names first. A row is
added only when the meaning of its channels is known; motion whose sign is not verified is found
and reported, but not used, since history warped the wrong way is worse than none.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

ROLES = ("color", "albedo", "normal", "depth", "motion")

_UNVERIFIED = "sign and units of this renderer's motion are not verified: not used"


@dataclass(frozen=True)
class LayerMatch:
    """Channels that were found to hold one buffer.

    Attributes
    ----------
    role
        ``"color"``, ``"albedo"``, ``"normal"``, ``"depth"`` or ``"motion"``.
    channels
        Channel names in the order of the buffer's axes.
    signs
        What each channel is multiplied by to follow `Frame`'s convention: 1 or -1.
    renderer
        Whose naming matched.
    used
        Whether the buffer is used; ``note`` says why where it is not.
    note
        What a user should know about the match; may be empty.
    """

    role: str
    channels: tuple[str, ...]
    signs: tuple[float, ...]
    renderer: str
    used: bool = True
    note: str = ""


@dataclass(frozen=True)
class _Rule:
    renderer: str
    role: str
    layer: str  # "": the parts are whole channel names
    parts: tuple[str, ...]
    signs: tuple[float, ...] = ()  # empty: all 1
    prefixed: bool = False  # a view layer's name and a dot may come before
    used: bool = True
    note: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"{self.layer}.{part}" if self.layer else part for part in self.parts)


_RGB, _XYZ, _XY = ("R", "G", "B"), ("X", "Y", "Z"), ("X", "Y")
_rgb, _xyz, _xy = ("r", "g", "b"), ("x", "y", "z"), ("x", "y")
_Z = ("Z",)

_RULES = (
    # Cycles' image before its own denoiser comes before the one that may already be denoised.
    _Rule("Blender", "color", "Noisy Image", _RGB, prefixed=True),
    _Rule("Blender", "color", "Combined", _RGB, prefixed=True),
    _Rule("plain", "color", "", _RGB),
    _Rule("Arnold", "color", "RGBA", _RGB),
    _Rule("RenderMan", "color", "Ci", _rgb),
    _Rule("LuxCore", "color", "RGB_IMAGEPIPELINE", _RGB, prefixed=True),
    _Rule("stillray", "albedo", "albedo", _RGB),
    _Rule("Blender", "albedo", "Denoising Albedo", _RGB, prefixed=True),
    _Rule("Arnold", "albedo", "denoise_albedo", _RGB),
    _Rule("Arnold", "albedo", "diffuse_albedo", _RGB),
    _Rule("RenderMan", "albedo", "albedo", _rgb),
    _Rule("pbrt", "albedo", "Albedo", _RGB),
    _Rule("LuxCore", "albedo", "ALBEDO", _RGB, prefixed=True),
    _Rule("stillray", "normal", "normal", _XYZ),
    _Rule("Blender", "normal", "Denoising Normal", _XYZ, prefixed=True),
    _Rule("Blender", "normal", "Normal", _XYZ, prefixed=True),
    _Rule("RenderMan", "normal", "normal", _xyz),
    _Rule("RenderMan", "normal", "normal", _rgb),
    _Rule("pbrt", "normal", "Ns", _XYZ),
    _Rule("pbrt", "normal", "", ("Nsx", "Nsy", "Nsz")),
    _Rule("Arnold", "normal", "N", _XYZ),
    _Rule("Mitsuba", "normal", "sh_normal", _XYZ),
    _Rule("Mitsuba", "normal", "nn", _XYZ),
    _Rule("LuxCore", "normal", "AVG_SHADING_NORMAL", _XYZ, prefixed=True),
    _Rule("stillray", "depth", "depth", _Z),
    _Rule("Blender", "depth", "Denoising Depth", _Z, prefixed=True),
    _Rule("Blender", "depth", "Depth", _Z, prefixed=True),
    _Rule("RenderMan", "depth", "", ("zfiltered",)),
    _Rule("Arnold", "depth", "", _Z),
    _Rule("LuxCore", "depth", "DEPTH", _Z, prefixed=True),
    # The one Mitsuba variable of that type; the layer's name is the user's.
    _Rule("Mitsuba", "depth", "", ("T",), prefixed=True, note="distance along the ray"),
    _Rule("stillray", "motion", "motion", _XY),
    _Rule(
        "Blender", "motion", "Vector", _XY, signs=(1.0, -1.0), prefixed=True,
        note="previous minus current position with y up: y is negated",
    ),
    _Rule("Arnold", "motion", "motionvector", _XY, used=False, note=_UNVERIFIED),
    _Rule("Arnold", "motion", "motionvector", ("R", "G"), used=False, note=_UNVERIFIED),
    _Rule("RenderMan", "motion", "backward", _xy, used=False, note=_UNVERIFIED),
    _Rule("RenderMan", "motion", "motionBack", _xy, used=False, note=_UNVERIFIED),
)  # fmt: skip

# What a file that holds nothing but one buffer may call its channels.
_ALONE = {
    "albedo": (_RGB,),
    "normal": (_XYZ, _RGB),
    "depth": (_Z, ("Y",), ("R",)),
    "motion": (_XY, ("R", "G")),
}


def find_layers(channel_names: Iterable[str]) -> list[LayerMatch]:
    """Find the buffers among the channels of a file.

    Parameters
    ----------
    channel_names
        As `read_channels` names them.

    Returns
    -------
    list of LayerMatch
        At most one a role, in the order of ``ROLES``. Where a file holds several view layers,
        all buffers come from the one that holds most of them.
    """
    names = list(dict.fromkeys(channel_names))
    found: dict[str, list[tuple[str, _Rule]]] = {role: [] for role in ROLES}
    for rule in _RULES:
        for prefix in _prefixes(rule, names):
            found[rule.role].append((prefix, rule))
    layer = _fullest_layer(found)
    matches = []
    for role in ROLES:
        usable = [(p, r) for p, r in found[role] if p in (layer, "") or r.renderer == "Mitsuba"]
        if usable:
            # min keeps the table's order among equals
            prefix, rule = min(usable, key=lambda entry: entry[0] != layer)
            others = {p for p, _ in found[role] if p and p != prefix and role == "color"}
            matches.append(_match(prefix, rule, others))
        elif role == "color":
            matches += _only_layer_with_alpha(names)
    return matches


def find_alone(role: str, channel_names: Iterable[str]) -> LayerMatch | None:
    """Find one buffer in a file that may hold nothing else, as plain R, G, B or X, Y, Z.

    Motion in such a file is taken in `Frame`'s own convention.
    """
    names = list(channel_names)
    for match in find_layers(names):
        if match.role == role and match.used:
            return match
    for parts in _ALONE[role]:
        if set(parts) <= set(names):
            return LayerMatch(role, parts, (1.0,) * len(parts), "plain")
    if role == "depth" and len(names) == 1:
        return LayerMatch(role, (names[0],), (1.0,), "plain")
    return None


def gather(match: LayerMatch, channels: Mapping[str, np.ndarray]) -> np.ndarray:
    """The buffer that a match describes: ``(h, w)`` for depth, else ``(h, w, channels)``."""
    planes = [
        plane if sign == 1 else plane * np.float32(sign)
        for plane, sign in zip((channels[n] for n in match.channels), match.signs, strict=True)
    ]
    return planes[0] if match.role == "depth" else np.stack(planes, axis=-1)


def _prefixes(rule: _Rule, names: list[str]) -> list[str]:
    first = rule.names[0]
    prefixes = [""] if first in names else []
    if rule.prefixed:
        prefixes += [name[: -len(first)] for name in names if name.endswith("." + first)]
    return [p for p in prefixes if all(p + name in names for name in rule.names)]


def _fullest_layer(found: Mapping[str, list[tuple[str, _Rule]]]) -> str:
    roles: dict[str, set[str]] = {}
    for role, entries in found.items():
        for prefix, rule in entries:
            if rule.renderer != "Mitsuba":  # its prefixes are names of buffers, not of layers
                roles.setdefault(prefix, set()).add(role)
    shared = roles.get("", set())  # buffers outside of any layer go with every layer

    def fullness(prefix: str) -> tuple[bool, int, int]:
        own = roles[prefix]
        return "color" in own | shared, len(own | shared), len(own)

    # max keeps the file's order among equals
    return max(roles, key=fullness, default="")


def _match(prefix: str, rule: _Rule, others: set[str]) -> LayerMatch:
    note = rule.note
    if others:
        note = "other layers are not used: " + ", ".join(sorted(p.rstrip(".") for p in others))
    return LayerMatch(
        role=rule.role,
        channels=tuple(prefix + name for name in rule.names),
        signs=rule.signs or (1.0,) * len(rule.names),
        renderer=rule.renderer,
        used=rule.used,
        note=note,
    )


def _only_layer_with_alpha(names: list[str]) -> list[LayerMatch]:
    # Mitsuba names the beauty after the user's nested integrator; only it carries alpha.
    layers = [name[:-2] for name in names if name.endswith(".A")]
    layers = [layer for layer in layers if all(f"{layer}.{c}" in names for c in _RGB)]
    if len(layers) != 1:
        return []
    channels = tuple(f"{layers[0]}.{c}" for c in _RGB)
    note = "the only layer with red, green, blue and alpha"
    return [LayerMatch("color", channels, (1.0, 1.0, 1.0), "Mitsuba", note=note)]

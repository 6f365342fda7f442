"""How many samples a pixel a file says that it has, in a channel or among its attributes."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from stillray.frame import MOST_SAMPLES
from stillray.io.channels.roles import LayerMatch
from stillray.io.exr.container import Attribute
from stillray.io.exr.file import ExrFile

#: The attribute by which any program can tell: text or a number.
OWN_ATTRIBUTE = "stillray:samples"
#: What Cycles writes of each view layer.
CYCLES_SAMPLES = re.compile(r"cycles\.(.+)\.samples")
_MAXIMUM = "the maximum, where adaptive sampling was on: --samples N says it better"
_NUMBERS = {"int": "<i", "float": "<f", "double": "<d"}


@dataclass(frozen=True)
class SampleSource:
    """What a file says of its samples.

    Attributes
    ----------
    name
        The channel or attribute that says it; empty if none does, or none that can be used.
    number
        Samples a pixel; None where a channel tells, or nothing.
    note
        What a user should know; may be empty.
    """

    name: str = ""
    number: float | None = None
    note: str = ""


def find_samples(
    file: ExrFile, matches: Iterable[LayerMatch], chosen: Mapping[str, str] | None = None
) -> SampleSource:
    """Where a file says how many samples a pixel its color has.

    A channel comes first, then the attribute ``stillray:samples``, then what Cycles writes of the
    view layer that the color comes from.

    Parameters
    ----------
    file
        The file.
    matches
        Its buffers, as `stillray.io.channels.roles.find_layers` gives them.
    chosen
        What a user said of layers; ``none`` for the samples leaves attributes out too.
    """
    found = {match.role: match for match in matches}
    if "samples" in found:
        return SampleSource(found["samples"].channels[0])
    if (chosen or {}).get("samples") == "none":
        return SampleSource(note="left out, as you said")
    own = found["color"].channels[0] if "color" in found else ""
    attributes = attributes_of(file, own)
    if OWN_ATTRIBUTE in attributes:
        return _of_attribute(attributes[OWN_ATTRIBUTE])
    layers = {hit[1]: name for name in attributes if (hit := CYCLES_SAMPLES.fullmatch(name))}
    named = [name for layer, name in layers.items() if own.startswith(f"{layer}.")]
    # of View and View.001 the longer is meant; a composite belongs to no view layer, but to all
    names = [max(named, key=len)] if named else sorted(layers.values())
    said = [_of_attribute(attributes[name], note=_MAXIMUM) for name in names]
    if not said:
        return SampleSource()
    if len({source.number for source in said}) > 1:
        return SampleSource(note=f"{' and '.join(names)} differ: --samples N decides")
    return said[0]


def attributes_of(file: ExrFile, color: str) -> dict[str, Attribute]:
    """Attributes by name, those of the part that holds a channel before others; of any if empty."""
    first = file.container.parts[file.channels[color][0]] if color else file.container.parts[0]
    found: dict[str, Attribute] = {}
    for part in (first, *file.container.parts):
        for attribute in part.attributes:
            found.setdefault(attribute.name, attribute)
    return found


def _of_attribute(attribute: Attribute, note: str = "") -> SampleSource:
    number = number_of(attribute)
    if number is None or not 0 < number <= MOST_SAMPLES:
        text = attribute.value[:32].decode("utf-8", "replace")
        value = text if number is None else f"{number:g}"
        return SampleSource(note=f"{attribute.name} must be a number above 0, got {value}")
    return SampleSource(attribute.name, number, note)


def number_of(attribute: Attribute) -> float | None:
    """The value of an attribute of text or a number; None of any other."""
    try:
        if attribute.kind == "string":
            return float(attribute.value.decode())
        if attribute.kind in _NUMBERS:
            return float(struct.unpack(_NUMBERS[attribute.kind], attribute.value)[0])
    except (ValueError, struct.error):
        pass
    return None

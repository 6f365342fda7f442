"""What pixel filter a file's renderer had, as its attributes say."""

from __future__ import annotations

from dataclasses import dataclass

from stillray.errors import InputError
from stillray.io.exr.container import Attribute
from stillray.io.exr.file import ExrFile
from stillray.io.exr.samples import CYCLES_SAMPLES, attributes_of, number_of
from stillray.pixel_filter import filter_spread, parse_filter

#: The attribute by which any program can tell: text as `parse_filter` takes it.
FILTER_ATTRIBUTE = "stillray:pixelFilter"
_CYCLES_NOTE = "what Blender has unless told otherwise: --pixel-filter says it better"


@dataclass(frozen=True)
class FilterSource:
    """What a file says of its pixel filter.

    Attributes
    ----------
    name
        The attribute that says it; empty if none does, or none that can be used.
    spread
        Standard deviation in pixels; None where nothing is said.
    note
        What a user should know; may be empty.
    """

    name: str = ""
    spread: float | None = None
    note: str = ""


def find_filter(file: ExrFile, color: str = "") -> FilterSource:
    """Which pixel filter a file says that its color has.

    The attribute ``stillray:pixelFilter`` comes first. Cycles writes nothing of its filter: a file
    with attributes of Cycles is taken to have Blender's usual one.

    Parameters
    ----------
    file
        The file.
    color
        A channel of the color, whose part is looked at before others.
    """
    attributes = attributes_of(file, color)
    if own := attributes.get(FILTER_ATTRIBUTE):
        return _of_attribute(own)
    for name in attributes:
        if CYCLES_SAMPLES.fullmatch(name):
            return FilterSource(name, filter_spread("blackman-harris"), _CYCLES_NOTE)
    return FilterSource()


def _of_attribute(attribute: Attribute) -> FilterSource:
    number = number_of(attribute)
    text = attribute.value[:64].decode("utf-8", "replace") if number is None else f"{number:g}"
    try:
        return FilterSource(attribute.name, parse_filter(text))
    except InputError as error:
        return FilterSource(note=f"{attribute.name}: {error}")

"""What pixel filter a file's renderer had, as its attributes say."""

from __future__ import annotations

from dataclasses import dataclass

from stillray.errors import InputError
from stillray.io.exr.file import ExrFile
from stillray.io.exr.samples import CYCLES_SAMPLES
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
        The attribute that says it; empty if none does.
    spread
        Standard deviation in pixels; None where nothing is said.
    note
        What a user should know; may be empty.
    """

    name: str = ""
    spread: float | None = None
    note: str = ""


def find_filter(file: ExrFile) -> FilterSource:
    """Which pixel filter a file says that it has.

    The attribute ``stillray:pixelFilter`` comes first. Cycles writes nothing of its filter: a file
    with attributes of Cycles is taken to have Blender's usual one.

    Raises
    ------
    InputError
        The attribute holds no filter.
    """
    attributes = {a.name: a for part in file.container.parts for a in part.attributes}
    if own := attributes.get(FILTER_ATTRIBUTE):
        try:
            return FilterSource(own.name, parse_filter(own.value.decode("utf-8", "replace")))
        except InputError as error:
            raise InputError(f"{file.path}: {FILTER_ATTRIBUTE}: {error}") from None
    for name in attributes:
        if CYCLES_SAMPLES.fullmatch(name):
            return FilterSource(name, filter_spread("blackman-harris"), _CYCLES_NOTE)
    return FilterSource()

"""The container of an OpenEXR file: its headers and where its chunks lie, without any pixels.

OpenImageIO reads and writes the pixels. Here stands only what it cannot do: to check a file before
a byte of pixels is allocated, and to say which bytes hold which chunk, so that what is not
denoised can be copied without being decoded. The layout is that of "OpenEXR File Layout",
Academy Software Foundation, openexr.com.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from itertools import pairwise, zip_longest
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stillray.errors import InputError

#: Pixels of a part; more is refused before anything is allocated.
MOST_PIXELS = 2**28
#: Bytes of all headers, parts of a file, and channels of a part; more is refused.
MOST_HEADER_BYTES, MOST_PARTS, MOST_CHANNELS = 2**26, 4096, 4096

MAGIC, VERSION = 20000630, 2
_TILED, _LONG_NAMES, _DEEP, _MULTI_PART = 0x200, 0x400, 0x800, 0x1000
_MIP_MAP, _RIP_MAP = 1, 2  # how smaller copies of a picture are made
# Number in the file: name, rows in a chunk of scan lines
_COMPRESSIONS = {
    0: ("none", 1), 1: ("rle", 1), 2: ("zips", 1), 3: ("zip", 16), 4: ("piz", 32),
    5: ("pxr24", 16), 6: ("b44", 32), 7: ("b44a", 32), 8: ("dwaa", 32), 9: ("dwab", 256),
    10: ("htj2k256", 256), 11: ("htj2k32", 32),
}  # fmt: skip
_NUMBERS = {name: number for number, (name, _) in _COMPRESSIONS.items()}
_TYPES = {0: ("uint", 4), 1: ("half", 2), 2: ("float", 4)}
# What a byte of a file can stand for at most, in bytes: deflate's format bounds it (258 bytes in
# two bits); for those that are not named here no tight bound is known.
_DENSEST = {"none": 1, "rle": 64, "zips": 1032, "zip": 1032, "pxr24": 1376, "b44": 8, "b44a": 16}
_DENSEST_OTHER = 2**16


class Attribute(NamedTuple):
    """A header's attribute: its name, its type, and its value's bytes."""

    name: str
    kind: str
    value: bytes


class Channel(NamedTuple):
    """A channel as the header lists it; ``kind`` is ``"uint"``, ``"half"`` or ``"float"``."""

    name: str
    kind: str
    sampling: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Chunk:
    """Where a chunk's bytes lie in the file, without the number of its part."""

    part: int
    index: int
    start: int
    stop: int


class Window(NamedTuple):
    """A window in pixels: its top left corner and its size."""

    x: int
    y: int
    width: int
    height: int


@dataclass(frozen=True)
class Part:
    """The header of one part.

    Attributes
    ----------
    attributes
        In the file's order.
    channels
        In the file's order, which is that of their names.
    data, display
        Data window and display window.
    compression
        Its name.
    tile
        Width and height of a tile; None where the part is stored in scan lines.
    levels
        Whether smaller copies of the picture are stored too: mip maps or rip maps.
    deep
        Whether a pixel holds many samples.
    """

    attributes: tuple[Attribute, ...]
    channels: tuple[Channel, ...]
    data: Window
    display: Window
    compression: str
    tile: tuple[int, int] | None
    levels: bool
    deep: bool

    @property
    def name(self) -> str:
        """The part's name; empty in most files of one part."""
        return self.text("name")

    def text(self, name: str) -> str:
        """A string attribute; empty where there is none."""
        values = [a.value for a in self.attributes if a.name == name and a.kind == "string"]
        return values[0].decode("utf-8", "replace") if values else ""

    @property
    def chunk_rows(self) -> int:
        """Rows of a chunk of scan lines."""
        return dict(_COMPRESSIONS.values())[self.compression]

    @property
    def chunk_count(self) -> int | None:
        """Chunks by the size of the picture; None where its levels are of an unknown kind."""
        if self.tile is None:
            return -(-self.data.height // self.chunk_rows)
        if not self.levels:
            return self._tiles(self.data.width, self.data.height)
        mode = next(a.value[8] for a in self.attributes if a.name == "tiles")
        widths, heights = (
            _level_sizes(size, round_up=bool(mode >> 4))
            for size in (self.data.width, self.data.height)
        )
        if mode & 0xF == _RIP_MAP:
            return sum(self._tiles(w, h) for w in widths for h in heights)
        if mode & 0xF == _MIP_MAP:
            # the shorter side stays at one pixel
            return sum(self._tiles(w, h) for w, h in zip_longest(widths, heights, fillvalue=1))
        return None

    def _tiles(self, width: int, height: int) -> int:
        assert self.tile is not None
        return -(-width // self.tile[0]) * -(-height // self.tile[1])


@dataclass(frozen=True)
class Container:
    """An EXR file's headers and chunks.

    Attributes
    ----------
    flags
        The file's version word.
    parts
        Headers in order.
    chunks
        All chunks in the order of the file.
    """

    flags: int
    parts: tuple[Part, ...]
    chunks: tuple[Chunk, ...]

    @property
    def multi_part(self) -> bool:
        """Whether the file is written with parts, of which there may yet be only one."""
        return bool(self.flags & _MULTI_PART)


def read_container(path: Path, *, headers_only: bool = False) -> Container:
    """Read headers and the table of chunks, and check that every chunk lies in the file.

    With ``headers_only`` the chunks are neither looked for nor listed.

    Raises
    ------
    InputError
        The file is not EXR, is truncated, or claims what cannot be true.
    """
    with path.open("rb") as file:
        data = np.memmap(file, np.uint8, "r") if path.stat().st_size else np.zeros(0, np.uint8)
        try:
            return _Parser(data.data).container(headers_only)
        except (struct.error, IndexError, OverflowError):
            raise InputError(f"{path}: not a readable EXR file: it is truncated") from None
        except _BrokenError as error:
            raise InputError(f"{path}: not a readable EXR file: {error}") from None


def header_bytes(attributes: tuple[Attribute, ...]) -> bytes:
    """A header as the file holds it."""
    written = bytearray()
    for name, kind, value in attributes:
        written += name.encode() + b"\0" + kind.encode() + b"\0"
        written += struct.pack("<i", len(value)) + value
    return bytes(written) + b"\0"


def compression_attribute(name: str) -> Attribute:
    """The attribute that names a compression."""
    return Attribute("compression", "compression", bytes([_NUMBERS[name]]))


def string_attribute(name: str, text: str) -> Attribute:
    """An attribute that holds a text."""
    return Attribute(name, "string", text.encode())


def _level_sizes(size: int, *, round_up: bool) -> list[int]:
    """Pixels of one side, level by level down to one."""
    sizes = [size]
    while sizes[-1] > 1:
        sizes.append((sizes[-1] + round_up) // 2)
    return sizes


class _BrokenError(Exception):
    """What is wrong with the file, in a few words."""


class _Parser:
    def __init__(self, data: memoryview) -> None:
        self.data, self.at = data, 0

    def container(self, headers_only: bool) -> Container:
        if len(self.data) < 8 or self.unpack("<i")[0] != MAGIC:
            raise _BrokenError("it does not begin as one")
        (flags,) = self.unpack("<I")
        if flags & 0xFF != VERSION:
            raise _BrokenError(f"its version is {flags & 0xFF}, not {VERSION}")
        parts = [self.part(flags)]
        if flags & _MULTI_PART:
            while self.data[self.at] != 0:
                parts.append(self.part(flags))
                if len(parts) > MOST_PARTS:
                    raise _BrokenError(f"more than {MOST_PARTS} parts")
            self.at += 1
        if headers_only:
            return Container(flags, tuple(parts), ())
        counts = [self.count_chunks(part) for part in parts]
        if self.at + 8 * sum(counts) > len(self.data):
            raise _BrokenError("its table of chunks is truncated")
        chunks = []
        for number, (part, count) in enumerate(zip(parts, counts, strict=True)):
            table = np.frombuffer(self.data, "<u8", count, self.at)
            self.at += 8 * count
            for index, start in enumerate(table.tolist()):
                chunks.append(self.chunk(part, number, index, start, flags))
        for number, part in enumerate(parts):
            self.check_density(part, [c for c in chunks if c.part == number])
        chunks.sort(key=lambda chunk: chunk.start)
        if any(a.stop > b.start for a, b in pairwise(chunks)):
            raise _BrokenError("its chunks overlap")
        return Container(flags, tuple(parts), tuple(chunks))

    def check_density(self, part: Part, chunks: list[Chunk]) -> None:
        """A small file must not make anybody allocate a huge picture."""
        if part.deep or any(channel.sampling != (1, 1) for channel in part.channels):
            return
        sizes = dict(_TYPES.values())
        pixels = part.data.width * part.data.height
        claimed = pixels * sum(sizes[channel.kind] for channel in part.channels)
        stored = sum(chunk.stop - chunk.start for chunk in chunks)
        if claimed > stored * _DENSEST.get(part.compression, _DENSEST_OTHER):
            raise _BrokenError(f"{stored} bytes cannot hold the pixels of its data window")

    def unpack(self, layout: str) -> tuple[int, ...]:
        values = struct.unpack_from(layout, self.data, self.at)
        self.at += struct.calcsize(layout)
        return values

    def text(self) -> str:
        stop, limit = self.at, min(len(self.data), self.at + 256)
        while stop < limit and self.data[stop] != 0:
            stop += 1
        if stop == limit:
            raise _BrokenError("a name in its header does not end")
        raw = bytes(self.data[self.at : stop])
        self.at = stop + 1
        try:
            return raw.decode("utf-8")
        except UnicodeDecodeError:
            raise _BrokenError("its names are not UTF-8") from None

    def part(self, flags: int) -> Part:
        attributes: dict[str, Attribute] = {}
        while name := self.text():
            kind = self.text()
            (size,) = self.unpack("<i")
            if size < 0 or self.at + size > len(self.data) or self.at + size > MOST_HEADER_BYTES:
                raise _BrokenError(f"the attribute {name!r} claims {size} bytes")
            if name in attributes:
                raise _BrokenError(f"the attribute {name!r} comes twice")
            attributes[name] = Attribute(name, kind, bytes(self.data[self.at : self.at + size]))
            self.at += size
        return _checked_part(attributes, flags)

    def count_chunks(self, part: Part) -> int:
        stated = [a.value for a in part.attributes if a.name == "chunkCount"]
        count = part.chunk_count
        if stated and len(stated[0]) == 4:
            (claimed,) = struct.unpack("<i", stated[0])
            if claimed < 1 or (count is not None and claimed != count):
                raise _BrokenError(f"{claimed} chunks do not make its picture")
            return claimed
        if count is None:
            raise _BrokenError("its levels are of an unknown kind")
        return count

    def chunk(self, part: Part, number: int, index: int, start: int, flags: int) -> Chunk:
        if start == 0 or start < self.at or start >= len(self.data):
            raise _BrokenError("it is truncated: a chunk was never written")
        self.at, kept = start, self.at
        if flags & _MULTI_PART and self.unpack("<i")[0] != number:
            raise _BrokenError("a chunk belongs to another part")
        body = self.at
        self.unpack("<i" if part.tile is None else "<4i")
        if part.deep:
            packed_table, packed, _ = self.unpack("<QQQ")
            size = packed_table + packed
        else:
            (size,) = self.unpack("<i")
        stop = self.at + size
        if size < 0 or stop > len(self.data):
            raise _BrokenError("it is truncated")
        self.at = kept
        return Chunk(number, index, body, stop)


def _checked_part(attributes: dict[str, Attribute], flags: int) -> Part:
    def value(name: str, layout: str) -> tuple:
        if name not in attributes or len(attributes[name].value) < struct.calcsize(layout):
            raise _BrokenError(f"its header lacks {name}")
        return struct.unpack_from(layout, attributes[name].value)

    data, display = (_window(value(name, "<4i"), name) for name in ("dataWindow", "displayWindow"))
    if data.width * data.height > MOST_PIXELS:
        raise _BrokenError(
            f"its data window of {data.width} x {data.height} has more than {MOST_PIXELS} pixels"
        )
    (number,) = value("compression", "<B")
    if number not in _COMPRESSIONS:
        raise _BrokenError(f"its compression {number} is unknown")
    kind = attributes["type"].value.decode("ascii", "replace") if "type" in attributes else ""
    tiled = kind in ("tiledimage", "deeptile") if kind else bool(flags & _TILED)
    tile, levels = None, False
    if tiled:
        width, height, mode = value("tiles", "<IIB")
        if not (0 < width <= MOST_PIXELS and 0 < height <= MOST_PIXELS):
            raise _BrokenError(f"its tiles are {width} x {height}")
        tile, levels = (width, height), mode & 0xF != 0
    return Part(
        attributes=tuple(attributes.values()),
        channels=_channels(attributes),
        data=data,
        display=display,
        compression=_COMPRESSIONS[number][0],
        tile=tile,
        levels=levels,
        deep=kind in ("deepscanline", "deeptile") if kind else bool(flags & _DEEP),
    )


def _window(corners: tuple[int, int, int, int], name: str) -> Window:
    left, top, right, bottom = corners
    if right < left or bottom < top:
        raise _BrokenError(f"its {name} is empty")
    return Window(left, top, right - left + 1, bottom - top + 1)


def _channels(attributes: dict[str, Attribute]) -> tuple[Channel, ...]:
    if "channels" not in attributes:
        raise _BrokenError("its header lacks channels")
    parser = _Parser(memoryview(attributes["channels"].value))
    channels = []
    while name := parser.text():
        kind, _, across, down = parser.unpack("<iIii")
        if kind not in _TYPES or across < 1 or down < 1:
            raise _BrokenError(f"its channel {name!r} has an unknown type")
        channels.append(Channel(name, _TYPES[kind][0], (across, down)))
        if len(channels) > MOST_CHANNELS:
            raise _BrokenError(f"more than {MOST_CHANNELS} channels")
    if not channels or len({channel.name for channel in channels}) != len(channels):
        raise _BrokenError("it has no channels, or two of one name")
    return tuple(channels)

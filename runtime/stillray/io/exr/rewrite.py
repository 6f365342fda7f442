"""A copy of an EXR file with some channels replaced and every other byte of picture untouched.

Parts that are not replaced are copied chunk by chunk without being decoded; so are all headers,
attribute by attribute. A part that holds a replaced channel is unpacked and packed again, some
rows at a time, with its own types, compression, tiles and windows; its other channels keep their
bytes where that packing is deflate or none, see `stillray.io.exr.deflate`.
"""

from __future__ import annotations

import errno
import struct
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from stillray.errors import InputError
from stillray.io.exr.container import (
    MAGIC,
    Attribute,
    Chunk,
    Container,
    Part,
    compression_attribute,
    header_bytes,
    read_container,
    string_attribute,
)
from stillray.io.exr.deflate import is_plain, replace_planes
from stillray.io.exr.openimageio import opened, openimageio, reason

_BAND_BYTES = 2**26  # of pixels that are decoded at a time
# Codecs that store 32-bit integers as they store floats, bit by bit.
_SAME_BITS = ("none", "rle", "zips", "zip", "piz", "b44", "b44a")
_HALF = np.finfo(np.float16)


def rewrite(
    source: Path,
    container: Container,
    target: Path,
    replaced: Mapping[tuple[int, str], np.ndarray],
    provenance: Mapping[str, str | None],
) -> int:
    """Write a copy of a file with some channels replaced.

    Parameters
    ----------
    source, container
        The file, and its container as it was checked.
    target
        Where to write; not yet in its final place.
    replaced
        Number of the part and name of the channel to ``(height, width)`` float planes of the
        part's data window.
    provenance
        String attributes, added to the first part and to each that has changed; None takes away
        what any part has under that name.

    Returns
    -------
    int
        Values that half precision cannot hold and that were clamped.

    Raises
    ------
    InputError
        A part to change holds many samples a pixel or subsampled channels, or the file cannot be
        decoded.
    OSError
        The target cannot be written; the one who chose its name can say which file that is.
    """
    changed = sorted({part for part, _ in replaced})
    parts, clamped = list(container.parts), 0
    encoded: dict[int, Path] = {}
    chunks: dict[int, list[Chunk]] = {
        number: [chunk for chunk in container.chunks if chunk.part == number]
        for number in range(len(parts))
    }
    added = tuple(string_attribute(n, text) for n, text in provenance.items() if text is not None)
    dropped = {name for name, text in provenance.items() if text is None}
    try:
        for number in changed:
            part = parts[number]
            planes = {name: plane for (at, name), plane in replaced.items() if at == number}
            encoded[number] = target.with_name(f"{target.name}.{number}.part")
            if is_plain(part, planes):
                chunks[number], beyond = replace_planes(
                    source, part, chunks[number], planes, encoded[number]
                )
            else:
                part = _encodable(source, part)
                beyond = _encode(source, number, part, planes, encoded[number])
                fresh = read_container(encoded[number])
                parts[number], chunks[number] = part, _in_line_order(part, fresh)
            clamped += beyond
        for number in {0, *changed}:
            parts[number] = _with_attributes(parts[number], added)
        parts = [_without_attributes(part, dropped) for part in parts]
        with target.open("wb") as sink:
            _assemble(sink, source, container, parts, chunks, encoded)
    finally:
        for path in encoded.values():
            path.unlink(missing_ok=True)
    return clamped


def unkept(part: Part) -> list[str]:
    """What of a part's structure is not kept where its color is replaced, each in a line."""
    lines = []
    if part.levels:
        lines.append("mip-mapped color is written at its full resolution alone")
    if _rounds_integers(part):
        lines.append(
            f"compression {part.compression} becomes zip, since it would round the integers beside "
            "the color"
        )
    return lines


def _rounds_integers(part: Part) -> bool:
    integers = any(channel.kind == "uint" for channel in part.channels)
    return integers and part.compression not in _SAME_BITS


def _encodable(source: Path, part: Part) -> Part:
    """The part as it will be encoded."""
    if part.deep or any(channel.sampling != (1, 1) for channel in part.channels):
        raise InputError(
            f"{source}: cannot be written with its structure: the part with its color must be flat,"
            " and without subsampled channels"
        )
    if part.levels:
        tiles = [a for a in part.attributes if a.name == "tiles"]
        # smaller copies of the noisy picture would not belong to the clean one
        part = _with_attributes(
            replace(part, levels=False), [a._replace(value=a.value[:8] + b"\0") for a in tiles]
        )
    if _rounds_integers(part):
        # nothing is lost with zip
        compression = compression_attribute("zip")
        return _with_attributes(replace(part, compression="zip"), (compression,))
    return part


def _encode(
    source: Path, number: int, part: Part, planes: Mapping[str, np.ndarray], target: Path
) -> int:
    oiio = openimageio()
    names = [channel.name for channel in part.channels]
    # integers travel as the floats of the same bits: OpenImageIO would scale them to 0..1
    kinds = ["half" if channel.kind == "half" else "float" for channel in part.channels]
    spec = oiio.ImageSpec(part.data.width, part.data.height, len(names), "float")
    if len(set(kinds)) == 1:  # OpenImageIO ignores formats of channels that are all the same
        spec.set_format(oiio.TypeDesc(kinds[0]))
    spec.channelnames, spec.channelformats = tuple(names), tuple(map(oiio.TypeDesc, kinds))
    spec.x, spec.y = part.data.x, part.data.y
    spec.full_x, spec.full_y = part.display.x, part.display.y
    spec.full_width, spec.full_height = part.display.width, part.display.height
    if part.tile is not None:
        spec.tile_width, spec.tile_height = part.tile
    spec.attribute("compression", _with_level(part))
    clamped = 0
    sink = oiio.ImageOutput.create("exr")
    if not sink.open(str(target), spec):
        raise OSError(errno.EIO, reason(sink.geterror()))
    with opened(source) as pixels:
        pixels.seek_subimage(number, 0)
        for top, bottom in _bands(part):
            band = _decoded(source, pixels, number, part, (top, bottom))
            for name, plane in planes.items():
                rows, at = plane[top:bottom], names.index(name)
                if kinds[at] == "half":
                    beyond = ~(np.abs(rows) <= _HALF.max)
                    clamped += int(np.count_nonzero(beyond))
                    rows = np.clip(np.nan_to_num(rows), _HALF.min, _HALF.max)
                band[..., at] = rows
            if not _write_band(sink, part, band, top, bottom):
                message = reason(sink.geterror())
                sink.close()
                raise OSError(errno.EIO, message)
    message = sink.geterror()
    if not sink.close() or message:
        raise OSError(errno.EIO, reason(message or sink.geterror()))
    return clamped


def _bands(part: Part) -> list[tuple[int, int]]:
    """Rows of the data window, in whole chunks."""
    step = part.tile[1] if part.tile is not None else part.chunk_rows
    row = part.data.width * len(part.channels) * 4
    step *= max(1, _BAND_BYTES // (row * step))
    height = part.data.height
    return [(top, min(top + step, height)) for top in range(0, height, step)]


def _decoded(path: Path, source: Any, number: int, part: Part, rows: tuple[int, int]) -> np.ndarray:
    """A band ``(rows, w, channels)`` of float32, integers as the floats of the same bits."""
    oiio = openimageio()
    order = list(source.spec().channelnames)
    top, bottom = rows[0] + part.data.y, rows[1] + part.data.y
    left, right = part.data.x, part.data.x + part.data.width

    def read(first: int, last: int, kind: Any) -> np.ndarray:
        if part.tile is None:
            band = source.read_scanlines(number, 0, top, bottom, 0, first, last, kind)
        else:
            band = source.read_tiles(number, 0, left, right, top, bottom, 0, 1, first, last, kind)
        if band is None:
            raise InputError(f"{path}: cannot read the pixels: {reason(source.geterror())}")
        return np.asarray(band).reshape(bottom - top, part.data.width, last - first)

    everything = read(0, len(order), oiio.FLOAT)
    band = np.empty((*everything.shape[:2], len(part.channels)), np.float32)
    for at, channel in enumerate(part.channels):
        place = order.index(channel.name)
        if channel.kind == "uint":
            band[..., at] = read(place, place + 1, oiio.UINT32)[..., 0].view(np.float32)
        else:
            band[..., at] = everything[..., place]
    return band


def _write_band(sink: Any, part: Part, band: np.ndarray, top: int, bottom: int) -> bool:
    top, bottom = top + part.data.y, bottom + part.data.y
    if part.tile is None:
        written: bool = sink.write_scanlines(top, bottom, 0, band)
    else:
        left = part.data.x
        written = sink.write_tiles(left, left + part.data.width, top, bottom, 0, 1, band)
    return written


def _with_level(part: Part) -> str:
    for name, kind, value in part.attributes:
        if name == "dwaCompressionLevel" and kind == "float" and part.compression[:3] == "dwa":
            return f"{part.compression}:{struct.unpack('<f', value)[0]:g}"
    return part.compression


def _in_line_order(part: Part, fresh: Container) -> list[Chunk]:
    decreasing = any(a.name == "lineOrder" and a.value == b"\1" for a in part.attributes)
    return sorted(fresh.chunks, key=lambda chunk: chunk.index, reverse=decreasing)


def _with_attributes(part: Part, added: Sequence[Attribute]) -> Part:
    attributes = {attribute.name: attribute for attribute in (*part.attributes, *added)}
    return replace(part, attributes=tuple(attributes.values()))


def _without_attributes(part: Part, names: Collection[str]) -> Part:
    return replace(part, attributes=tuple(a for a in part.attributes if a.name not in names))


def _assemble(
    sink: BinaryIO,
    source: Path,
    container: Container,
    parts: Sequence[Part],
    chunks: Mapping[int, Sequence[Chunk]],
    encoded: Mapping[int, Path],
) -> None:
    parts = [_with_chunk_count(part, len(chunks[i])) for i, part in enumerate(parts)]
    sink.write(struct.pack("<iI", MAGIC, container.flags))
    for part in parts:
        sink.write(header_bytes(part.attributes))
    if container.multi_part:
        sink.write(b"\0")
    tables = sink.tell()
    offsets = {number: np.zeros(len(listed), "<u8") for number, listed in chunks.items()}
    for table in offsets.values():
        sink.write(table.tobytes())
    # a part after the other; within a part, chunks as they lie in its source
    for number in range(len(parts)):
        with encoded.get(number, source).open("rb") as pixels:
            for chunk in chunks[number]:
                offsets[number][chunk.index] = sink.tell()
                if container.multi_part:
                    sink.write(struct.pack("<i", number))
                pixels.seek(chunk.start)
                sink.write(pixels.read(chunk.stop - chunk.start))
    sink.seek(tables)
    for table in offsets.values():
        sink.write(table.tobytes())


def _with_chunk_count(part: Part, count: int) -> Part:
    value = struct.pack("<i", count)
    return replace(
        part,
        attributes=tuple(
            a._replace(value=value) if a.name == "chunkCount" else a for a in part.attributes
        ),
    )

"""Scan lines that are stored plainly or by deflate, the commonest of EXR's compressions, by zlib.

OpenImageIO turns every channel of a part into floats and back to reach some of them, which costs
several times what deflate does. Here a chunk is only inflated: channels that are not wanted stay
the bytes they are, and those beside a replaced one keep them exactly. What is packed in another
way, or not as expected, is left to OpenImageIO.

A chunk holds, for each of its rows, the row of each channel in turn. Its bytes are rearranged
before they are deflated: first every other one, then the rest, each as the difference from the one
before, plus 128 ("OpenEXR File Layout", openexr.com, and the format's own reader).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import numpy as np

from stillray.arrays.strips import available_threads
from stillray.errors import InputError
from stillray.io.exr.container import Chunk, Part

_LEVEL = 4  # as OpenEXR has it: smaller files take much longer
_PREFIX = struct.Struct("<ii")  # of a chunk: its first row, and the bytes that follow
_STORED: dict[str, np.dtype] = {
    "half": np.dtype("<f2"),
    "float": np.dtype("<f4"),
    "uint": np.dtype("<u4"),
}
_HALF = np.finfo(np.float16)
_MOST_THREADS = 8  # inflating is soon bound by memory

Result = TypeVar("Result")


def is_plain(part: Part, wanted: Collection[str]) -> bool:
    """Whether these channels of a part can be read and written here."""
    names = [channel.name.encode() for channel in part.channels]
    integers = {channel.name for channel in part.channels if channel.kind == "uint"}
    return (
        part.compression in ("none", "zips", "zip")
        and part.tile is None
        and not part.deep
        and not part.levels
        and all(channel.sampling == (1, 1) for channel in part.channels)
        and not integers.intersection(wanted)
        and names == sorted(names)  # the order of a chunk, whatever that of the header
    )


def read_planes(
    path: Path, part: Part, chunks: Sequence[Chunk], wanted: Collection[str]
) -> dict[str, np.ndarray]:
    """Some channels of a part.

    Parameters
    ----------
    path
        The file.
    part
        Its part.
    chunks
        All of the part's.
    wanted
        Names of channels for which `is_plain` holds.

    Returns
    -------
    dict of str to (height, width) float32

    Raises
    ------
    InputError
        A chunk cannot be inflated.
    """
    columns = _columns(part)
    planes = {n: np.empty((part.data.height, part.data.width), np.float32) for n in wanted}

    def unpack(chunk: Chunk) -> None:
        rows = _Rows(part, chunk.index)
        lines = rows.lines(path, _body(path, chunk))
        for name, plane in planes.items():
            at, stored = columns[name]
            row = lines[:, at : at + part.data.width * stored.itemsize]
            plane[rows.span] = np.ascontiguousarray(row).view(stored)

    _on_threads(unpack, chunks)
    return planes


def replace_planes(
    path: Path,
    part: Part,
    chunks: Sequence[Chunk],
    planes: Mapping[str, np.ndarray],
    target: Path,
) -> tuple[list[Chunk], int]:
    """Write chunks in which some channels are replaced, one after the other.

    Parameters
    ----------
    path, part, chunks
        As for `read_planes`.
    planes
        Name to ``(height, width)`` float; of channels for which `is_plain` holds.
    target
        Where to write.

    Returns
    -------
    chunks
        Where they lie in the target, in the order of those given.
    clamped
        Values that half precision cannot hold, and that were clamped to it.

    Raises
    ------
    InputError
        A chunk cannot be inflated.
    """

    columns = _columns(part)

    def pack(chunk: Chunk) -> tuple[bytes, int]:
        rows, clamped = _Rows(part, chunk.index), 0
        lines = rows.lines(path, _body(path, chunk)).copy()
        for name, plane in planes.items():
            at, stored = columns[name]
            values = plane[rows.span]
            if stored == np.float16:
                beyond = ~(np.abs(values) <= _HALF.max)
                clamped += int(np.count_nonzero(beyond))
                values = np.clip(np.nan_to_num(values), _HALF.min, _HALF.max)
            raw = np.ascontiguousarray(values, stored).view(np.uint8)
            lines[:, at : at + raw.shape[1]] = raw
        data = _deflated(lines, part)
        return _PREFIX.pack(rows.first, len(data)) + data, clamped

    written, total = [], 0
    with target.open("wb") as sink:
        # a few at a time: a large picture is not held packed
        for start in range(0, len(chunks), 4 * _MOST_THREADS):
            some = chunks[start : start + 4 * _MOST_THREADS]
            for chunk, (body, clamped) in zip(some, _on_threads(pack, some), strict=True):
                begin = sink.tell()
                sink.write(body)
                written.append(Chunk(chunk.part, chunk.index, begin, begin + len(body)))
                total += clamped
    return written, total


class _Rows:
    """The rows of a chunk."""

    def __init__(self, part: Part, index: int) -> None:
        start = index * part.chunk_rows
        self.span = slice(start, min(start + part.chunk_rows, part.data.height))
        self.first = part.data.y + start
        self._plain = part.compression == "none"
        self._shape = (
            self.span.stop - start,
            part.data.width * sum(_STORED[channel.kind].itemsize for channel in part.channels),
        )

    def lines(self, path: Path, body: bytes) -> np.ndarray:
        """The bytes of each row: ``(rows, bytes)`` uint8."""
        count = self._shape[0] * self._shape[1]
        first, size = _PREFIX.unpack_from(body)
        data = memoryview(body)[_PREFIX.size :]
        if first != self.first or size != len(data):
            raise InputError(f"{path}: cannot read the pixels: a chunk is of other rows")
        if len(data) == count:  # what deflate would make larger is stored as it is
            return np.frombuffer(data, np.uint8).reshape(self._shape)
        inflated = b"" if self._plain else _inflated(data, count)
        if len(inflated) != count:
            raise InputError(f"{path}: cannot read the pixels: a chunk is broken")
        differences = np.frombuffer(inflated, np.uint8) - np.uint8(128)
        differences[0] ^= np.uint8(128)  # the first is no difference
        joined = np.add.accumulate(differences, dtype=np.uint8, out=differences)
        lines = np.empty(count, np.uint8)
        half = (count + 1) // 2
        lines[::2], lines[1::2] = joined[:half], joined[half:]
        return lines.reshape(self._shape)


def _inflated(data: memoryview, count: int) -> bytes:
    try:
        # never more than is expected, whatever the bytes say
        return zlib.decompressobj().decompress(data, count + 1)
    except zlib.error:
        return b""


def _deflated(lines: np.ndarray, part: Part) -> bytes:
    plain = lines.reshape(-1)
    if part.compression == "none":
        return plain.tobytes()
    apart = np.concatenate([plain[::2], plain[1::2]])
    apart[1:] = apart[1:] - apart[:-1] + np.uint8(128)
    packed = zlib.compress(apart.data, _LEVEL)
    return packed if len(packed) < plain.size else plain.tobytes()


def _columns(part: Part) -> dict[str, tuple[int, np.dtype]]:
    """Name to the first byte of a channel in a row, and its type."""
    columns, at = {}, 0
    for channel in part.channels:
        columns[channel.name] = at, _STORED[channel.kind]
        at += part.data.width * _STORED[channel.kind].itemsize
    return columns


def _on_threads(work: Callable[[Chunk], Result], chunks: Sequence[Chunk]) -> list[Result]:
    # zlib and NumPy let other threads run
    with ThreadPoolExecutor(min(available_threads(), _MOST_THREADS), "stillray-deflate") as pool:
        return list(pool.map(work, chunks))


def _body(path: Path, chunk: Chunk) -> bytes:
    with path.open("rb") as file:
        file.seek(chunk.start)
        return file.read(chunk.stop - chunk.start)

"""Odd EXR files that are whole: what the format allows and renderers seldom write.

`oddity` draws one from a seed: views by name or attribute, luminance and chroma at half resolution,
mip maps, integers, windows beside each other, parts in any order, names in any script. They are
written here byte by byte, after "OpenEXR File Layout" (openexr.com), since no library writes them
all; packed plainly or by deflate.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field

import numpy as np

MAGIC = 20000630
_TILED, _MULTI_PART = 0x200, 0x1000
_TYPES = {"uint": (0, "<u4"), "half": (1, "<f2"), "float": (2, "<f4")}
_COMPRESSIONS = {"none": (0, 1), "zips": (2, 1), "zip": (3, 16)}


@dataclass(frozen=True, kw_only=True)
class OddPart:
    """One part: channels by name to type and sampling, and how they are stored.

    Attributes
    ----------
    channels
        Name to type (``"half"``, ``"float"``, ``"uint"``) and distance between samples, pixels.
    data
        Data window: x, y, width, height.
    display
        Size of the display window, which begins at 0, 0.
    name, view
        Attributes of parts.
    levels
        Whether it is tiled, with smaller copies down to a pixel.
    extra
        Further attributes: name, type, bytes.
    """

    channels: dict[str, tuple[str, int]]
    data: tuple[int, int, int, int]
    display: tuple[int, int] = (24, 20)
    name: str = ""
    view: str = ""
    compression: str = "none"
    levels: bool = False
    decreasing: bool = False
    extra: tuple[tuple[str, str, bytes], ...] = field(default=())


def exr(parts: list[OddPart], rng: np.random.Generator) -> bytes:
    """A file of these parts, with values in [0, 1] (integers up to 2^31)."""
    several = len(parts) > 1
    flags = 2 | (_MULTI_PART if several else _TILED if parts[0].levels else 0)
    chunks = [_chunks(part, rng) for part in parts]
    head = struct.pack("<iI", MAGIC, flags)
    head += b"".join(
        _header(part, len(c), several) for part, c in zip(parts, chunks, strict=True)
    ) + (b"\0" if several else b"")
    at = len(head) + 8 * sum(map(len, chunks))
    table, body = b"", b""
    for number, listed in enumerate(chunks):
        for chunk in listed:
            table += struct.pack("<Q", at + len(body))
            body += (struct.pack("<i", number) if several else b"") + chunk
    return head + table + body


def _header(part: OddPart, chunks: int, several: bool) -> bytes:
    x, y, width, height = part.data
    listed = b"".join(
        name.encode() + b"\0" + struct.pack("<iIii", _TYPES[kind][0], 0, step, step)
        for name, (kind, step) in sorted(part.channels.items(), key=lambda c: c[0].encode())
    )
    attributes = [
        ("channels", "chlist", listed + b"\0"),
        ("compression", "compression", bytes([_COMPRESSIONS[part.compression][0]])),
        ("dataWindow", "box2i", struct.pack("<4i", x, y, x + width - 1, y + height - 1)),
        ("displayWindow", "box2i", struct.pack("<4i", 0, 0, *(n - 1 for n in part.display))),
        ("lineOrder", "lineOrder", bytes([part.decreasing])),
        ("pixelAspectRatio", "float", struct.pack("<f", 1)),
        ("screenWindowCenter", "v2f", bytes(8)),
        ("screenWindowWidth", "float", struct.pack("<f", 1)),
        *part.extra,
    ]
    if several:
        kind = b"tiledimage" if part.levels else b"scanlineimage"
        attributes += [
            ("name", "string", part.name.encode()),
            ("type", "string", kind),
            ("chunkCount", "int", struct.pack("<i", chunks)),
        ]
    if part.view:
        attributes.append(("view", "string", part.view.encode()))
    if part.levels:
        attributes.append(("tiles", "tiledesc", struct.pack("<IIB", 16, 16, 1)))
    return (
        b"".join(
            name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
            for name, kind, value in attributes
        )
        + b"\0"
    )


def _chunks(part: OddPart, rng: np.random.Generator) -> list[bytes]:
    if part.levels:
        return _tiles(part, rng)
    _, y, _, height = part.data
    rows = _COMPRESSIONS[part.compression][1]
    tops = range(y, y + height, rows)
    packed = [
        struct.pack("<i", top) + _packed(part, _rows(part, top, min(rows, y + height - top), rng))
        for top in tops
    ]
    return packed


def _tiles(part: OddPart, rng: np.random.Generator) -> list[bytes]:
    _, _, width, height = part.data
    tiles, level = [], 0
    while True:
        for down in range(-(-height // 16)):
            for across in range(-(-width // 16)):
                size = (min(16, height - 16 * down), min(16, width - 16 * across))
                raw = b"".join(
                    _values(kind, size[1], rng)
                    for _ in range(size[0])
                    for _, (kind, _) in sorted(part.channels.items())
                )
                tiles.append(struct.pack("<4i", across, down, level, level) + _packed(part, raw))
        if (width, height) == (1, 1):
            return tiles
        width, height, level = max(1, width // 2), max(1, height // 2), level + 1


def _rows(part: OddPart, top: int, count: int, rng: np.random.Generator) -> bytes:
    x, _, width, _ = part.data
    rows = b""
    for row in range(top, top + count):
        for _, (kind, step) in sorted(part.channels.items(), key=lambda c: c[0].encode()):
            if row % step == 0:
                samples = (x + width - 1) // step - -(-x // step) + 1
                rows += _values(kind, samples, rng)
    return rows


def _values(kind: str, count: int, rng: np.random.Generator) -> bytes:
    if kind == "uint":
        return rng.integers(0, 2**31, count).astype("<u4").tobytes()
    return rng.random(count).astype(_TYPES[kind][1]).tobytes()


def _packed(part: OddPart, raw: bytes) -> bytes:
    """With its size before it; deflated as the format has it, where that is shorter."""
    if part.compression != "none":
        apart = np.frombuffer(raw[::2] + raw[1::2], np.uint8)
        before = np.concatenate([apart[:1], apart[:-1]])
        steps = (apart.astype(np.int16) - before + 128).astype(np.uint8)
        steps[:1] = apart[:1]
        squeezed = zlib.compress(steps.tobytes())
        raw = squeezed if len(squeezed) < len(raw) else raw
    return struct.pack("<i", len(raw)) + raw


_SETS: tuple[tuple[str, ...], ...] = (
    ("R", "G", "B"), ("R", "G", "B", "A"), ("Y", "RY", "BY"), ("Y",), ("Y", "A"), ("Z",),
    ("left.R", "left.G", "left.B"), ("right.R", "right.G", "right.B"), ("A", "R"),
    ("albedo.R", "albedo.G", "albedo.B"), ("N.X", "N.Y", "N.Z"), ("cryptomatte00.R", "id"),
    ("View Layer.Combined.R", "View Layer.Combined.G", "View Layer.Combined.B"),
    ("светло.R", "светло.G", "светло.B"), ("r", "g", "b"), ("motion.X", "motion.Y"),
    ("R", "G", "B", "R.R", "..", "a." * 40), ("samples",), ("\x1b[31mR", "G\nB"),
)  # fmt: skip
_NAMES = (
    "",
    "rgba_left",
    "rgba_right",
    "depth.left",
    "beauty",
    "rgba",
    "rgba",
    "left",
    "ümläut",
    "#",
)
_VIEWS = ("", "", "left", "right", "right", "main view")


def oddity(rng: np.random.Generator) -> bytes:
    """An odd file, drawn."""

    def one_of(choices: tuple) -> object:
        return choices[int(rng.integers(len(choices)))]

    def part() -> OddPart:
        names = [name for _ in range(int(rng.integers(1, 4))) for name in one_of(_SETS)]  # type: ignore[attr-defined]
        levels = bool(rng.random() < 0.1)
        channels = {}
        for name in dict.fromkeys(names):
            kind = ("half", "half", "float", "uint")[int(rng.integers(4))]
            chroma = name in ("RY", "BY") or rng.random() < 0.02
            channels[name] = (kind, 2 if chroma and not levels else 1)
        x, y = (2 * int(rng.integers(-9, 10)) if rng.random() < 0.5 else 0 for _ in "xy")
        data = (x, y, *(2 * int(rng.integers(1, 20)) for _ in "wh"))
        views = struct.pack("<i4si5s", 4, b"left", 5, b"right")
        extra = (("multiView", "stringvector", views),) if rng.random() < 0.2 else ()
        return OddPart(
            channels=channels,
            data=data,  # type: ignore[arg-type]
            name=str(one_of(_NAMES)),
            view=str(one_of(_VIEWS)),
            compression=str(one_of(tuple(_COMPRESSIONS))),
            levels=levels,
            decreasing=bool(rng.random() < 0.1),
            extra=extra,
        )

    return exr([part() for _ in range(int(one_of((1, 1, 2, 4))))], rng)  # type: ignore[arg-type, call-overload]

"""Frames in tiles, so that the network and the reconstruction fit into a given memory.

What is global to a frame is found on the whole frame: exposure, the unit of depth, the past at
each pixel. Only what takes most of the memory is done a tile at a time: features, network and
reconstruction. A tile overlaps its neighbours by all that a pixel can see, and begins where the
coarsest level of a pyramid does, so that its pixels are those of the whole frame but for rounding.
"""

from __future__ import annotations

import math
import re
from numbers import Real

from stillray.arrays.tiles import Tile, tiles_of
from stillray.errors import InputError
from stillray.families.contract import Traits

#: Bytes of a process that has loaded a model and denoised nothing: 115 to 130 MiB, and spare.
BASE_BYTES = 150 << 20
#: Bytes a pixel of the whole frame whatever it holds, and for each channel that is given: the
#: floor under any bound. They hold the buffers of the frame in work, of the next and of the last,
#: history, what is prepared, and the picture on its way out. Runs of three frames of 1280 x 720
#: with wskp-3 in small tiles took 125 bytes a pixel with color alone and 425 with 12 channels, the
#: past among them; kpyr-5, which also remembers its output, 530. A tenth is spare.
PIXEL_BYTES, CHANNEL_BYTES = 60, 44
#: Bytes a pixel of a tile: features, network and reconstruction. 860 of kpyr-5 in floats, which
#: take 245 more than integers, and a tenth to spare.
TILE_BYTES = 950
#: More where several views of the frame are averaged, each of which is done after the other:
#: 340 measured.
VIEWS_BYTES = 380
_LEAST_INNER = 64  # pixels, and no less than the overlap: smaller tiles would be little else
_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}


def parse_memory(text: str) -> int:
    """Bytes of ``2G``, ``1.5G``, ``800M`` (powers of 1024).

    Raises
    ------
    InputError
        The text is no such amount.
    """
    hit = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?", text.strip(), re.IGNORECASE)
    if hit is None:
        raise InputError(f"max-memory must be an amount such as 2G or 800M, got {text}")
    return int(float(hit[1]) * _UNITS[hit[2].upper()])


def check_memory(max_memory: float | None) -> None:
    """Raise `InputError` where what should be bytes, or None, is no number."""
    number = isinstance(max_memory, Real) and not isinstance(max_memory, bool)
    if max_memory is not None and (not number or math.isnan(max_memory)):
        raise InputError(
            f"max_memory must be a number of bytes, such as 4 << 30, or None, got {max_memory!r}"
        )


def floor_bytes(shape: tuple[int, int], channels: int) -> int:
    """Bytes that a process takes however small its tiles are.

    Parameters
    ----------
    shape
        Height and width, pixels.
    channels
        Numbers a pixel that are given: 3 for color alone, 6 with albedo.
    """
    height, width = shape
    return BASE_BYTES + (PIXEL_BYTES + CHANNEL_BYTES * channels) * height * width


def plan_tiles(
    shape: tuple[int, int], channels: int, traits: Traits, max_memory: int | None, name: str
) -> list[Tile]:
    """The largest tiles with which a process stays below a memory.

    Parameters
    ----------
    shape, channels
        As `floor_bytes` takes them.
    traits
        Of the model's family.
    max_memory
        Bytes; None for one tile of the whole frame.
    name
        Of the model, for errors.

    Raises
    ------
    InputError
        The model cannot be cut into tiles, or the memory does not hold the buffers of the whole
        frame and one small tile.
    """
    height, width = shape
    multiple, halo = traits.tile_alignment, traits.tile_overlap
    if max_memory is None:
        return tiles_of(shape, max(shape), 0, multiple)
    if halo is None:
        raise InputError(f"max-memory must not be given with {name}, which takes whole frames")
    fixed = floor_bytes(shape, channels)
    of_tile = TILE_BYTES + (VIEWS_BYTES if traits.views > 1 else 0)
    least = min(max(_LEAST_INNER, halo) + 2 * halo, max(shape))
    needed = fixed + of_tile * min(least, height) * min(least, width)
    if max_memory < needed:
        raise InputError(
            f"max-memory must be {needed / _UNITS['M']:.0f}M or more for {width} x {height} "
            f"pixels with {name}, got {max_memory / _UNITS['M']:.0f}M"
        )
    pixels = (max_memory - fixed) // of_tile
    if pixels >= height * width:
        return tiles_of(shape, max(shape), halo, multiple)
    return tiles_of(shape, max(int(pixels**0.5), least), halo, multiple)
